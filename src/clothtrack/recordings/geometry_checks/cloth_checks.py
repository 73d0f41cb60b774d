"""Checks of the cloth of the first frame against its size, its template and the table."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.geometry_checks.finding import (
    Finding,
    ObservedFrames,
    on_table,
    reaches_rim,
    unit_factor,
)
from clothtrack.recordings.geometry_checks.mesh_gap import LARGEST_GAP_M, mesh_gap_m
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording, Table

_SIZE_TOLERANCE = 0.06
"""Relative difference of a side of the cloth from `size_m` that is doubted. The sides of 40 flat
cloths were within 3 % of their size, including shirts whose sleeves hang a little."""

LOW_M, HIGH_M = -0.02, 0.05
"""Heights above the table [m] between which the lowest part of a cloth on it may be. On right
recordings it is from -6 to 29 mm: clouds that were cut away above the table begin higher."""

_BESIDE_M = 0.012
"""Largest distance of the middles of a flat template and of the cloth [m]. It is below 4 mm on
right recordings."""

_THICK_M = 0.015
"""Largest height of the top of a flat cloth over its middle [m]. It is below 3 mm on right
recordings, wrinkles included; a cloth dropped in a heap has some 40 mm."""

_TOWEL_FILL = 0.75
"""Least share of its rectangle that a flat towel covers: at least 0.83 if a fifth of the depth is
missing; a towel with a corner folded to its middle covers 0.75."""

_SHIRT_FILL = 0.92
"""Largest share of its rectangle that a shirt with spread sleeves covers: 0.70 in simulation, and
0.76 of a boxy cut. A flat towel covers 1.02 to 1.04, counted in whole squares."""

_FILL_TOLERANCE = 0.15
"""Largest difference of the shares of their rectangles that a flat template and the cloth cover.
It is at most 0.05 on right recordings."""

_FILL_CELL_M = 0.008
"""Side of the squares that are counted as covered [m]: twice the distance of the points."""

_USUAL_M = (0.15, 1.3)
"""Longer side of a cloth [m] that is believed without `size_m` and template, from a cocktail napkin
to a bath towel: a depth unit that is wrong by 4 makes 8 cm or 1.6 m of a tea towel."""

_USUAL_ABOVE_M = (0.25, 2.0)
"""Height of a camera above the table [m] that is believed then. Depth cameras measure from 0.25 m
on; at 2 m one pixel is as wide as a fold."""

_USUAL_FOCAL = (0.47, 1.4)
"""Focal length over the longer side of the picture that is believed then: from the 94 degrees of an
Azure Kinect to 39. Intrinsics of twice or half the picture size lie outside, or nearly so."""

_DROP_M = 0.03
"""What is this far under the table [m] is the floor beyond its edge."""

_LONGEST_AT_EDGE_M = 0.06
"""Rim of the cloth [m] that may lie within a reduced pixel (5 mm) of the table's edge."""

_NEIGHBORS = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class _Spread:
    """How the cloth of the first frame lies on the table.

    Attributes:
        sides_m: longer and shorter side of the smallest rectangle around it [m].
        middle_m: middle of that rectangle on the table [m].
        fill: share of that rectangle that it covers.
        lowest_m: height above the table that 5 % of the points are under [m].
        rise_m: from its median height to that which 1 % of the points are above [m].
        cut_off: whether it reaches the rim of the picture.
    """

    sides_m: tuple[float, float]
    middle_m: tuple[float, float]
    fill: float
    lowest_m: float
    rise_m: float
    cut_off: bool


def cloth_findings(recording: Recording, frames: ObservedFrames) -> list[Finding]:
    """Return where the first frame contradicts the description of the cloth."""
    observation = frames.at(0)
    if observation is None:
        return []
    scale = _scale(recording, observation)
    if scale is not None:
        return [scale]
    cut_away = recording.observed.lowest_height_m is not None
    findings = [_template(recording, observation)]
    if recording.table is not None:
        spread = _spread(observation, recording.table)
        height = _height(spread)
        findings.insert(0, height)
        if height is None and not cut_away:
            findings += [_flatness(recording, spread), _size(recording, spread)]
        findings.append(_over_edge(recording, frames, recording.table))
    return [finding for finding in findings if finding is not None]


