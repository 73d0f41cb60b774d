"""Checks of the closed tip against motion in the pictures, and against the hand in them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from clothtrack.recordings.geometry_checks.change_maps import change_maps
from clothtrack.recordings.geometry_checks.finding import Finding, ObservedFrames
from clothtrack.recordings.geometry_checks.picker_checks import (
    allowance_m,
    carried_frames,
    held_by_name,
)
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import height_per_depth

_STEP = 2
"""Frames between two pictures that are compared."""

_FARTHEST_MOTION_M = 0.02
"""Largest distance [m] of motion in the picture from a tip that carries cloth, as the mean of the
two frames where it is farthest. On right recordings it is at most 5 mm."""

_LEAST_STEP_M = 0.015
"""A tip that moves this far in two frames [m] moves what it holds by more than the noise."""

_LEAST_FRAMES = 5
"""Fewer frames than this are not enough."""

_STANDS_M = 0.002
"""A tip that stays within this distance of a place [m] stands still."""

_AROUND_M = 0.025
"""Things this near to a tip that stands still [m] are what it holds, or what holds it."""

_LARGEST_CHANGE = 0.5
"""Largest share of the picture around such a tip that may change: fingers, swinging cloth."""

_LONGEST_S = 0.2
"""Time for which more may change, while fingers open [s]."""

_STANDS_HIGH_M = 0.015
_ROSE_M = 0.01
"""Heights above the table, and above the usual height at a pixel, of something that came [m]."""

_FROM_CLOTH_M, _LEAST_POINTS = 0.012, 15
"""Things nearer to this many points of the cloth [m] may be cloth. A sheet has 28 there; what a
camera mixes of cloth and the rim of a tool over it has at most 13."""

_HALF_THICKNESS_M = 0.025
"""Least half thickness of a hand or gripper [m]; tips of thinner tools are often not measured."""

_MEASURED_TO_ITS_TIP_M = 0.03
"""Such a hand is measured up to its tip if it is this near to the path [m] in two frames."""

_FARTHEST_HAND_M = 0.035
"""Distance of a closed tip from the hand [m] that three frames in succession may not all exceed. On
right recordings they do not all exceed 23 mm, on paths from clicks that are 0.1 s off 26."""

_BEHIND_M = 0.02
"""A tip this far behind cloth [m] may have a hand that is not seen."""

_Hold = tuple[int, str]
"""Number of an action, and one of its pickers."""


def motion_findings(recording: Recording, pictures: SmallPictures) -> list[Finding]:
    """Return tips that move where nothing moves, or stand still while what they hold moves."""
    found = []
    for name in recording.picker_paths:
        if held_by_name(recording, name):
            continue
        gaps = dict(_motion_gaps_m(recording, pictures, name))
        for number, action in enumerate(recording.actions):
            if name in action.pickers:
                span = range(action.first_frame, action.last_frame + 1)
                own = [gap for frame, gap in gaps.items() if frame in span]
                found += _moves_nothing(recording, own, (number, name))
                found += _stands(recording, pictures, (number, name))
    return found


def _moves_nothing(recording: Recording, gaps: list[float], hold: _Hold) -> list[Finding]:
    """Return a finding if nothing moves in the picture where a closed tip moves."""
    number, name = hold
    limit_m = _FARTHEST_MOTION_M + allowance_m(recording)
    gap_m = float(np.mean(sorted(gaps)[-2:])) if len(gaps) >= _LEAST_FRAMES else 0.0
    if gap_m <= limit_m:
        return []
    return [
        Finding(
            "picker_moves_nothing", gap_m, limit_m, "m", "picker.csv: x_m, y_m, z_m",
            f"what moves in the pictures is up to {1e3 * gap_m:.0f} mm from the closed picker "
            f"{name!r} in action {number + 1} (at most {1e3 * limit_m:.0f}): correct pick, place "
            "and times of its path in picker.csv",
        )
    ]  # fmt: skip


def _motion_gaps_m(
    recording: Recording, pictures: SmallPictures, name: str
) -> Iterator[tuple[int, float]]:
    """Yield frames with a moving closed tip in the picture, and its distance from motion [m]."""
    path, camera = recording.picker_paths[name], pictures.camera
    if len(pictures.frames) <= _STEP:
        return
    changes = change_maps(pictures, _STEP)
    times = [recording.frames[frame].time_s for frame in pictures.frames]
    for place, (before, after) in enumerate(zip(times[:-_STEP], times[_STEP:], strict=True)):
        tips = np.stack([path.position_at(before), path.position_at(after)])
        held = path.closed_at(before) and path.closed_at(after)
        if not held or np.linalg.norm(tips[1] - tips[0]) < _LEAST_STEP_M:
            continue
        moved = changes.height_m[place] > 0
        if changes.color is not None:
            moved = moved | (changes.color[place] > 0)
        spots, depth = camera.project(tips)
        inside = ((spots >= 0) & (spots < (camera.width, camera.height))).all()
        if not inside or not (depth > 0).all():
            continue
        pixels = _nearest(moved, spots / pictures.factor)
        yield pictures.frames[place], pixels * pictures.factor * float(depth.min()) / camera.fx


def _nearest(moved: Bool[np.ndarray, "rows columns"], spots: Float[np.ndarray, "2 2"]) -> float:
    """Return the distance of the nearer of two spots from a moved pixel [reduced pixels]."""
    if not moved.any():
        return float(np.hypot(*moved.shape))
    pixels = np.minimum(spots.astype(int), np.array(moved.shape[::-1]) - 1)
    return float(cdist(pixels, np.argwhere(moved)[:, ::-1]).min())


def _stands(recording: Recording, pictures: SmallPictures, hold: _Hold) -> list[Finding]:
    """Return a finding if a tip that has carried cloth stands still and the cloth has left it."""
    number, name = hold
    path, action = recording.picker_paths[name], recording.actions[number]
    times = {
        place: recording.frames[frame].time_s
        for place, frame in enumerate(pictures.frames)
        if action.first_frame <= frame <= action.last_frame
        and path.closed_at(recording.frames[frame].time_s)
    }
    if len(times) < _LEAST_FRAMES:
        return []
    tips = {place: path.position_at(time_s) for place, time_s in times.items()}
    last = max(times)
    # Find where it stands at the end, and since when.
    moving = [at for at in times if np.linalg.norm(tips[at] - tips[last]) > _STANDS_M]
    if not moving or _way_m(tips, moving) < _LEAST_STEP_M:
        return []
    since = min(place for place in times if place > max(moving))
    gone = [at for at in times if at > since and _changed(pictures, since, at, tips[last])]
    gone_s = times[last] - times[gone[0]] if gone else 0.0
    if gone_s < _LONGEST_S - 1e-6 or len(gone) < 0.8 * (last - gone[0] + 1):
        return []
    return [
        Finding(
            "picker_stuck", gone_s, _LONGEST_S, "s", "picker.csv: x_m, y_m, z_m",
            f"the closed picker {name!r} stands from {times[since]:g} s on in action {number + 1}, "
            f"but what it held is elsewhere for {gone_s:.1f} s (at most {_LONGEST_S:g}): write the "
            "whole path to picker.csv, or open it where it lets go",
        )
    ]  # fmt: skip


def _way_m(tips: Mapping[int, Float[np.ndarray, " 3"]], places: Sequence[int]) -> float:
    """Return the largest distance of a tip from its position in the first of some frames [m]."""
    return max(float(np.linalg.norm(tips[at] - tips[places[0]])) for at in places)


def _changed(
    pictures: SmallPictures, before: int, after: int, tip: Float[np.ndarray, " 3"]
) -> bool:
    """Return whether most of the picture around a tip differs between two frames."""
    camera, factor = pictures.camera, pictures.factor
    (spot,), (depth,) = camera.project(tip[None])
    if not (depth > 0 and (spot >= 0).all() and (spot < (camera.width, camera.height)).all()):
        return False
    pair = [before, after]
    two = replace(
        pictures,
        frames=(before, after),
        color=None if pictures.color is None else pictures.color[pair],
        height_m=pictures.height_m[pair],
        mask=None,
        same_color=pictures.same_color[pair],
        same_depth=pictures.same_depth[pair],
    )
    changes = change_maps(two)
    moved = changes.height_m[0] > 0
    if changes.color is not None:
        moved = moved | (changes.color[0] > 0)
    rows, columns = np.mgrid[: moved.shape[0], : moved.shape[1]]
    away = np.hypot(columns - spot[0] / factor, rows - spot[1] / factor)
    near = away <= _AROUND_M * camera.fx / depth / factor
    return bool(near.any() and moved[near].mean() > _LARGEST_CHANGE)


def hand_findings(recording: Recording, frames: ObservedFrames) -> list[Finding]:
    """Return tips that are away from the hand or gripper in the pictures."""
    pictures = frames.small
    if pictures is None or recording.table is None or recording.observed.tool_clearance_m > 0:
        return []
    hands, found = _Hands(recording, pictures), []
    for number, action in enumerate(recording.actions):
        for name in action.pickers:
            if not held_by_name(recording, name):
                found += _hand_elsewhere(recording, frames, hands, (number, name))
    return found


class _Hands:
    """Points of things that come into the pictures and are not cloth."""

    def __init__(self, recording: Recording, pictures: SmallPictures) -> None:
        assert recording.table is not None
        camera, factor = pictures.camera, pictures.factor
        # The height that a tenth of the frames are below; unmeasured pixels hide nothing.
        heights = np.where(np.isfinite(pictures.height_m), pictures.height_m, np.inf)
        low = len(heights) // 10
        usual = np.partition(heights, low, axis=0)[low]
        slope, self._above_m = height_per_depth(camera, recording.table)
        rows, columns = usual.shape
        self._slope = slope[factor // 2 :: factor, factor // 2 :: factor][:rows, :columns]
        self._pictures, self._usual = pictures, usual
        self._places = {frame: place for place, frame in enumerate(pictures.frames)}

    def at(self, frame: int, seen: Observation) -> Float[np.ndarray, "points 3"] | None:
        """Return the points in a frame [m]; None if too thin to be measured up to the tip."""
        if frame not in self._places:
            return None
        camera, factor = self._pictures.camera, self._pictures.factor
        height_m = self._pictures.height_m[self._places[frame]]
        came = (height_m > _STANDS_HIGH_M) & (height_m - self._usual > _ROSE_M)
        rows, columns = np.nonzero(came)
        depth_m = (height_m[rows, columns] - self._above_m) / self._slope[rows, columns]
        pixels_m = factor * depth_m / camera.fx
        if not len(rows) or _half_thickness(came) * pixels_m.max() < _HALF_THICKNESS_M:
            return None
        pixels = factor * (np.stack([columns, rows], axis=1) + 0.5) - 0.5
        away = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        local = np.column_stack([away, np.ones(len(away))]) * depth_m[:, None]
        points = local @ camera.world_from_camera[:3, :3].T + camera.position
        # A tree with a single query is not worth balancing.
        cloth = cKDTree(seen.points, compact_nodes=False, balanced_tree=False)
        nearest = cloth.query(points, [_LEAST_POINTS], distance_upper_bound=_FROM_CLOTH_M)[0]
        other = np.isinf(nearest[:, 0])
        if not other.any():
            return None
        came[rows[~other], columns[~other]] = False
        thick_m = _half_thickness(came) * float(np.median(pixels_m[other]))
        return points[other] if thick_m >= _HALF_THICKNESS_M else None


def _half_thickness(shape: Bool[np.ndarray, "rows columns"]) -> float:
    """Return the distance of the innermost pixel from the rim [pixels]; pinholes are no rim."""
    whole = cv2.morphologyEx(shape.view(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return float(cv2.distanceTransform(whole, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).max())


def _hand_elsewhere(
    recording: Recording, frames: ObservedFrames, hands: _Hands, hold: _Hold
) -> list[Finding]:
    """Return a finding if a hand that is near the path in some frames is far from it in others."""
    number, name = hold
    path, gaps = recording.picker_paths[name], []
    for frame in carried_frames(recording, number, name):
        seen = frames.at(frame)
        points = None if seen is None or not len(seen.points) else hands.at(frame, seen)
        tip = path.position_at(recording.frames[frame].time_s)
        if seen is not None and points is not None and not _behind_cloth(seen, tip):
            gaps.append(float(np.linalg.norm(points - tip, axis=1).min()))
    more_m = allowance_m(recording)
    near, limit_m = _MEASURED_TO_ITS_TIP_M + more_m, _FARTHEST_HAND_M + more_m
    if len(gaps) < _LEAST_FRAMES or sorted(gaps)[1] > near:
        return []
    gap_m = max(min(gaps[at : at + 3]) for at in range(len(gaps) - 2))
    if gap_m <= limit_m:
        return []
    return [
        Finding(
            "picker_beside_hand", gap_m, limit_m, "m", "picker.csv: x_m, y_m, z_m",
            f"the hand in the pictures is {1e3 * gap_m:.0f} mm or more from the closed picker "
            f"{name!r} in action {number + 1} (at most {1e3 * limit_m:.0f}), although it is at it "
            "in other frames: correct pick and place of its path in picker.csv",
        )
    ]  # fmt: skip


def _behind_cloth(seen: Observation, tip: Float[np.ndarray, " 3"]) -> bool:
    """Return whether cloth hides the tip, or it is in no picture."""
    hidden = True
    for camera in seen.cameras:
        (pixel,), (depth,) = camera.project(tip[None])
        if not (depth > 0 and (pixel >= 0).all() and (pixel < (camera.width, camera.height)).all()):
            continue
        spots, depths = camera.project(seen.points)
        near = np.linalg.norm(spots - pixel, axis=1) * depth / camera.fx < _FROM_CLOTH_M
        hidden &= bool((depths[near] < depth - _BEHIND_M).any())
    return hidden
