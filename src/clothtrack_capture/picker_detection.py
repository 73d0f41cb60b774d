"""Detection of the picker's path, grasps and actions from pictures of its colored tip.

A pick-and-place is detected from the tip's height above the table: it comes down to the cloth,
rests there while it closes, rises, comes down again, rests while it opens, and leaves. For tweezers
whose two arms are visible separately, the gap between them shows whether they are open.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Frame, PickAndPlace, PickerPath, Recording
from clothtrack.recordings.segmentation import ColorSegmenter
from clothtrack_capture.amendment import set_actions
from clothtrack_capture.picker_motion import (
    closed_by_gap,
    closed_by_rest,
    visits_of,
    without_jumps,
)
from clothtrack_capture.tip_finder import (
    Tip,
    learned_finder,
    tip_colors,
)

_TWO_ARMS_SHARE = 0.15
"""Share of frames that must show two arms for the gap between them to be used."""
_SAMPLES = 24
"""Number of pictures, spread over the recording, from which the tip's colors are learned."""


@dataclass(frozen=True, eq=False)
class PickerDetection:
    """A picker detected in a recording.

    Attributes:
        picks: frames in which it closes, one per action.
        releases: frames in which it is open again, one per action.
        by: cue for when the picker is closed, "tip distance" or "dwell".
    """

    path: PickerPath
    actions: tuple[PickAndPlace, ...]
    picks: tuple[int, ...]
    releases: tuple[int, ...]
    seen: Bool[np.ndarray, " frames"]
    by: str


def find_picker(
    recording: Recording,
    camera: Camera,
    members: UInt8[np.ndarray, "32 32 32"],
    *,
    name: str = "tip",
) -> PickerDetection:
    """Return the path of a tip of roughly these colors, and its pick-and-places."""
    if recording.table is None:
        raise InvalidRecordingError(
            f"{recording.folder}: without a table nobody knows when the tip is down; run "
            "clothtrack calibrate-camera first"
        )
    tips = _watch_tip(recording, camera, members)
    positions = np.array([np.full(3, np.nan) if tip is None else tip.position for tip in tips])
    positions = without_jumps(positions)
    seen = np.isfinite(positions[:, 0])
    if seen.sum() < 4:
        raise InvalidRecordingError(
            f"{recording.folder}: the tip is seen in {int(seen.sum())} of {len(seen)} frames (at "
            "least 4); check its color, or click on it in a frame that shows it"
        )
    heights = recording.table.heights(positions)
    visits = visits_of(seen, [tip and tip.pixel for tip in tips], camera)
    gaps = np.array([np.nan if tip is None else tip.gap_m for tip in tips])
    if np.mean(gaps[seen] > 0.0) > _TWO_ARMS_SHARE:
        by, spans = "tip distance", closed_by_gap(gaps, heights, visits)
    else:
        by, spans = "dwell", closed_by_rest(positions, heights, visits)
    closed = np.zeros(len(seen), dtype=bool)
    for pick, release in spans:
        closed[pick:release] = True
    actions = _actions(spans, visits, seen, heights, name=name)
    path = _path(recording.frames, positions, closed, seen)
    picks, releases = (tuple(span[end] for span in spans) for end in (0, 1))
    return PickerDetection(path, actions, picks, releases, seen, by)


def tip_members(
    recording: Recording, camera: Camera, tip: str | tuple[int, int, int] | None
) -> UInt8[np.ndarray, "32 32 32"]:
    """Return the set of the tip's colors, from a color name or a click (frame, column, row)."""
    if not isinstance(tip, tuple):
        return tip_colors(tip or "")
    frame, column, row = tip
    if not 0 <= frame < len(recording.frames) or camera.name not in recording.frames[frame].color:
        raise InvalidConfigError(
            f"{recording.folder}: there is no color picture of frame {frame} from camera "
            f"{camera.name!r}; click in a frame from 0 to {len(recording.frames) - 1}"
        )
    color = read_color(recording.frames[frame].color[camera.name])
    return ColorSegmenter.from_click(color, column, row).members


def require_unmeasured(recording: Recording, *, force: bool) -> None:
    """Refuse to replace existing picker paths unless `force` is set."""
    if recording.picker_paths and not force:
        raise InvalidRecordingError(
            f"{recording.folder}: picker.csv holds the path of "
            f"{', '.join(recording.picker_paths)} already; use --force to replace it and the "
            "actions by what the pictures show"
        )


