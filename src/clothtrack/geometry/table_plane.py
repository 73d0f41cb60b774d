"""Fit the table's plane to depth, and define the world by it: z up, the table at z = 0.

A plane seen by a pinhole camera is also a plane in inverse depth: 1/z = a x + b y + c with
x = (column - cx)/fx and y = (row - cy)/fy. The noise of a stereo camera is uniform there (in depth
it grows with the square of the depth), so plain least squares weights near and far pixels
correctly.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera

LEAST_POINTS = 200
"""Minimum number of measurements for a plane."""

_ROUNDS = 8
_MARGIN = np.ones((13, 13), np.uint8)
PIXELS = 40_000
"""Approximate number of measurements from all pictures together; it bounds the time."""
TRIALS = 400
"""Planes through three random measurements; at `LEAST_SHARE` they miss the table once in 50,000."""
_TOLERANCE = 0.008
"""Deviation in inverse depth [1/m] within which a measurement may be table; 4.5 mm at 0.75 m."""
LEAST_SHARE = 0.3
"""Minimum share of the measurements on the table's plane."""
_RIVAL_SHARE = 0.7
"""Another plane with this share of the first one's measurements may also be the table."""
_LOWER_M = 0.05
"""A plane at most this far [m] below the first one is the table, and the first one lies on it."""
_LOWER_SHARE = 0.12
"""Minimum share of measurements on such a plane: the rim around a cloth that covers the table."""
_SEED = 0


@dataclass(frozen=True, eq=False)
class TableFit:
    """Plane of the table in the frame of a camera.

    Attributes:
        normal: unit normal in the camera's frame, toward the camera.
        distance_m: distance from the camera to the plane [m].
        residual_m: root mean square distance of the inliers from the plane [m].
        inlier_share: share of the measurements without cloth that lie on the plane.
        cloth_excluded: whether the cloth was known and left out.
    """

    normal: Float[np.ndarray, " 3"]
    distance_m: float
    residual_m: float
    inlier_share: float
    cloth_excluded: bool = False
    frames: int = 1

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the table's normal [degrees]."""
        return float(np.degrees(np.arccos(np.clip(-self.normal[2], -1.0, 1.0))))


def off_cloth(
    depth_m: Float[np.ndarray, "height width"], cloth: Bool[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width"]:
    """Return the depth [m] without the cloth and a margin for errors of its mask."""
    return np.where(cv2.dilate(cloth.astype(np.uint8), _MARGIN) > 0, 0.0, depth_m)


def sight_lines(
    depth_m: Float[np.ndarray, "height width"], camera: Camera, *, stride: int = 1, offset: int = 0
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
    """Return directions (x, y, 1) of measured pixels [camera frame] and inverse depths [1/m].

    Args:
        depth_m: depth [m], 0 without a measurement.
    """
    places = np.flatnonzero(depth_m > 0)[offset % stride :: stride]
    rows, columns = np.divmod(places, depth_m.shape[1])
    sight = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(len(places))],
        axis=1,
    )
    return sight, 1.0 / depth_m.ravel()[places].astype(np.float64)


def fit_plane(
    sight: Float[np.ndarray, "points 3"],
    inverse: Float[np.ndarray, " points"],
) -> TableFit:
    """Fit the dominant plane by random trials, then least squares over its inliers.

    Args:
        inverse: inverse depth along them [1/m].
    """
    rng = np.random.default_rng(_SEED)
    plane = _dominant(sight, inverse, rng)
    on_it = np.abs(inverse - sight @ plane) < _TOLERANCE
    share = float(on_it.mean())
    if share < LEAST_SHARE:
        raise InvalidRecordingError(
            f"no plane dominates: the best one holds {100 * share:.0f} % of the depth that is not "
            f"cloth (at least {100 * LEAST_SHARE:.0f} %); let the table fill most of the "
            "picture, and say what is cloth"
        )
    plane = _lower(sight, inverse, plane, rng)
    on_it = np.abs(inverse - sight @ plane) < _TOLERANCE
    _require_single(sight, inverse, plane, rng)
    plane, used = _refined(sight, inverse, plane)
    length = float(np.linalg.norm(plane))
    normal, distance = -plane / length, 1.0 / length
    points = sight[used] / inverse[used, None]
    residual = float(np.sqrt(np.mean((points @ normal + distance) ** 2)))
    return TableFit(normal, distance, residual, float(on_it.mean()))


def world_from_table(camera: Camera, table: TableFit) -> Float[np.ndarray, "4 4"]:
    """Return the transform from the camera to a world on the table.

    z is the table's normal, x is the camera's x axis projected onto the table, and the origin is
    the point of the table in the middle of the picture.
    """
    middle = np.array(
        [
            ((camera.width - 1) / 2.0 - camera.cx) / camera.fx,
            ((camera.height - 1) / 2.0 - camera.cy) / camera.fy,
            1.0,
        ]
    )
    approach = -float(middle @ table.normal)
    if approach < 0.05:
        raise InvalidRecordingError(
            f"camera {camera.name!r}: the plane found is seen edge-on ({table.tilt_deg:.0f} "
            "degrees from straight down); let the camera look down at the table"
        )
    origin = middle * (table.distance_m / approach)
    x = np.array([1.0, 0.0, 0.0])
    x -= (x @ table.normal) * table.normal
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(table.normal, x), table.normal])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ origin
    return pose