def _scale(recording: Recording, observation: Observation) -> Finding | None:
    """Return a finding if sizes are those of another unit, because the depth unit is wrong."""
    cloth, camera = recording.cloth, recording.cameras[0]
    if not recording.frames[0].depth:
        return None
    if cloth.size_m is not None:
        expected = float(np.hypot(*cloth.size_m))
    elif cloth.template is not None:
        expected = _longest(cloth.template.vertices)
    else:
        return _unmeasured(recording, observation)
    measured = _longest(observation.points)
    factor = unit_factor(measured / expected)
    if factor is None:
        return None
    field = "cameras[0].depth_unit_m"
    unit_m = recording.depth_units_m.get(camera.name, 0.001)
    return Finding(
        "depth_unit", measured, expected, "m", field,
        f"the cloth is {measured:.3g} m long in the first frame and {expected:.3g} m by its size: "
        f"correct {field}, {unit_m:g} is likely to be {unit_m / factor:g}",
    )  # fmt: skip


def _unmeasured(recording: Recording, observation: Observation) -> Finding | None:
    """Return a finding if cloth and camera are unusual and no size or template confirms them."""
    if recording.table is None:
        return None
    camera, table = recording.cameras[0], recording.table
    unit_m = recording.depth_units_m.get(camera.name, 0.001)
    unit, lens = f"cameras[0].depth_unit_m ({unit_m:g})", "cameras[0].fx, fy"
    places, _ = on_table(observation.points, table)
    _, above_m = on_table(camera.position[None], table)
    focal = max(camera.fx, camera.fy) / max(camera.width, camera.height)
    for measured, (low, high), name, shown, field in (
        (_sides(places)[0], _USUAL_M, "m", "the cloth's longer side is {} m", unit),
        (float(above_m[0]), _USUAL_ABOVE_M, "m", "the camera is {} m above the table", unit),
        (focal, _USUAL_FOCAL, "", "fx and fy are {} of the picture's longer side", lens),
    ):
        if low <= measured <= high:
            continue
        return Finding(
            "scale", measured, low if measured < low else high, name, field.split(" (")[0],
            f"{shown.format(f'{measured:.2g}')} ({low:g} to {high:g} are usual), and no size or "
            f"template confirms it: correct {field}, or give cloth.size_m, width and length as a "
            "ruler measures them",
        )  # fmt: skip
    return None


def _height(spread: _Spread) -> Finding | None:
    if LOW_M <= spread.lowest_m <= HIGH_M:
        return None
    under = spread.lowest_m < LOW_M
    return Finding(
        "cloth_height", spread.lowest_m, LOW_M if under else HIGH_M, "m", "table",
        f"the lowest part of the cloth is {1e3 * spread.lowest_m:.0f} mm above the table in the "
        f"first frame ({1e3 * LOW_M:.0f} to {1e3 * HIGH_M:.0f}): correct table, or the "
        "world_from_camera of the cameras",
    )  # fmt: skip


def _template(recording: Recording, observation: Observation) -> Finding | None:
    template = recording.cloth.template
    if template is None:
        return None
    gap_m = mesh_gap_m(template.vertices, template.faces, observation)
    if gap_m is None:
        return None
    if gap_m <= LARGEST_GAP_M:
        return _flat_template(recording, template, observation)
    beside = observation.points.mean(axis=0) - template.vertices.mean(axis=0)
    x, y, z = beside.tolist()
    return Finding(
        "template", gap_m, LARGEST_GAP_M, "m", "cloth.template",
        f"the template lies {1e3 * gap_m:.0f} mm (rms) from the cloth of the first frame (at most "
        f"{1e3 * LARGEST_GAP_M:.0f}), whose middle is ({x:.2f} {y:.2f} {z:.2f}) m from its own: "
        "put cloth.template where the cloth is, in the world of the cameras, or leave it out",
    )  # fmt: skip


def _flat_template(
    recording: Recording, template: ClothMesh, observation: Observation
) -> Finding | None:
    """Return a finding if a flat template differs in size or place from the flat cloth."""
    if recording.table is None:
        return None
    places, heights = on_table(template.vertices, recording.table)
    spread = _spread(observation, recording.table)
    if max(float(np.ptp(heights)), spread.rise_m) > _THICK_M:
        return None
    worst = _worst_side(spread, _sides(places))
    if worst is None:
        return _other_shape(spread, template, places) or _beside(recording, spread, places)
    (long, short), (seen_long, seen_short) = _sides(places), spread.sides_m
    return Finding(
        "template", *worst, "m", "cloth.template",
        f"the template is {long:.2f} x {short:.2f} m and the cloth of the first frame "
        f"{seen_long:.2f} x {seen_short:.2f} m (a side may differ by "
        f"{100 * _SIZE_TOLERANCE:.0f} %):"
        " scale cloth.template, or correct fx and fy of the camera",
    )  # fmt: skip


