"""The outline of a flat garment in a picture: a smooth closed curve on the table, in meters."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import savgol_filter

from clothtrack.errors import InvalidRecordingError
from clothtrack.garments.triangulation import evenly_along

Outline = Float[np.ndarray, "_ 2"]
ToPlane = Callable[[Outline], Outline]

_OUTLINE_POINTS = 1200
"""Number of equally spaced points of an outline; 2 to 4 mm apart for most garments."""

_SMALLEST_CLOTH_PX = 400
"""Minimum pixels of a cloth whose outline can be measured."""

_SMOOTHING_PX = 13.0
"""Length of the outline [pixels] to which a parabola is fitted. It reduces border errors of two
pixels to one, and moves corners by at most two."""

_SPECK_SHARE = 0.02
"""A second piece or a hole with more than this share of the cloth is not a speck of the sensor."""

_MEDIAN_PX = 5
"""Side of the median filter's square [pixels]; the filter removes gaps and hairs of the mask."""

_SUBPIXELS = 4
_ANGLES = 180
_MIRROR_GRID = 192
_SYMMETRY_GRID = 512


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Outline of a flat garment, counterclockwise as seen from above.

    Attributes:
        points: points on the table [m], y away from the viewer of the picture.
        pixels: the same points in the picture: column and row.
    """

    points: Outline
    pixels: Outline

    def upright(self, angle_rad: float) -> "Silhouette":
        """Rotate about the origin so that the direction of this angle [rad] points along +y."""
        cosine, sine = np.cos(angle_rad - np.pi / 2), np.sin(angle_rad - np.pi / 2)
        return replace(self, points=self.points @ np.array([[cosine, -sine], [sine, cosine]]))

    def shifted(self, by: Float[np.ndarray, " 2"]) -> "Silhouette":
        """Shift on the table [m]."""
        return replace(self, points=self.points + by)

    def mirrored(self) -> "Silhouette":
        """Reflect in the axis x = 0; the outline stays counterclockwise."""
        return Silhouette((self.points * (-1.0, 1.0))[::-1], self.pixels[::-1])


def silhouette(
    mask: Bool[np.ndarray, "height width"], to_plane: ToPlane, name: str = "the picture"
) -> Silhouette:
    """Return the outline of the cloth in a mask.

    Args:
        to_plane: maps pixels (column and row, centers at integers) to positions on the table [m],
            seen from above.
    """
    filled = _whole_cloth(mask, name)
    margin = 4
    padded = cv2.GaussianBlur(np.pad(filled, margin).astype(np.float32), (0, 0), 1.0)
    height, width = padded.shape
    fine = cv2.resize(padded, (width * _SUBPIXELS, height * _SUBPIXELS))
    contours, _ = cv2.findContours(
        (fine > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    contour = max(contours, key=cv2.contourArea)[:, 0].astype(np.float64)
    # The contour runs through the centers of the outermost subpixels.
    pixels = _evenly((contour + 0.5) / _SUBPIXELS - 0.5 - margin, _OUTLINE_POINTS)
    step_px = float(np.linalg.norm(np.diff(pixels, axis=0), axis=1).mean())
    window = 2 * round(0.5 * max(5.0, _SMOOTHING_PX / step_px)) + 1
    pixels = savgol_filter(pixels, window, 2, axis=0, mode="wrap")
    points = to_plane(pixels)
    if signed_area(points) < 0.0:
        points, pixels = points[::-1], pixels[::-1]
    return Silhouette(points, pixels)


def signed_area(polygon: Outline) -> float:
    """Return the area [m^2] of a polygon, positive if it is counterclockwise."""
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def mirror_axis(points: Outline) -> tuple[float, Float[np.ndarray, " 2"]]:
    """Return the line about which an outline is most symmetric.

    Returns:
        Its direction [rad], one of two, and a point on it [m].
    """
    grid = _Grid(points)
    center = grid.centroid
    angles = np.linspace(0.0, np.pi, _ANGLES, endpoint=False)
    shares = [grid.overlap(_reflected(points, angle, center)) for angle in angles]
    angle, offset = float(angles[int(np.argmax(shares))]), 0.0
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))
    for turn, shift in ((0.01, 0.008), (0.005, 0.004), (0.0025, 0.002)):
        tries = [
            (angle + i * turn, offset + j * shift * reach) for i in range(-2, 3) for j in (-1, 0, 1)
        ]
        angle, offset = max(
            tries,
            key=lambda line: grid.overlap(
                _reflected(points, line[0], center + line[1] * _across(line[0]))
            ),
        )
    return angle, center + offset * _across(angle)


def symmetric(points: Outline) -> Outline:
    """Return the outline halfway between an outline and its mirror image in the axis x = 0.

    It is where their signed distances cancel. This reduces noise and makes both halves equal.
    """
    reach = 1.1 * float(np.abs(points).max())
    scale = _SYMMETRY_GRID / (2.0 * reach)
    distance = np.zeros((_SYMMETRY_GRID, _SYMMETRY_GRID), np.float32)
    for side in (1.0, -1.0):
        places = np.rint(((points * (side, 1.0) + reach) * scale - 0.5) * 16.0).astype(np.int32)
        drawn = cv2.fillPoly(np.zeros(distance.shape, np.uint8), [places], 1, shift=4)
        distance += cv2.distanceTransform(drawn, cv2.DIST_L2, 5)
        distance -= cv2.distanceTransform(1 - drawn, cv2.DIST_L2, 5)
    contours, _ = cv2.findContours(
        (distance > 0.0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    contour = max(contours, key=cv2.contourArea)[:, 0].astype(np.float64)
    outline = _evenly((contour + 0.5) / scale - reach, _OUTLINE_POINTS)
    outline = np.asarray(savgol_filter(outline, 11, 2, axis=0, mode="wrap"))
    return outline if signed_area(outline) > 0.0 else outline[::-1]


class _Grid:
    """Outline drawn on a grid, for comparison with others."""

    def __init__(self, points: Outline) -> None:
        reach = 1.2 * float(np.ptp(points, axis=0).max())
        self._scale = _MIRROR_GRID / (2.0 * reach)
        self._origin = points.mean(axis=0) - reach
        self._drawn = self._draw(points)
        rows, columns = np.nonzero(self._drawn)
        self.centroid = np.array([columns.mean(), rows.mean()]) / self._scale + self._origin

    def overlap(self, points: Outline) -> float:
        """Return the intersection over union with another outline."""
        other = self._draw(points)
        return float((self._drawn & other).sum() / max(1, (self._drawn | other).sum()))

    def _draw(self, points: Outline) -> Bool[np.ndarray, "rows columns"]:
        places = np.rint((points - self._origin) * self._scale * 16.0).astype(np.int32)
        image = np.zeros((_MIRROR_GRID, _MIRROR_GRID), np.uint8)
        return cv2.fillPoly(image, [places], 1, shift=4) > 0


def _across(angle: float) -> Float[np.ndarray, " 2"]:
    return np.array([-np.sin(angle), np.cos(angle)])


def _reflected(points: Outline, angle: float, through: Float[np.ndarray, " 2"]) -> Outline:
    normal = _across(angle)
    return points - 2.0 * ((points - through) @ normal)[:, None] * normal


def _evenly(closed: Outline, count: int) -> Outline:
    return evenly_along(np.concatenate([closed, closed[:1]]), count + 1)[:-1]


def _whole_cloth(
    mask: Bool[np.ndarray, "height width"], name: str
) -> Bool[np.ndarray, "height width"]:
    """Return the single piece of cloth in a mask, with specks filled."""
    closed = cv2.medianBlur(mask.astype(np.uint8), _MEDIAN_PX)
    _, label, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    largest = int(areas.argmax())
    if areas[largest] < _SMALLEST_CLOTH_PX:
        raise InvalidRecordingError(
            f"{name}: the cloth has {areas[largest]} pixels, at least {_SMALLEST_CLOTH_PX} are "
            "needed; check the mask, or go nearer with the camera"
        )
    second = int(np.sort(areas)[-2])
    if second > _SPECK_SHARE * areas[largest]:
        raise InvalidRecordingError(
            f"{name}: the cloth is in two pieces of {areas[largest]} and {second} pixels; lay down "
            "one garment, or let its mask (that of the recording, or --mask) show one"
        )
    cloth = label == largest
    if cloth[0].any() or cloth[-1].any() or cloth[:, 0].any() or cloth[:, -1].any():
        raise InvalidRecordingError(
            f"{name}: the cloth touches the border of the picture; the whole garment must be seen"
        )
    contours, _ = cv2.findContours(cloth.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.fillPoly(np.zeros(mask.shape, np.uint8), contours, 1) > 0
    holes = cv2.connectedComponentsWithStats((filled & ~cloth).astype(np.uint8), connectivity=4)[2]
    hole = int(holes[1:, cv2.CC_STAT_AREA].max(initial=0))
    if hole > _SPECK_SHARE * areas[largest]:
        raise InvalidRecordingError(
            f"{name}: the cloth has a hole of {hole} of {areas[largest]} pixels; a sleeve that "
            "touches the body, or a wrong mask: lay it out again, or give a mask without the hole"
        )
    return filled
