"""Checks of the intrinsics, by themselves and against the outline of a flat towel."""

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import camera_views
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import HeightSegmenter, default_segmenter

_FARTHEST_CENTER = 0.05
"""Largest distance of the principal point from the middle of the picture, as a share of its side.
Lenses of depth cameras are mounted to 2 %; intrinsics of another picture size are farther off."""

_WHOLE_PICTURES = (4 / 3, 16 / 9, 16 / 10, 5 / 4)
"""Ratios of the sides of pictures as sensors give them. Others may have been cut out of a larger
picture, whose principal point may be anywhere."""

_LARGEST_FOCAL_RATIO = 1.04
"""Largest ratio of fx and fy. Pixels of sensors are square within 0.1 %; one real data set states
2.9 %."""

_LARGEST_SAG = 0.006
"""Bulge of the sides of a flat towel, as a share of their length, from which the lens is doubted.
On right recordings it is below 0.3 %."""

_LEAST_STRAIGHTENED = 0.5
"""Least share of the bulge of all four sides that one distortion coefficient must explain."""

_LEAST_SIDE_PX = 100
"""Sides shorter than this [pixels] are not measured; their bulge would be less than a pixel."""


_Sides = tuple[Float[np.ndarray, "_ 2"], ...]
"""Pixels (column, row) along each side of a towel, in order around it."""


def lens_findings(recording: Recording) -> list[Finding]:
    """Return intrinsics that no camera has, or that bend or skew a flat towel."""
    for place, camera in enumerate(recording.cameras):
        field = f"cameras[{place}]"
        found = _center(camera, field) or _focal_ratio(camera, field)
        if found:
            return [found]
    outline = _towel_outline(recording)
    if outline is None:
        return []
    bulge = _bulge(outline, recording.cameras[0])
    return [bulge] if bulge else []


def _center(camera: Camera, field: str) -> Finding | None:
    if not any(abs(camera.width / camera.height / ratio - 1) < 0.01 for ratio in _WHOLE_PICTURES):
        return None
    middle = (camera.width - 1) / 2, (camera.height - 1) / 2
    off = (camera.cx - middle[0]) / camera.width, (camera.cy - middle[1]) / camera.height
    worst = max(abs(off[0]), abs(off[1]))
    if worst <= _FARTHEST_CENTER:
        return None
    return Finding(
        "principal_point", worst, _FARTHEST_CENTER, "", f"{field}.cx, cy",
        f"the principal point ({camera.cx:g}, {camera.cy:g}) of camera {camera.name!r} is "
        f"{100 * worst:.0f} % of the picture from its middle ({middle[0]:g}, {middle[1]:g}) (at "
        f"most {100 * _FARTHEST_CENTER:.0f} %): give fx, fy, cx and cy for pictures of "
        f"{camera.width} x {camera.height} pixels; right only if these were cut out of larger ones",
    )  # fmt: skip


def _focal_ratio(camera: Camera, field: str) -> Finding | None:
    ratio = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if ratio <= _LARGEST_FOCAL_RATIO:
        return None
    return Finding(
        "focal_ratio", ratio, _LARGEST_FOCAL_RATIO, "", f"{field}.fx, fy",
        f"fx {camera.fx:g} and fy {camera.fy:g} of camera {camera.name!r} differ by "
        f"{100 * (ratio - 1):.0f} % (at most {100 * (_LARGEST_FOCAL_RATIO - 1):.0f} %): pixels are "
        "square, correct the wrong one",
    )  # fmt: skip


def _towel_outline(recording: Recording) -> _Sides | None:
    """Return the four sides of a towel in the first frame; None if it is no clean rectangle."""
    contour = _towel_contour(recording)
    if contour is None:
        return None
    length = cv2.arcLength(contour.astype(np.float32), True)
    corners = cv2.approxPolyDP(contour.astype(np.float32), 0.03 * length, True)[:, 0]
    if len(corners) != 4:
        return None
    places = np.sort([int(np.argmin(((contour - corner) ** 2).sum(axis=1))) for corner in corners])
    sides = []
    for begin, end in zip(places, [*places[1:], places[0] + len(contour)], strict=True):
        side = contour[np.arange(begin, end + 1) % len(contour)]
        if len(side) < _LEAST_SIDE_PX:
            return None
        # Leave out the corners, which are round and off by a few pixels.
        cut = len(side) // 12
        sides.append(side[cut : len(side) - cut])
    return tuple(sides)


def _towel_contour(recording: Recording) -> Float[np.ndarray, "pixels 2"] | None:
    """Return the outline of the towel in the first frame; None if its color does not show all."""
    camera = recording.cameras[0]
    if recording.cloth.kind != "towel" or recording.table is None:
        return None
    try:
        segmenter = default_segmenter(recording, recording.frames[0], camera)
        views = camera_views(recording, recording.frames[0])
    except ClothTrackError:
        return None
    if isinstance(segmenter, HeightSegmenter) or not views:
        return None
    mask = views[0].mask.astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    contour = max(contours, key=len)[:, 0].astype(np.float64)
    far = (camera.width - 2, camera.height - 2)
    cut_off = ((contour < 1) | (contour > far)).any()
    return None if cut_off or len(contour) < 4 * _LEAST_SIDE_PX else contour


def _bulge(outline: _Sides, camera: Camera) -> Finding | None:
    """Return a finding if the four sides bulge like under radial distortion of the lens."""
    sides = [(side - (camera.cx, camera.cy)) / (camera.fx, camera.fy) for side in outline]
    sags = np.array([_sag(side) for side in sides])
    worst = float(np.abs(sags).max())
    if worst <= _LARGEST_SAG:
        return None
    tried = np.linspace(-0.5, 0.5, 101)
    left = [float(np.mean([_sag(_undistorted(side, k1)) ** 2 for side in sides])) for k1 in tried]
    best = int(np.argmin(left))
    if left[best] > (1 - _LEAST_STRAIGHTENED) ** 2 * float(np.mean(sags**2)):
        return None
    k1 = round(float(tried[best]), 3)
    return Finding(
        "lens_distortion", worst, _LARGEST_SAG, "", "cameras[0]",
        f"the sides of the flat towel bulge by {100 * worst:.1f} % of their length (at most "
        f"{100 * _LARGEST_SAG:.1f} %), as a lens with k1 = {k1:g} makes them: undistort color, "
        "depth and masks before they are written",
    )  # fmt: skip


def _sag(side: Float[np.ndarray, "points 2"]) -> float:
    """Return the height of the parabola through a side over its chord, as a share of its length."""
    middle = side.mean(axis=0)
    _, _, axes = np.linalg.svd(side - middle, full_matrices=False)
    along, off = ((side - middle) @ axes.T).T
    length = float(np.ptp(along))
    curvature = float(np.polyfit(along / max(length, 1e-12), off, 2)[0])
    return curvature / 4.0 / max(length, 1e-12)


def _undistorted(side: Float[np.ndarray, "points 2"], k1: float) -> Float[np.ndarray, "points 2"]:
    """Return normalized points of a lens with k1 as a pinhole camera sees them (four rounds)."""
    straight = side
    for _ in range(4):
        straight = side / (1.0 + k1 * (straight**2).sum(axis=1, keepdims=True))
    return straight
