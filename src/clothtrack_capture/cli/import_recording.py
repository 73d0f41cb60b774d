"""The verb that makes a recording of other programs' files: import."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import progress, say_result
from clothtrack_capture.extra import require_capture
from clothtrack_capture.importing.import_options import ImportOptions


def import_(
    source: Positional[Annotated[Path, arg(metavar="SOURCE")]],
    recording: Positional[Annotated[Path, arg(metavar="RECORDING")]],
    *,
    source_options: ImportOptions = ImportOptions(),  # noqa: B008
    json: AsJson = False,
) -> int:
    """Make a recording of a ROS bag, a RealSense or Kinect file, or a folder of pictures.

    Reads ROS 2 (.mcap, .db3, folders), ROS 1 and RealSense (.bag, .db3), Azure Kinect and Femto
    (.mkv), and folders in the style of TUM, Open3D and BOP; docs/import.md has a table of each.

    Args:
        source: file or folder.
        recording: folder to write; must not exist.
        source_options: what a person says about the source.
        json: machine-readable.
    """
    require_capture()
    from clothtrack_capture.importing.import_recording import import_recording

    report = import_recording(source, recording, source_options, progress=progress)
    say_result(report.text(), report.as_dict(), json=json)
    return 0


# The word of the command line is no name of Python's.
import_.__name__ = "import"
