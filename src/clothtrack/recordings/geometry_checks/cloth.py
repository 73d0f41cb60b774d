"""Measures of the cloth in the first frame: its size, its kind, the template and the table."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.recordings.geometry_checks.finding import (
    Measured,
    ObservedFrames,
    on_table,
    reaches_rim,
    unit_factor,
)
from clothtrack.recordings.point_cloud import Observation

SIZE_TOLERANCE = 0.06
"""Relative difference of a side of the cloth from `size_m` that is doubted. The sides of 40 flat
cloths were within 3 % of their size, including shirts whose sleeves hang a little."""

THICK_M = 0.015
"""Largest height of the top of a flat cloth over its middle [m]. It is below 3 mm on right
recordings, wrinkles included; a cloth dropped in a heap has some 40 mm."""

FILL_TOLERANCE = 0.15
"""Largest difference of the shares of their rectangles that a flat template and the cloth cover.
It is at most 0.05 on right recordings."""

_FILL_CELL_M = 0.008
"""Side of the squares that are counted as covered [m]: twice the distance of the points."""

_WELD_M = 0.0005
"""Boundary vertices nearer than this [m] to one of another triangle are one vertex, written twice:
layers of a template are at least 1 mm apart, and edges are 5 mm long."""

_DROP_M = 0.03
"""What is this far under the table [m] is the floor beyond its edge."""

LONGEST_AT_EDGE_M = 0.06
"""Rim of the cloth [m] that may lie within a reduced pixel (5 mm) of the table's edge."""

_NEIGHBORS = np.ones((3, 3), np.uint8)

LARGEST_GAP_M = 0.02
"""Distance of a first mesh from its cloud (root mean square) [m] above which it is not the mesh of
the observed cloth. On right recordings it is 1 to 6 mm; a pick reaches 30 mm."""

_LEAST_OBSERVABLE = 0.3
"""Share of the visible vertices that must be observable for their distances to count."""


@dataclass(frozen=True, eq=False)
class _Spread:
    """How the cloth of the first frame lies on the table.

    Attributes:
        sides_m: longer and shorter side of the smallest rectangle around it [m].
        fill: share of that rectangle that it covers.
        lowest_m: height above the table that 5 % of the points are under [m].
        rise_m: from its median height to that which 1 % of the points are above [m].
        cut_off: whether it reaches the rim of the picture.
    """

    sides_m: tuple[float, float]
    fill: float
    lowest_m: float
    rise_m: float
    cut_off: bool


