"""Looks at each picture in a thread of its own, while the dynamics predict."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.pipeline import observer

_CLOUDS_KEPT = 3
"""Of this frame, the one before, and the one that resting cloth is compared with."""

_FOLLOWED_KEPT = 64
"""Followed points of so many frames: the final alignment of an action asks for those of its last
frame, a moment later."""


class Eyes:
    """The clouds of a live recording.

    Attributes:
        spent_s: CPU time of the newest cloud [s].
    """

    def __init__(self) -> None:
        """Have seen nothing; `open` says of what."""
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="clothtrack-eyes")
        self._looks: dict[int, Future[Observation]] = {}
        self._cloud: Callable[[Frame], Observation] | None = None
        self.spent_s = 0.0

    def open(self, recording: Recording, config: RunConfig, segmenter: Segmenter | None) -> None:
        """Look at a recording, which has its first frame."""
        self._cloud = observer(
            recording, config.cloud_spacing_m, segmenter, color=config.color, kept=_CLOUDS_KEPT,
            followed=_FOLLOWED_KEPT,
        )  # fmt: skip

    def begin(self, frame: Frame) -> None:
        """Begin to look at the newest frame."""
        self._looks = {frame.index: self._thread.submit(self._look, frame)}

    def observe(self, frame: Frame) -> Observation:
        """Return the cloud of a frame; that of the newest was begun when it came.

        Raises:
            InvalidRecordingError: no cloth is found in it.
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
