"""Record from a connected camera, or import from other programs' files."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.api.results import Result
from clothtrack_capture.importing.import_options import ImportOptions

if TYPE_CHECKING:
    from clothtrack.files.progress import Progress
    from clothtrack_capture.importing.import_report import ImportReport
    from clothtrack_capture.live_capture import DepthCamera


def record(
    output: Path | str,
    *,
    seconds: float | None = None,
    replay: Path | str | None = None,
    serial: str = "",
    source: "DepthCamera | None" = None,
    opened: "Callable[[str], None] | None" = None,
) -> Result:
    """Record from a RealSense camera, with a page that shows the picture and instructions.

    Args:
        output: folder of the recording; must not exist.
        seconds: record for this long immediately, without the page.
        replay: recording to replay in place of the camera.
        serial: serial number of the camera, if several are connected.
        source: another camera, or one with another picture size (`open_realsense`); by default a
            RealSense camera with 640 x 480 pictures, 30 per second.
        opened: function called with the page's address.

    Raises:
        InvalidConfigError: there is no camera, or its software is not installed.
        InvalidRecordingError: no frame was recorded.
        StorageError: the folder exists or the disk refuses.
    """
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.live_capture import ReplayedCamera
    from clothtrack_capture.realsense_camera import open_realsense
    from clothtrack_capture.recording_page import Session, record_live

    output = Path(output)
    name = "RealSense" if source is None else type(source).__name__
    if replay is not None:
        source, name = ReplayedCamera(read_recording(replay)), "a replayed recording"
    camera = source or open_realsense(serial=serial)
    session = Session(camera, output, {"recorded_with": f"clothtrack record, {name}"})
    if seconds is not None:
        session.start()
        with suppress(KeyboardInterrupt):
            session.watch(seconds)
        recording = session.finish()
    else:
        recording = record_live(session, opened=opened)
    if recording is None:
        nothing = "left before the start; nothing was recorded"
        return Result("", {"recording": output, "frames": 0}, (nothing,))
    count = len(recording.frames)
    return Result(f"{output}   ({count} frames)", {"recording": output, "frames": count})


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