def cloth_units(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the length of the cloth where it is that of its size or template in another unit."""
    cloth, unit_m = frames.recording.cloth, _unit_m(frames)
    if cloth.size_m is not None:
        expected = float(np.hypot(*cloth.size_m))
    elif cloth.template is not None:
        expected = _longest(cloth.template.vertices)
    else:
        return
    measured = _longest(frames.first.points)
    factor = unit_factor(measured / expected)
    if factor is not None:
        yield {
            "measured": measured, "limit": expected, "place": 0, "unit_m": unit_m,
            "likely": unit_m / factor,
        }  # fmt: skip


def longer_sides(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the longer side of the cloth [m]."""
    places, _ = on_table(frames.first.points, frames.table)
    yield {"measured": _sides(places)[0], "unit_m": _unit_m(frames)}


def camera_heights(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the height of the camera above the table [m]."""
    _, above_m = on_table(frames.recording.cameras[0].position[None], frames.table)
    yield {"measured": float(above_m[0]), "unit_m": _unit_m(frames)}


def focal_lengths(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the focal length over the longer side of the picture."""
    camera = frames.recording.cameras[0]
    yield {"measured": max(camera.fx, camera.fy) / max(camera.width, camera.height)}


def _unit_m(frames: ObservedFrames) -> float:
    return frames.recording.depth_units_m.get(frames.recording.cameras[0].name, 0.001)


def lowest(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the height of the lowest part of the cloth above the table [m]."""
    yield {"measured": frames.once(_spread).lowest_m}


def template_gaps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the distance of the template from the cloth (root mean square) [m]."""
    gap_m = frames.once(_template_gap_m)
    if gap_m is not None:
        beside = frames.first.points.mean(axis=0) - frames.template.vertices.mean(axis=0)
        x, y, z = beside.tolist()
        yield {"measured": gap_m, "x": x, "y": y, "z": z}


def template_sides(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the side of a flat cloth that differs from a flat template's [m]."""
    places, spread = frames.once(_flat_template), frames.once(_spread)
    worst = None if places is None else _worst_side(spread, _sides(places))
    if places is not None and worst is not None:
        yield {
            "measured": worst[0], "limit": worst[1], "sides": _sides(places),
            "seen": spread.sides_m, "most": SIZE_TOLERANCE,
        }  # fmt: skip


def template_fills(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the share of its rectangle that the cloth covers where a flat template's is another."""
    places, spread = frames.once(_flat_template), frames.once(_spread)
    if places is None or spread.cut_off:
        return
    corners = ((places - places.min(axis=0)) / _FILL_CELL_M).astype(np.int32)
    covered = np.zeros(corners.max(axis=0)[::-1] + 1, np.uint8)
    for face in frames.template.faces:
        cv2.fillConvexPoly(covered, corners[face], 1)
    fill = float(covered.sum() * _FILL_CELL_M**2 / np.prod(_sides(places)))
    if abs(fill - spread.fill) > FILL_TOLERANCE:
        yield {"measured": spread.fill, "limit": fill, "most": FILL_TOLERANCE}


def template_places(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the distance of the middles of a flat template and of a cloth seen as a whole [m]."""
    places, spread = frames.once(_flat_template), frames.once(_spread)
    if places is not None and not spread.cut_off and _whole(frames):
        seen, _ = on_table(frames.first.points, frames.table)
        away = np.subtract(_rectangle(places)[0], _rectangle(seen)[0])
        yield {"measured": float(np.hypot(*away))}


def double_vertices(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the share of the template's vertices that are written twice on its boundary."""
    template = frames.template
    corners = template.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, counts = np.unique(np.sort(corners, axis=1), axis=0, return_counts=True)
    rim = np.unique(edges[counts == 1])
    if len(rim):
        pairs = cKDTree(template.vertices[rim]).query_pairs(_WELD_M, output_type="ndarray")
        yield {"measured": len(np.unique(pairs)) / len(template.vertices), "weld": 1e3 * _WELD_M}


def shirt_fills(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the share of its rectangle that a flat shirt without a template covers."""
    cloth, spread = frames.recording.cloth, frames.once(_spread)
    judged = _whole(frames) and not spread.cut_off and spread.rise_m <= THICK_M
    if judged and cloth.kind == "tshirt":
        yield {"measured": spread.fill}


def flat_sizes(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the side of a flat cloth that differs from `size_m` [m]."""
    cloth, spread = frames.recording.cloth, frames.once(_spread)
    flat = _whole(frames) and spread.rise_m <= THICK_M and cloth.kind in ("towel", "tshirt")
    if cloth.size_m is None or not flat:
        return
    worst = _worst_side(spread, (max(cloth.size_m), min(cloth.size_m)))
    if worst is not None:
        smaller = ", or spread the cloth out flat before the first frame"
        yield {
            "measured": worst[0], "limit": worst[1], "seen": spread.sides_m, "size": cloth.size_m,
            "most": SIZE_TOLERANCE,
            "other": smaller if worst[0] < worst[1] else ", or fx and fy of the camera",
        }  # fmt: skip


def over_edge(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the length of the cloth's rim that borders on a floor below the table [m]."""
    pictures, table = frames.pictures, frames.table
    camera, factor = pictures.camera, pictures.factor
    ends = {0, *(action.last_frame for action in frames.recording.actions)}
    for frame in sorted(ends.intersection(pictures.frames)):
        seen = frames.at(frame)
        if seen is None:
            continue
        height_m = pictures.height_m[pictures.frames.index(frame)]
        drop = (height_m < -_DROP_M).astype(np.uint8)
        # Depth is often missing along a step.
        drop = cv2.dilate(drop, _NEIGHBORS) & ((drop > 0) | np.isnan(height_m))
        low = seen.points[on_table(seen.points, table)[1] < THICK_M]
        spots, depth_m = camera.project(low)
        columns, rows = (spots / factor).astype(int).T
        inside = (rows >= 0) & (rows < drop.shape[0]) & (columns >= 0) & (columns < drop.shape[1])
        rim = np.zeros_like(drop)
        rim[rows[inside], columns[inside]] = 1
        rim &= cv2.dilate(drop, _NEIGHBORS)
        length_m = float(rim.sum() * factor * np.median(depth_m) / camera.fx) if len(low) else 0.0
        if length_m > LONGEST_AT_EDGE_M:
            yield {"measured": length_m, "frame": frame}
            return


def mesh_gap_m(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    observation: Observation,
    *,
    device: str = "cpu",
) -> float | None:
    """Return the distance of a mesh from an observation, root mean square of both directions [m].

    The directions are from the cloud's points to the surface, and from the visible vertices to the
    cloud, except those where nothing could be measured. If too little of the mesh is observable,
    it is that of the points alone; None if that is so because points were cut away, as clouds
    without the table say nothing about a cloth that lies on it.
    """
    vertices = np.asarray(vertices, np.float64)
    seen = visible_vertices(vertices, faces, observation.cameras, device=device)
    if not seen.any():
        # The mesh is outside of every picture, while the cloud is inside: judge all vertices.
        seen = np.ones(len(vertices), dtype=bool)
        judged = seen
    else:
        judged = seen & ~observation.unobservable(vertices)
    unjudged = judged.sum() < _LEAST_OBSERVABLE * seen.sum()
    cut_away = observation.lowest_height_m is not None or observation.tool_clearance_m > 0
    if not len(observation.points) or (unjudged and cut_away):
        return None
    there = distance_to_mesh(observation.points, vertices, faces)
    if unjudged:
        return float(np.sqrt(np.mean(there**2)))
    back, _ = cKDTree(observation.points).query(vertices[judged])
    return float(np.sqrt(0.5 * (np.mean(there**2) + np.mean(back**2))))


def _whole(frames: ObservedFrames) -> bool:
    """Return whether nothing was cut away of the cloth."""
    return frames.recording.observed.lowest_height_m is None


def _template_gap_m(frames: ObservedFrames) -> float | None:
    return mesh_gap_m(frames.template.vertices, frames.template.faces, frames.first)


def _flat_template(frames: ObservedFrames) -> Float[np.ndarray, "vertices 2"] | None:
    """Return the vertices of a flat template on the table [m]; None unless it and the cloth are."""
    # Where what is seen does not say whether it is elsewhere, its size is not judged.
    if frames.once(_template_gap_m) is None:
        return None
    places, heights = on_table(frames.template.vertices, frames.table)
    flat = max(float(np.ptp(heights)), frames.once(_spread).rise_m) <= THICK_M
    return places if flat else None


def _worst_side(spread: _Spread, sides: tuple[float, float]) -> tuple[float, float] | None:
    """Return the side with the largest error, and its expected length [m]; None if both fit."""
    pairs = zip(spread.sides_m, sides, strict=True)
    measured, expected = max(pairs, key=lambda pair: abs(np.log(pair[0] / pair[1])))
    if abs(measured / expected - 1.0) <= SIZE_TOLERANCE:
        return None
    return None if measured < expected and spread.cut_off else (measured, expected)


def _spread(frames: ObservedFrames) -> _Spread:
    places, heights = on_table(frames.first.points, frames.table)
    long, short = _sides(places)
    column, row = np.floor(places / _FILL_CELL_M).T
    row -= row.min()
    # One number per square: an order of magnitude faster than unique rows.
    covered = np.unique(column * (row.max() + 1) + row)
    low, middle, high = np.percentile(heights, [5, 50, 99]).tolist()
    fill = float(len(covered) * _FILL_CELL_M**2 / (long * short))
    return _Spread((long, short), fill, low, high - middle, reaches_rim(frames.first))


def _sides(places: Float[np.ndarray, "points 2"]) -> tuple[float, float]:
    """Return the longer and shorter side of the smallest rectangle around places [m]."""
    _, sides = _rectangle(places)
    return float(max(sides)), float(max(min(sides), 1e-6))


def _rectangle(places: Float[np.ndarray, "points 2"]) -> tuple[Sequence[float], Sequence[float]]:
    """Return the middle and the sides of that rectangle [m]."""
    middle, sides, _ = cv2.minAreaRect(places.astype(np.float32))
    return middle, sides


def _longest(points: Float[np.ndarray, "points 3"]) -> float:
    """Return the diagonal of the box around a cloud [m]."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))
