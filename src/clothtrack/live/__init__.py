"""Live tracking of the whole cloth: the steps of Algorithm 1 on a growing recording."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.live.live_state import LiveState
    from clothtrack.live.live_stream import LiveStream
    from clothtrack.live.live_tracker import LiveTracker
    from clothtrack.live.playback import play
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = ["LiveState", "LiveStream", "LiveTracker", "play"]
