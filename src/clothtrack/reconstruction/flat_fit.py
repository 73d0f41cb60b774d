"""The mesh that tracking starts from: the recording's template, or a garment fitted to the cloth.

If the reconstruction network is not used (`tracking.initial_state`), a flat towel or T-shirt is
fitted to the first cloud. Its size is measured from the cloud when the recording does not state it.
Only the outline is fitted: the interior of a flat cloth carries no information about its size and
would only draw the edges inwards. Depth alone cannot distinguish a shirt's front from its back or
one corner of a towel from another, so the front is assumed to face up.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidMeshError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording, Table
from clothtrack.recordings.template_file import read_template
from clothtrack.simulation.parameters import RESTING_HEIGHT_M

FITTED_KINDS = ("towel", "tshirt")

_RIM_M = 0.001
"""Distance of the outermost points inside the cloth's edge [m]. The edge cuts the cubes in which
points are averaged, so their mean is a quarter of a cube inside: 1 mm for the usual 4 mm."""

FARTHEST_M = 10.0
"""Largest distance of a template vertex from the origin along x or y [m]; detects files in
millimeters."""

_STARTS = 12
"""Number of equally spaced start angles of the fit; one is within 15 degrees."""


@dataclass(frozen=True, eq=False)
class FlatFit:
    """A flat garment fitted to a cloud.

    Attributes:
        mesh: the flat cloth in the world frame [m].
        misfit_m: root mean square distance of its outline from the cloud's [m].
    """

    mesh: ClothMesh
    misfit_m: float


def flat_fit(
    recording: Recording, observation: Observation, *, template: str = "", vertex_count: int = 1000
) -> FlatFit:
    """Fit a flat garment to a cloud, whether or not the recording has a template."""
    if not template and recording.cloth.kind not in FITTED_KINDS:
        raise InvalidRecordingError(
            f"{recording.folder}: cloth.kind is {recording.cloth.kind!r} and there is no template; "
            f"give cloth.template, or a kind that can be fitted: {', '.join(FITTED_KINDS)}"
        )
    if recording.table is None:
        raise InvalidRecordingError(
            f"{recording.folder}: no table and no template; for a cloth on a table run clothtrack "
            "calibrate-camera (in Python: calibrate_camera(recording) of clothtrack_capture, or "
            "table=ct.Table(...)); a cloth in the air needs cloth.template"
        )
    if len(observation.points) < 100:
        raise InvalidRecordingError(
            f"{recording.folder}: the first cloud has {len(observation.points)} points, a fit "
            "needs at least 100; check the mask of frame 0 with: clothtrack inspect"
        )
    return _fitted(recording, recording.table, observation.points, template, vertex_count)


def _fitted(
    recording: Recording,
    table: Table,
    points: Float[np.ndarray, "points 3"],
    file: str,
    vertex_count: int,
) -> FlatFit:
    axes = _plane_axes(table)
    covered = _CoveredRegion((points - table.point) @ axes[:2].T, _RIM_M)
    cloth = recording.cloth
    if file:
        template = read_template(Path(file))
        reach = float(np.abs(template.vertices[:, :2]).max())
        if reach > FARTHEST_M:
            raise InvalidMeshError(
                f"{file}: a vertex lies {reach:.3g} m from the origin (at most "
                f"{FARTHEST_M:g} m); write the template in meters, around the origin"
            )
        unit, size_m = _outline_of(template), (1.0, 1.0)
    else:
        template, unit, size_m = None, _unit_outline(cloth.kind), cloth.size_m
    fits = [
        _fit_outline(unit, covered, angle, size_m)
        for angle in np.linspace(0.0, 2.0 * np.pi, _STARTS, endpoint=False)
    ]
    best = min(fits, key=lambda fit: fit.cost)
    misfit = float(np.sqrt(np.mean(best.fun**2)))
    x, y, angle = best.x[:3]
    if template is None:
        width, length = size_m or np.exp(best.x[3:])
        size_m = (float(width), float(length))
        mesh = garment(cloth.kind, vertex_count=vertex_count, size_m=size_m)
    else:
        mesh = template
    placed = mesh.vertices.astype(np.float64).copy()
    placed[:, :2] = _rotated(placed[:, :2], angle) + (x, y)
    placed[:, 2] += RESTING_HEIGHT_M - placed[:, 2].min()
    return FlatFit(mesh.with_vertices(table.point + placed @ axes), misfit)


GRID_M = 0.001
"""Cell size [m] of the grid of the covered part of the table."""

_CLOSED_M = 0.006
"""Half the distance [m] up to which two points have cloth between them."""

_OUTLIER_M = 0.003
"""Distance of outlines [m] above which the loss grows less than its square, as for a curled
corner."""

_OUTLINE_SPACING_M = 0.004
"""Sample spacing [m] of the compared outlines."""


class _CoveredRegion:
    """The part of the table that a cloud covers, as a signed distance and as an outline.

    Args:
        cloud: points in the plane of the table [m].
        rim_m: distance of the outermost points inside the cloth's edge [m].
    """

    def __init__(self, cloud: Float[np.ndarray, "points 2"], rim_m: float) -> None:
        apart = np.percentile(cKDTree(cloud).query(cloud, k=2)[0][:, 1], 95)
        reach = max(_CLOSED_M, 1.5 * float(apart))
        self._origin = cloud.min(axis=0) - 0.05
        shape = np.ceil((np.ptp(cloud, axis=0) + 0.1) / GRID_M).astype(int)[::-1]
        columns, rows = ((cloud - self._origin) / GRID_M).astype(int).T
        hit = np.zeros(shape, dtype=bool)
        hit[rows, columns] = True
        grown = _distance_inside(~hit) <= reach
        contour = _largest_outline(_distance_inside(grown) > reach)
        filled = cv2.fillPoly(np.zeros(shape, np.uint8), [contour], 1) > 0
        # Neither distance includes the half cell on its side of the boundary.
        self._signed = _distance_inside(filled) - _distance_inside(~filled)
        self._signed += np.where(filled, -0.5, 0.5) * GRID_M + rim_m
        self.outline = _even_steps(self._to_plane(contour[:, 0].astype(np.float64)))
        self._rim_m = rim_m

    def depth(self, places: Float[np.ndarray, "places 2"]) -> Float[np.ndarray, " places"]:
        """Return the depth of table positions inside the cloth's edge [m]; negative outside."""
        columns, rows = (places - self._origin).T / GRID_M - 0.5
        return map_coordinates(self._signed, [rows, columns], order=1, mode="nearest")

    def beyond(self, polygon: Float[np.ndarray, "corners 2"]) -> Float[np.ndarray, " outline"]:
        """Return the distance of the cloth's edge outside a ccw polygon [m]; negative inside."""
        ahead = np.roll(polygon, -1, axis=0) - np.roll(polygon, 1, axis=0)
        normals = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        away, nearest = cKDTree(polygon).query(self.outline)
        across = np.einsum("od,od->o", self.outline - polygon[nearest], normals[nearest])
        # Far from the polygon its normals are meaningless.
        across = np.where(away < 2.0 * _OUTLINE_SPACING_M, across, np.copysign(away, across))
        return across + self._rim_m

    def _to_plane(self, pixels: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "pixels 2"]:
        return (pixels + 0.5) * GRID_M + self._origin


