"""The verb that checks a recording: inspect."""

from pathlib import Path

from tyro.conf import Positional

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import say, say_result


def inspect(
    recording: Positional[Path], *, suggest: Path | None = None, json: AsJson = False
) -> int:
    """Is this recording readable? What is in it, what is wrong with it?

    Args:
        recording: folder with a recording.json.
        suggest: write a copy to this folder, with what is doubtful corrected where that can be
            computed; the recording itself stays as it is.
        json: machine-readable.
    """
    from clothtrack.recordings.inspection import inspect as inspect_recording

    inspection = inspect_recording(recording)
    say_result(inspection.text(), inspection.as_dict(), json=json)
    if suggest is not None and inspection.valid:
        from clothtrack.recordings.corrected_copy import write_corrected
        from clothtrack.recordings.store import read_recording

        made = write_corrected(read_recording(recording), inspection.geometry, suggest)
        if not json:
            say(f"corrected  {suggest}   ({', '.join(map(repr, made))})")
            say(f"next       clothtrack inspect {suggest}")
    return 0 if inspection.valid else 1
