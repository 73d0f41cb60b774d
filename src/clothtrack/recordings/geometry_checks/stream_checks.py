"""Checks of color against depth in time: late or stuck streams, wrong order, double frames."""

from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.recordings.geometry_checks.change_maps import (
    ChangeMaps,
    change_maps,
    moving,
)
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.recording import Recording

_LARGEST_DELAY = 1
"""Most frames by which one stream may be late: shutters and time stamps differ by one."""

_FARTHEST_DELAY = 15
"""Largest delay that is tried [frames]."""

LEAST_FIT, LEAST_GAIN = 0.3, 0.1
"""Correlation that another delay must reach, and by how much it must be better than none. Motion
correlates with 0.5 to 0.9 on right recordings."""

_LEAST_MOVING_STEPS = 5
"""Least number of steps with motion from which delay or order can be judged."""

_STUCK_FRAMES = 3
"""Number of identical frames in a row that make a stuck stream, if something moves."""

_STUCK_SPEED = 0.3
"""Something moves in a step that changes at least this share of the median moving step."""

_MOST_SAME = 0.02
"""Largest share of the other frames that may repeat a picture if the camera has noise."""

_LEAST_CARRIED_M = 0.03
"""A closed tip that moves this far [m] moves cloth in the pictures."""

_MASK_SHARE = 0.8
"""Share of the path of the closed tips over which a mask without noise must not change to be stuck.
"""

_CLEARLY = 1.25
"""Two frames count as exchanged if that brings them so many times nearer to their neighbors. On a
right recording of two folds, 16 % of the frames would count by chance without a margin."""

MOST_OUT_OF_ORDER, LEAST_OUT_OF_ORDER = 0.05, 3
"""Share and number of moving frames from which the order is doubted. They are frames that would be
nearer to their neighbors with the next one first. Right recordings have 2 % at most."""

_MOST_AWAY_M = 0.15
"""Largest difference of heights from their median over all frames; others are clipped [m]."""

_MOST_TWICE = 0.2
"""Share of double frames from which tracking is disturbed."""


def stream_findings(recording: Recording, pictures: SmallPictures) -> list[Finding]:
    """Return what is wrong with the order and pace of the pictures."""
    if len(pictures.frames) < 4:
        return []
    changes = change_maps(pictures)
    stuck = _stuck(recording, pictures, changes)
    disordered = [] if stuck else _disordered(pictures)
    return [*stuck, *(disordered or _delayed(changes)), *_twice(pictures, bool(stuck))]


def _delayed(changes: ChangeMaps) -> list[Finding]:
    """Return a finding if the depth moves as the color does, some frames later or earlier."""
    if changes.color is None or moving(changes.height_m).sum() < _LEAST_MOVING_STEPS:
        return []
    color, height = _coarse(changes.color), _coarse(changes.height_m)
    products = color @ height.T
    squares = (color**2).sum(axis=1), (height**2).sum(axis=1)
    delays = np.arange(-_FARTHEST_DELAY, _FARTHEST_DELAY + 1)
    fits = np.array([_fit(products, *squares, int(delay)) for delay in delays])
    none, best = fits[_FARTHEST_DELAY], int(np.argmax(fits))
    delay = int(delays[best])
    if abs(delay) <= _LARGEST_DELAY or fits[best] < max(LEAST_FIT, none + LEAST_GAIN):
        return []
    late = "depth" if delay > 0 else "color"
    return [
        Finding(
            "stream_delay", float(abs(delay)), float(_LARGEST_DELAY), "", f"frames: {late}",
            f"the {late} shows the same motion {abs(delay)} frames later than the "
            f"{'color' if delay > 0 else 'depth'} (at most {_LARGEST_DELAY}; correlation "
            f"{fits[best]:.2f} against {none:.2f} as recorded): pair color and depth of the same "
            "time in frames",
        )
    ]  # fmt: skip


