"""The verbs that check a recording and import one: inspect and import."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import progress, say_result
from clothtrack.importing.import_options import ImportOptions


def inspect(recording: Positional[Path], *, json: AsJson = False) -> int:
    """Is this recording readable? What is in it, what is wrong with it?

    Args:
        recording: folder with a recording.json.
        json: machine-readable.
    """
    from clothtrack.recordings.inspection import inspect as inspect_recording

    inspection = inspect_recording(recording)
    say_result(inspection.text(), inspection.as_dict(), json=json)
    return 0 if inspection.valid else 1


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
    from clothtrack.importing.import_recording import import_recording

    report = import_recording(source, recording, source_options, progress=progress)
    say_result(report.text(), report.as_dict(), json=json)
    return 0


# The word of the command line is no name of Python's.
import_.__name__ = "import"
