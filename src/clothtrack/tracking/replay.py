"""Tracks the first action of a finished trajectory once more: is it what its recording gives?

A SHA-256 tells that a result is what was written. That it is what the method makes of the recording
only the method can tell, and only where it computes as it did then.
"""

import json
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from clothtrack.errors import ClothTrackError
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import made_with
from clothtrack.files.settings import from_plain
from clothtrack.geometry.devices import require_device
from clothtrack.recordings.identity import DIGEST_FIELD, recording_digest
from clothtrack.recordings.recording import Recording
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.pipeline import config_hash, track_recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


@dataclass(frozen=True)
class Replay:
    """What came of tracking an action again.

    Attributes:
        outcome: "same": to the bit; "differs": altered; or "impossible" to tell here.
        text: in words, with the first difference or the reason.
    """

    outcome: Literal["same", "differs", "impossible"]
    text: str


def replay(
    tracked: TrackedTrajectory, recording: Recording, progress: Progress | None = None
) -> Replay:
    """Track the first action again and compare its meshes, bit by bit.

    Later actions start from what the earlier ones have come to; the first needs nothing but the
    recording.

    Args:
        tracked: what was tracked, with its provenance.
        recording: from which, to be read anew.
        progress: called after every frame.
    """
    try:
        reason = _hindrance(tracked, recording)
        if reason:
            return Replay("impossible", f"not replayed: {reason}")
        again = track_recording(
            _first_action(recording),
            from_plain(RunConfig(), tracked.config),
            device=tracked.provenance["device"],
            progress=progress,
        )
    except ClothTrackError as error:
        return Replay("impossible", f"not replayed: {error}")
    return _compared(tracked, again)


def _hindrance(tracked: TrackedTrajectory, recording: Recording) -> str:
    """Return why a trajectory cannot be tracked again to the same bits; "" when it can."""
    stamp = tracked.provenance
    if not tracked.actions or not recording.actions:
        return "it has no action"
    if parts := stamp.get("replaced_parts"):
        return f"it was tracked with other parts of the method ({', '.join(map(str, parts))})"
    if stamp.get(DIGEST_FIELD) != recording_digest(recording):
        return f"{recording.folder} is not what was tracked: changed since, or another one"
    now = made_with(dict(stamp.get("packages") or {}))
    for name, here in _flat(now).items():
        then = _flat(stamp).get(name)
        if then != here:
            return f"it was made with {name} {then}, here is {here}"
    config = from_plain(RunConfig(), tracked.config)
    plain = json.loads(json.dumps([asdict(config), tracked.config]))
    if plain[0] != plain[1] or config_hash(config) != stamp.get("config_hash"):
        return "its settings, or the files that they name, are not those of then"
    require_device(stamp["device"])
    return ""


def _flat(stamp: Any) -> dict[str, object]:
    """Return version, commit, machine and packages by their names."""
    own = {name: stamp.get(name) for name in ("clothtrack", "commit", "python", "machine")}
    return {**own, **dict(stamp.get("packages") or {})}


def _first_action(recording: Recording) -> Recording:
    action = recording.actions[0]
    return replace(recording, actions=(action,), frames=recording.frames[: action.last_frame + 1])


def _compared(tracked: TrackedTrajectory, again: TrackedTrajectory) -> Replay:
    count = len(again.frames)
    if again.positions.shape[1] != tracked.mesh.vertex_count:
        return Replay(
            "differs",
            f"replayed, its mesh has {again.mesh.vertex_count} vertices, not "
            f"{tracked.mesh.vertex_count}",
        )
    gaps_m = np.abs(again.positions - tracked.positions[:count]).max(axis=(1, 2))
    if not np.array_equal(again.positions, tracked.positions[:count]):
        frame = int(np.argmax(gaps_m > 0))
        gaps = f"by {gaps_m[frame]:.1g} m, later frames by up to {gaps_m.max():.1g} m"
        then, here = tracked.provenance.get("processor"), again.provenance["processor"]
        if then != here:
            # What is rounded otherwise in a last bit grows to millimeters over an action.
            return Replay(
                "impossible",
                f"replayed, frame {frame} differs ({gaps}), which says nothing: it was tracked on "
                f"{then or 'a processor that it does not name'}, here is {here}",
            )
        return Replay("differs", f"replayed, frame {frame} differs ({gaps}): it was altered")
    if not np.array_equal(again.visible, tracked.visible[:count]):
        return Replay("differs", "replayed, other vertices are visible: it was altered")
    return Replay("same", f"action 0 ({count} frames) replayed to the same bits")