def _other_shape(
    spread: _Spread, template: ClothMesh, places: Float[np.ndarray, "vertices 2"]
) -> Finding | None:
    """Return a finding if a flat template of the right size has another outline."""
    corners = ((places - places.min(axis=0)) / _FILL_CELL_M).astype(np.int32)
    covered = np.zeros(corners.max(axis=0)[::-1] + 1, np.uint8)
    for face in template.faces:
        cv2.fillConvexPoly(covered, corners[face], 1)
    fill = float(covered.sum() * _FILL_CELL_M**2 / np.prod(_sides(places)))
    if spread.cut_off or abs(fill - spread.fill) <= _FILL_TOLERANCE:
        return None
    return Finding(
        "template", spread.fill, fill, "", "cloth.template",
        f"the cloth of the first frame covers {100 * spread.fill:.0f} % of the rectangle around "
        f"it, the template {100 * fill:.0f} % (they may differ by {100 * _FILL_TOLERANCE:.0f} %): "
        "give the template of this garment (clothtrack garment makes it), or cloth.kind alone",
    )  # fmt: skip


def _beside(
    recording: Recording, spread: _Spread, places: Float[np.ndarray, "vertices 2"]
) -> Finding | None:
    """Return a finding if a template of the right size is beside a cloth that is all visible."""
    if spread.cut_off or recording.observed.lowest_height_m is not None:
        return None
    away_m = float(np.hypot(*np.subtract(_middle(places), spread.middle_m)))
    if away_m <= _BESIDE_M:
        return None
    return Finding(
        "template", away_m, _BESIDE_M, "m", "cloth.template, cameras: world_from_camera",
        f"the middle of the template is {1e3 * away_m:.0f} mm beside that of the cloth in the "
        f"first frame (at most {1e3 * _BESIDE_M:.0f}): put cloth.template where the cloth is; if "
        "it is right, the camera's pose is not (clothtrack calibrate-camera)",
    )  # fmt: skip


def _worst_side(spread: _Spread, sides: tuple[float, float]) -> tuple[float, float] | None:
    """Return the side with the largest error, and its expected length [m]; None if both fit."""
    pairs = zip(spread.sides_m, sides, strict=True)
    measured, expected = max(pairs, key=lambda pair: abs(np.log(pair[0] / pair[1])))
    if abs(measured / expected - 1.0) <= _SIZE_TOLERANCE:
        return None
    return None if measured < expected and spread.cut_off else (measured, expected)


def _flatness(recording: Recording, spread: _Spread) -> Finding | None:
    """Return a finding if a cloth without a template does not lie flat in the first frame."""
    if recording.cloth.template is not None or spread.cut_off:
        return None
    remedy = "begin with the cloth spread out flat, or give cloth.template as it lies there"
    if spread.rise_m > _THICK_M:
        return Finding(
            "first_frame", spread.rise_m, _THICK_M, "m", "frames[0]",
            f"the cloth does not lie flat in the first frame, its top is {1e3 * spread.rise_m:.0f} "
            f"mm above its middle (at most {1e3 * _THICK_M:.0f}): {remedy}",
        )  # fmt: skip
    if recording.cloth.kind == "towel" and spread.fill < _TOWEL_FILL:
        return Finding(
            "first_frame", spread.fill, _TOWEL_FILL, "", "frames[0]",
            f"the towel does not lie flat in the first frame, it covers {100 * spread.fill:.0f} % "
            f"of the rectangle around it (at least {100 * _TOWEL_FILL:.0f} %): {remedy}",
        )  # fmt: skip
    if recording.cloth.kind == "tshirt" and spread.fill > _SHIRT_FILL:
        return Finding(
            "garment_kind", spread.fill, _SHIRT_FILL, "", "cloth.kind",
            f"the cloth covers {100 * spread.fill:.0f} % of the rectangle around it in the first "
            f"frame, a T-shirt at most {100 * _SHIRT_FILL:.0f} %: correct cloth.kind, or begin "
            "with its sleeves spread out",
        )  # fmt: skip
    return None