def _coarse(maps: Float[np.ndarray, "steps rows columns"]) -> Float[np.ndarray, "steps places"]:
    """Return the maps at a quarter of their size, without their mean, one row each."""
    rows, columns = (max(side // 4, 1) for side in maps.shape[1:])
    small = [cv2.resize(each, (columns, rows), interpolation=cv2.INTER_AREA) for each in maps]
    flat = np.stack(small).reshape(len(maps), -1).astype(np.float64)
    return flat - flat.mean(axis=1, keepdims=True)


def _fit(
    products: Float[np.ndarray, "steps steps"],
    color: Float[np.ndarray, " steps"],
    height: Float[np.ndarray, " steps"],
    delay: int,
) -> float:
    """Return the correlation of color with later height; 0 if half of either has no partner."""
    count = len(color) - abs(delay)
    first, later = max(-delay, 0), max(delay, 0)
    used = color[first : first + count].sum(), height[later : later + count].sum()
    if used[0] < 0.5 * color.sum() or used[1] < 0.5 * height.sum():
        return 0.0
    return float(np.trace(products, offset=delay) / max(np.sqrt(used[0] * used[1]), 1e-12))


def _stuck(recording: Recording, pictures: SmallPictures, changes: ChangeMaps) -> list[Finding]:
    """Return streams that repeat a picture bit for bit while the other, or cloth, moves."""
    found = []
    carried_m = _carried_m(recording, pictures)
    streams = [("depth", pictures.same_depth, changes.color)]
    if changes.color is not None:
        streams.append(("color", pictures.same_color, changes.height_m))
    if pictures.mask is not None:
        repeated = (pictures.mask[1:] == pictures.mask[:-1]).all(axis=(1, 2))
        streams.append(("mask", np.append(False, repeated), None))
    for name, same, other in streams:
        speed = np.zeros(len(same))
        if other is not None:
            speed[1:] = _relative(other)
        for begin, end in _runs(same):
            moved = speed[begin:end].mean() >= _STUCK_SPEED if other is not None else False
            # Pictures without noise repeat whenever nothing moves, closed picker or not.
            noisy = same.sum() - (end - begin) <= _MOST_SAME * len(same)
            gone_m = carried_m[begin:end].sum()
            carried = noisy and gone_m >= _LEAST_CARRIED_M
            if name == "mask":
                # If it changes at times, the picker's clock may be wrong, and not the mask.
                carried = gone_m >= max(_LEAST_CARRIED_M, _MASK_SHARE * carried_m.sum())
            if end - begin < _STUCK_FRAMES - 1 or not (moved or carried):
                continue
            first, last = pictures.frames[begin - 1], pictures.frames[end - 1]
            found.append(
                Finding(
                    f"{name}_stuck", float(last - first + 1), float(_STUCK_FRAMES), "",
                    f"frames[{first + 1}]: {name}",
                    f"the {name} of frames {first} to {last} is one picture, bit for bit, while "
                    f"{'the rest' if moved else 'the closed picker'} moves: leave these frames "
                    "out, or write what the camera saw then",
                )
            )  # fmt: skip
            break
    return found


def _carried_m(recording: Recording, pictures: SmallPictures) -> Float[np.ndarray, " frames"]:
    """Return how far closed tips moved since the previous frame [m]."""
    times = [recording.frames[frame].time_s for frame in pictures.frames]
    gone = np.zeros(len(times))
    for path in recording.picker_paths.values():
        for place, (before, now) in enumerate(pairwise(times), start=1):
            if path.closed_at(before) and path.closed_at(now):
                away = path.position_at(now) - path.position_at(before)
                gone[place] += float(np.linalg.norm(away))
    return gone


def _runs(marks: Bool[np.ndarray, " frames"]) -> list[tuple[int, int]]:
    """Return the first place of each run of marks, and the place after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marks, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _disordered(pictures: SmallPictures) -> list[Finding]:
    """Return a finding if neighbors would fit the frames around them better when exchanged."""
    if len(pictures.frames) < _LEAST_MOVING_STEPS + 3:
        return []
    away = np.nan_to_num(pictures.height_m - pictures.filled_m, nan=0.0)
    one, two = _apart(np.clip(away, -_MOST_AWAY_M, _MOST_AWAY_M))
    if pictures.color is not None:
        color_one, color_two = _apart(pictures.color.astype(np.float32))
        one, two = one + color_one, two + color_two
    as_recorded, exchanged = one[:-2] + one[2:], two[:-1] + two[1:]
    judged = np.minimum(as_recorded, exchanged) > 2.0
    wrong = judged & (as_recorded > _CLEARLY * exchanged)
    share = float(wrong.sum() / max(judged.sum(), 1))
    if wrong.sum() < LEAST_OUT_OF_ORDER or share <= MOST_OUT_OF_ORDER:
        return []
    named = ", ".join(str(pictures.frames[place + 1]) for place in np.flatnonzero(wrong)[:4])
    return [
        Finding(
            "frame_order", share, MOST_OUT_OF_ORDER, "", "frames",
            f"{100 * share:.0f} % of the moving frames fit better in the place of the next (at "
            f"most {100 * MOST_OUT_OF_ORDER:.0f} %; frames {named}): put frames in order of "
            "time, files whose numbers have no leading zeros sort wrongly",
        )
    ]  # fmt: skip


def _apart(
    pictures: Float[np.ndarray, "frames rows columns *channels"],
) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps_of_two"]]:
    """Return the differences of pictures one and two frames apart, over the median one for one.

    Pictures are blurred, so that the difference still grows with motion beyond an object's width.
    """
    columns, rows = pictures.shape[2] // 4, pictures.shape[1] // 4
    soft = np.stack(
        [
            cv2.resize(cv2.GaussianBlur(each, (0, 0), 4.0), (columns, rows)).ravel()
            for each in pictures
        ]
    )
    one, two = (np.abs(soft[step:] - soft[:-step]).mean(axis=1) for step in (1, 2))
    typical = max(float(np.median(one)), 1e-9)
    return one / typical, two / typical


def _relative(changes: Float[np.ndarray, "steps rows columns"]) -> Float[np.ndarray, " steps"]:
    """Return the change of each step, as a share of that of the median moving step."""
    total = changes.sum(axis=(1, 2))
    typical = float(np.median(total[moving(changes)])) if moving(changes).any() else np.inf
    return total / typical


def _twice(pictures: SmallPictures, stuck: bool) -> list[Finding]:
    """Return a finding for single frames that repeat the previous one, which noise never does."""
    same = pictures.same_depth
    if pictures.color is not None:
        same = same & pictures.same_color
    if stuck or not same.any() or same.mean() > 0.6:
        return []  # Pictures without noise repeat whenever nothing moves.
    single = [begin for begin, end in _runs(same) if end - begin < _STUCK_FRAMES - 1]
    share = len(single) / len(same)
    if len(single) < 2:
        return []
    named = ", ".join(str(pictures.frames[place]) for place in single[:4])
    return [
        Finding(
            "frame_twice", share, _MOST_TWICE, "", "frames",
            f"{len(single)} frames repeat the one before bit for bit (frames {named}): leave them "
            "out, the camera delivered fewer frames than were written",
            severity="doubt" if share > _MOST_TWICE else "note",
        )
    ]  # fmt: skip