def _unit_outline(kind: str) -> Float[np.ndarray, "corners 2"]:
    """Return the silhouette of a flat garment of 1 m x 1 m [m], counter-clockwise, evenly sampled.

    Garments scale in proportion along x and y, so this is the outline of every size.
    """
    return _outline_of(garment(kind, vertex_count=1000, size_m=(1.0, 1.0)))


def _outline_of(flat: ClothMesh) -> Float[np.ndarray, "corners 2"]:
    """Return the silhouette of a flat garment around the origin [m], as `_unit_outline`."""
    pixels = 2000
    half = float(np.abs(flat.vertices[:, :2]).max()) + 0.05
    corners = np.rint((flat.vertices[:, :2] + half) * pixels).astype(np.int32)
    drawn = np.zeros((round(2.0 * half * pixels),) * 2, dtype=np.uint8)
    for face in flat.faces:
        cv2.fillConvexPoly(drawn, corners[face], 1)
    contour = _largest_outline(drawn > 0)
    return _even_steps(contour[:, 0] / pixels - half, 0.008)


def _fit_outline(
    unit: Float[np.ndarray, "corners 2"],
    covered: _CoveredRegion,
    start_angle: float,
    size_m: tuple[float, float] | None,
) -> OptimizeResult:
    """Solve a robust least-squares fit of two outlines, with residuals in both directions.

    Variables are the position [m], the angle [rad] and, when the size is not given, the logarithms
    of width and length.
    """
    turned = _rotated(covered.outline, -start_angle)
    low, high = turned.min(axis=0), turned.max(axis=0)
    place = _rotated(0.5 * (low + high)[None], start_angle)[0]
    start = np.array([*place, start_angle, *([] if size_m else np.log(high - low))])

    def residuals(variables: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " residuals"]:
        size = size_m or np.exp(variables[3:])
        polygon = _rotated(unit * size, variables[2]) + variables[:2]
        ours, theirs = covered.depth(polygon), covered.beyond(polygon)
        return np.concatenate([ours, theirs * np.sqrt(len(ours) / len(theirs))])

    def slopes(
        variables: Float[np.ndarray, " variables"],
    ) -> Float[np.ndarray, "residuals variables"]:
        here = residuals(variables)
        steps = np.eye(len(variables)) * _STEP
        return np.stack([(residuals(variables + step) - here) / _STEP for step in steps], axis=1)

    return least_squares(
        residuals, start, slopes, method="trf", loss="soft_l1", f_scale=_OUTLIER_M, xtol=1e-5
    )


_STEP = 1e-3
"""Step of the numerical derivative; the outline of grid cells is rough below 1 mm."""


def _largest_outline(mask: Bool[np.ndarray, "rows columns"]) -> np.ndarray:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return max(contours, key=cv2.contourArea)


def _distance_inside(mask: Bool[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Return the distance [m] of every set cell to the nearest unset one."""
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) * np.float32(GRID_M)


def _even_steps(
    closed: Float[np.ndarray, "corners 2"], spacing_m: float = _OUTLINE_SPACING_M
) -> Float[np.ndarray, "samples 2"]:
    """Return a closed polygon resampled at equal distances [m], counter-clockwise."""
    x, y = closed.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) < 0:
        closed = closed[::-1]
    around = np.concatenate([closed, closed[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(around, axis=0), axis=1))])
    at = np.linspace(0.0, length[-1], max(8, round(length[-1] / spacing_m)), endpoint=False)
    return np.stack([np.interp(at, length, axis) for axis in around.T], axis=1)


def _rotated(points: Float[np.ndarray, "points 2"], angle: float) -> Float[np.ndarray, "points 2"]:
    cosine, sine = np.cos(angle), np.sin(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def _plane_axes(table: Table) -> Float[np.ndarray, "3 3"]:
    """Return rows of two table directions, the first nearest the world's x, and the normal."""
    normal = table.normal / np.linalg.norm(table.normal)
    first = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    if np.linalg.norm(first) < 1e-3:
        first = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])
