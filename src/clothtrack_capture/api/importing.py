"""Import recordings from other programs' files."""

from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack_capture.importing.import_options import ImportOptions

if TYPE_CHECKING:
    from clothtrack.files.progress import Progress
    from clothtrack_capture.importing.import_report import ImportReport


def import_recording(
    source: Path | str,
    recording: Path | str,
    options: ImportOptions = ImportOptions(),  # noqa: B008
    *,
    progress: "Progress | None" = None,
) -> "ImportReport":
    """Make a recording from a ROS bag, a RealSense or Kinect file, or a folder of pictures.

    The supported formats are ROS 2 (.mcap, .db3, folders), ROS 1 and RealSense (.bag, .db3), Azure
    Kinect and Femto (.mkv), and folders in the style of TUM, Open3D and BOP. docs/import.md has a
    table of each.

    Args:
        source: file or folder.
        recording: folder to write; must not exist.
        options: information about the source from the user.
        progress: function called with the name, the frames done and the total frames.

    Raises:
        InvalidRecordingError: the source cannot be read.
        InvalidConfigError: an option contradicts the source.
        StorageError: the folder exists or the disk refuses.
    """
    from clothtrack_capture.importing.import_recording import import_recording as convert

    return convert(Path(source), Path(recording), options, progress=progress)
