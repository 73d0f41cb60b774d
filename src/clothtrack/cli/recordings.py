"""The verb that checks a recording: inspect."""

from pathlib import Path

from tyro.conf import Positional

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import say_result


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