def _dominant(
    sight: Float[np.ndarray, "points 3"],
    inverse: Float[np.ndarray, " points"],
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:
    """Return the plane (a, b, c) through three random points that has the most inliers."""
    if len(sight) < LEAST_POINTS:
        raise InvalidRecordingError(
            f"only {len(sight)} measurements are left to find a plane in (at least "
            f"{LEAST_POINTS}); let the table be seen"
        )
    judges = rng.choice(len(sight), min(len(sight), 3000), replace=False)
    triples = rng.integers(len(sight), size=(TRIALS, 3))
    corners = sight[triples]
    sound = np.abs(np.linalg.det(corners)) > 1e-4
    planes = np.linalg.solve(corners[sound], inverse[triples[sound]][..., None])[..., 0]
    off = np.abs(planes @ sight[judges].T - inverse[judges])
    if not len(planes):
        raise InvalidRecordingError("all depth lies on one line; let the table be seen")
    best = planes[np.argmax((off < _TOLERANCE).sum(axis=1))]
    plane, _ = _refined(sight, inverse, best)
    return plane


def _refined(
    sight: Float[np.ndarray, "points 3"],
    inverse: Float[np.ndarray, " points"],
    plane: Float[np.ndarray, " 3"],
) -> tuple[Float[np.ndarray, " 3"], Bool[np.ndarray, " points"]]:
    """Fit by least squares to inliers; narrow their band to three times their own spread.

    The band stays wider than the quantization steps of the depth, because most of the pixels may
    lie on one step.
    """
    band = _TOLERANCE
    used = np.abs(inverse - sight @ plane) < band
    steps = np.diff(np.unique(inverse[used]))
    narrowest = max(1.5 * float(np.median(steps)) if len(steps) else 0.0, 1e-6)
    for _ in range(_ROUNDS):
        plane, *_ = np.linalg.lstsq(sight[used], inverse[used], rcond=None)
        off = np.abs(inverse - sight @ plane)
        spread = 1.4826 * float(np.median(off[off < _TOLERANCE]))
        band = min(_TOLERANCE, max(3.0 * spread, narrowest))
        before, used = used, off < band
        # Stop if the inliers are unchanged, because they give the same plane.
        if used.sum() < 3 or (used == before).all():
            break
    return plane, used


def _lower(
    sight: Float[np.ndarray, "points 3"],
    inverse: Float[np.ndarray, " points"],
    plane: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:
    """Return the plane just below this one, if any: then this one is cloth that lies on it."""
    length = float(np.linalg.norm(plane))
    height = 1.0 / length - (sight / inverse[:, None]) @ (plane / length)
    off = inverse - sight @ plane
    under = (height > -_LOWER_M) & (height < 0.0) & (off < -_TOLERANCE)
    if under.sum() < max(_LOWER_SHARE * len(sight), LEAST_POINTS):
        return plane
    lower = _dominant(sight[under], inverse[under], rng)
    shown = float((np.abs(inverse - sight @ lower) < _TOLERANCE).mean())
    parallel = abs(float(lower @ plane)) / (np.linalg.norm(lower) * length)
    return lower if shown > _LOWER_SHARE and parallel > np.cos(np.radians(3.0)) else plane


def _require_single(
    sight: Float[np.ndarray, "points 3"],
    inverse: Float[np.ndarray, " points"],
    plane: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> None:
    """Raise an error if another plane is nearly as large as this one and does not lie on it."""
    length = float(np.linalg.norm(plane))
    height = 1.0 / length - (sight / inverse[:, None]) @ (plane / length)
    beside = (height < -_LOWER_M) | (height > _LOWER_M)
    first = float((np.abs(inverse - sight @ plane) < _TOLERANCE).mean())
    if beside.mean() < _RIVAL_SHARE * first or beside.sum() < LEAST_POINTS:
        return
    rival = _dominant(sight[beside], inverse[beside], rng)
    second = float((np.abs(inverse[beside] - sight[beside] @ rival) < _TOLERANCE).mean())
    second *= float(beside.mean())
    if second > _RIVAL_SHARE * first:
        raise InvalidRecordingError(
            f"two planes are about as large, with {100 * first:.0f} and {100 * second:.0f} % of "
            "the depth: which is the table? Let it fill most of the picture"
        )