def _size(recording: Recording, spread: _Spread) -> Finding | None:
    """Return a finding if a side of the flat cloth differs from `size_m`."""
    size = recording.cloth.size_m
    flat = spread.rise_m <= _THICK_M
    if size is None or not flat or recording.cloth.kind not in ("towel", "tshirt"):
        return None
    worst = _worst_side(spread, (max(size), min(size)))
    if worst is None:
        return None
    measured, expected = worst
    long, short = spread.sides_m
    remedy = "correct cloth.size_m [width, length]"
    if measured < expected:
        remedy += ", or spread the cloth out flat before the first frame"
    else:
        remedy += ", or fx and fy of the camera"
    return Finding(
        "size", measured, expected, "m", "cloth.size_m",
        f"the cloth of the first frame is {long:.2f} x {short:.2f} m and cloth.size_m says "
        f"{size[0]:g} x {size[1]:g} m (a side may differ by {100 * _SIZE_TOLERANCE:.0f} %): "
        f"{remedy}",
    )  # fmt: skip


def _over_edge(recording: Recording, frames: ObservedFrames, table: Table) -> Finding | None:
    """Return a finding if cloth at the height of the table borders on a floor below it."""
    pictures = frames.small
    if pictures is None:
        return None
    camera, factor = pictures.camera, pictures.factor
    for frame in sorted({0, *(action.last_frame for action in recording.actions)}):
        seen = frames.at(frame)
        if seen is None or frame not in pictures.frames:
            continue
        height_m = pictures.height_m[pictures.frames.index(frame)]
        drop = (height_m < -_DROP_M).astype(np.uint8)
        # Depth is often missing along a step.
        drop = cv2.dilate(drop, _NEIGHBORS) & ((drop > 0) | np.isnan(height_m))
        low = seen.points[on_table(seen.points, table)[1] < _THICK_M]
        spots, depth_m = camera.project(low)
        columns, rows = (spots / factor).astype(int).T
        inside = (rows >= 0) & (rows < drop.shape[0]) & (columns >= 0) & (columns < drop.shape[1])
        rim = np.zeros_like(drop)
        rim[rows[inside], columns[inside]] = 1
        rim &= cv2.dilate(drop, _NEIGHBORS)
        length_m = float(rim.sum() * factor * np.median(depth_m) / camera.fx) if len(low) else 0.0
        if length_m > _LONGEST_AT_EDGE_M:
            return Finding(
                "cloth_over_edge", length_m, _LONGEST_AT_EDGE_M, "m", f"frames[{frame}]",
                f"{100 * length_m:.0f} cm of the cloth's rim lie at the table's edge in frame "
                f"{frame} (at most {100 * _LONGEST_AT_EDGE_M:.0f}), and what hangs over it is not "
                "tracked: keep the cloth on the table, or leave out the actions that move it there",
            )  # fmt: skip
    return None


def _spread(observation: Observation, table: Table) -> _Spread:
    places, heights = on_table(observation.points, table)
    long, short = _sides(places)
    column, row = np.floor(places / _FILL_CELL_M).T
    row -= row.min()
    # One number per square: an order of magnitude faster than unique rows.
    covered = np.unique(column * (row.max() + 1) + row)
    low, middle, high = np.percentile(heights, [5, 50, 99]).tolist()
    return _Spread(
        (long, short),
        _middle(places),
        float(len(covered) * _FILL_CELL_M**2 / (long * short)),
        low,
        high - middle,
        reaches_rim(observation),
    )


def _sides(places: Float[np.ndarray, "points 2"]) -> tuple[float, float]:
    """Return the longer and shorter side of the smallest rectangle around places [m]."""
    _, sides, _ = cv2.minAreaRect(places.astype(np.float32))
    return float(max(sides)), float(max(min(sides), 1e-6))


def _middle(places: Float[np.ndarray, "points 2"]) -> tuple[float, float]:
    """Return the middle of the same rectangle [m]."""
    middle, _, _ = cv2.minAreaRect(places.astype(np.float32))
    return float(middle[0]), float(middle[1])


def _longest(points: Float[np.ndarray, "points 3"]) -> float:
    """Return the diagonal of the box around a cloud [m]."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))