def keep_picker(recording: Recording, detection: PickerDetection, name: str, tip: str) -> Recording:
    """Return the recording with what was detected, written unless it is in memory."""
    if not detection.actions:
        raise InvalidRecordingError(
            f"{recording.folder}: the tip is seen in {int(detection.seen.sum())} frames, but never "
            "picks and places: it must come down to the cloth, rise by 2 cm and come down again"
        )
    text = {"by": detection.by, "tip": tip, "seen": int(detection.seen.sum())}
    return set_actions(
        recording, {name: detection.path}, detection.actions, provenance={"picker_found": text}
    )


def first_pick_vertex(recording: Recording, detection: PickerDetection) -> int | None:
    """Return the template's vertex that the first pick takes; None if there is none."""
    if recording.cloth.template is None:
        return None
    grasp = detection.path.position_at(recording.frames[detection.picks[0]].time_s)
    return nearest_visible_vertex(recording.cloth.template, grasp, recording.cameras)


def _watch_tip(
    recording: Recording,
    camera: Camera,
    members: UInt8[np.ndarray, "32 32 32"],
) -> list[Tip | None]:
    """Return the tip in every frame, or None where it is not seen."""
    for frame in recording.frames:
        if camera.name not in frame.color or camera.name not in frame.depth:
            raise InvalidRecordingError(
                f"{recording.folder}: frame {frame.index} has no color or no depth from camera "
                f"{camera.name!r}; a tip is found in both together"
            )

    def look(
        frame: Frame,
    ) -> tuple[UInt8[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
        unit = recording.depth_units_m[camera.name]
        return read_color(frame.color[camera.name]), read_depth(frame.depth[camera.name], unit)

    places = np.unique(np.linspace(0, len(recording.frames) - 1, _SAMPLES).round().astype(int))
    finder = learned_finder([look(recording.frames[place]) for place in places], members, camera)
    tips: list[Tip | None] = []
    last: Tip | None = None
    axis = np.zeros(2)
    for frame in recording.frames:
        color, depth = look(frame)
        tip = finder.find(color, depth, near=None if last is None else last.pixel, axis=axis)
        if tip is not None:
            # The tool turns slowly, so average the axis from depth over many frames.
            alone = finder.find(color, depth)
            axis = 0.8 * axis + 0.2 * (np.zeros(2) if alone is None else alone.axis)
            last = tip
        tips.append(tip)
    return tips


def nearest_visible_vertex(
    cloth: ClothMesh,
    tip: Float[np.ndarray, " 3"],
    cameras: Sequence[Camera],
    *,
    radius_m: float = 0.03,
) -> int | None:
    """Return the nearest visible vertex, which a closing tip takes; None if it is out of reach.

    Args:
        cloth: mesh in its current state [m], world frame.
        tip: position of the tip [m].
        radius_m: reach of the tip [m].
    """
    distance = np.linalg.norm(cloth.vertices - tip, axis=1)
    distance[~visible_vertices(cloth.vertices, cloth.faces, cameras)] = np.inf
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] <= radius_m else None


def _actions(
    spans: Sequence[tuple[int, int]],
    visits: Sequence[Int[np.ndarray, " _"]],
    seen: Bool[np.ndarray, " frames"],
    heights: Float[np.ndarray, " frames"],
    *,
    name: str,
) -> tuple[PickAndPlace, ...]:
    """Return the actions' frame ranges, cut where the tip is out of view or highest."""
    if not spans:
        return ()
    ends = []
    for (_, release), (pick, _) in pairwise(spans):
        between = np.arange(release, pick + 1)
        away = between[~seen[between]]
        ends.append(int(away[-1]) if len(away) else int(between[np.nanargmax(heights[between])]))
    start = max(0, int(next(v for v in visits if spans[0][0] in v)[0]) - 1)
    starts = [start, *ends]
    return tuple(
        PickAndPlace(first, last, (name,))
        for first, last in zip(starts, [*ends, len(seen) - 1], strict=True)
    )


def _path(
    frames: Sequence[Frame],
    positions: Float[np.ndarray, "frames 3"],
    closed: Bool[np.ndarray, " frames"],
    seen: Bool[np.ndarray, " frames"],
) -> PickerPath:
    """Return the path where the tip is seen, filled in at both ends and where it is closed."""
    times = np.array([frame.time_s for frame in frames])
    kept = seen | closed
    kept[[0, -1]] = True
    # Keep the release frame even if the tip is hidden in it.
    kept[1:] |= closed[:-1] & ~closed[1:]
    filled = np.stack(
        [np.interp(times[kept], times[seen], axis) for axis in positions[seen].T], axis=1
    )
    return PickerPath(times[kept], filled, closed[kept])
