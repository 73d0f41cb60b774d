"""Record from a connected camera."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.api.results import Result

if TYPE_CHECKING:
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
