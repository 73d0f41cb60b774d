"""Observation of each picture in a separate thread while the dynamics predict."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.pipeline import observer

_CLOUDS_KEPT = 3
"""Number of cached clouds: this frame, the one before, and the reference of resting cloth."""

_FOLLOWED_KEPT = 64
"""Number of frames with cached followed points. The final alignment of an action needs those of its
last frame a moment later."""


class Eyes:
    """Source of the clouds of a live recording.

    Attributes:
        spent_s: CPU time of the newest cloud [s].
    """

    def __init__(self) -> None:
        """Start the thread; `open` sets the recording."""
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="clothtrack-eyes")
        self._looks: dict[int, Future[Observation]] = {}
        self._cloud: Callable[[Frame], Observation] | None = None
        self.spent_s = 0.0

    def open(self, recording: Recording, config: RunConfig, segmenter: Segmenter | None) -> None:
        """Set the recording, which has its first frame."""
        self._cloud = observer(
            recording, config.cloud_spacing_m, segmenter, color=config.color, kept=_CLOUDS_KEPT,
            followed=_FOLLOWED_KEPT,
        )  # fmt: skip

    def begin(self, frame: Frame) -> None:
        """Begin observing the newest frame."""
        self._looks = {frame.index: self._thread.submit(self._look, frame)}

    def observe(self, frame: Frame) -> Observation:
        """Return the cloud of a frame; for the newest, wait for the thread.

        Raises:
            InvalidRecordingError: no cloth is found in the frame.
        """
        look = self._looks.pop(frame.index, None)
        if look is not None:
            return look.result()
        assert self._cloud is not None
        return self._cloud(frame)

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown()

    def _look(self, frame: Frame) -> Observation:
        assert self._cloud is not None
        start_s = time.thread_time()
        seen = self._cloud(frame)
        self.spent_s = time.thread_time() - start_s
        return seen
