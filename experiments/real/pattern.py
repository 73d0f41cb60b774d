"""Pattern drift: how far the print slides on the tracked cloth.

This measure does not depend on depth. The color picture is unwrapped onto the mesh, and patches of
the unwrapped print are searched for in the print unwrapped from the first frame. If the mesh
follows the material, a patch is found at its original position. If the mesh slides along the cloth,
the patch is found next to it, and if the mesh is lost, nothing correlates.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from clothtrack.geometry.camera import Camera


@dataclass(frozen=True)
class PatternConfig:
    """How the print is unwrapped and matched.

    Attributes:
        texel_m: side of a pixel of the unwrapped print [m].
        patch_m: side of a patch [m].
        stride_m: distance between neighboring patches [m].
        margin_m: a patch keeps this distance from the rim of the cloth [m], where the picture
            shows the hem and what is behind the cloth.
        search_m: how far from its place a patch is looked for [m]; beyond about 20 mm it may
            lock on the repeat of the print.
        correlation: a patch matches above this normalized correlation.
    """

    texel_m: float = 0.003
    patch_m: float = 0.093
    stride_m: float = 0.03
    margin_m: float = 0.015
    search_m: float = 0.045
    correlation: float = 0.8


@dataclass(frozen=True, eq=False)
class PatternDrift:
    """Where the patches of one frame were found.

    Attributes:
        center_m: middle of each patch on the flat cloth, from its lowest corner [m].
        slide_m: distance of each patch from its place in the first frame [m].
        correlation: normalized correlation of each patch at its best place.
        matched_above: the correlation above which a patch counts as matched.
    """

    center_m: Float[np.ndarray, "patches 2"]
    slide_m: Float[np.ndarray, " patches"]
    correlation: Float[np.ndarray, " patches"]
    matched_above: float

    @property
    def matched(self) -> float:
        """Share of the patches that match."""
        return float((self.correlation > self.matched_above).mean())

    @property
    def mean_slide_mm(self) -> float | None:
        """Mean slide over the patches that match [mm]; None when the print is lost."""
        found = self.correlation > self.matched_above
        return float(self.slide_m[found].mean() * 1e3) if found.any() else None


class Unwrapper:
    """Unwraps pictures onto a cloth of given flat coordinates, one texel grid for all frames."""

    def __init__(
        self, material: Float[np.ndarray, "vertices 2"], config: PatternConfig | None = None
    ) -> None:
        """Lay the texel grid over the flat cloth.

        Args:
            material: flat coordinates of the vertices [m]; the cloth fills its bounding box.
        """
        config = PatternConfig() if config is None else config
        low, high = material.min(axis=0), material.max(axis=0)
        counts = np.floor((high - low) / config.texel_m).astype(int)
        axes = [
            start + (np.arange(count) + 0.5) * config.texel_m
            for start, count in zip(low, counts, strict=True)
        ]
        self._texels = np.stack(np.meshgrid(*axes, indexing="xy"), axis=-1)
        self._triangles = Delaunay(material)

    def __call__(
        self,
        picture: UInt8[np.ndarray, "height width 3"],
        vertices: Float[np.ndarray, "vertices 3"],
        camera: Camera,
    ) -> UInt8[np.ndarray, "rows columns 3"]:
        """Return the print as it lies on the flat cloth, sampled from the picture (bicubic)."""
        points = LinearNDInterpolator(self._triangles, vertices)(self._texels)
        pixels, _ = camera.project(points.reshape(-1, 3))
        pixels = np.nan_to_num(pixels, nan=-1e4).astype(np.float32)
        pixels = pixels.reshape(*self._texels.shape[:2], 2)
        return cv2.remap(
            picture, pixels[..., 0], pixels[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
        )


def pattern_drift(
    first: UInt8[np.ndarray, "rows columns 3"],
    later: UInt8[np.ndarray, "rows columns 3"],
    config: PatternConfig | None = None,
) -> PatternDrift:
    """Return slide of each patch of the first unwrapped print in a later one."""
    config = PatternConfig() if config is None else config
    patch, stride, margin, search = (
        round(length / config.texel_m)
        for length in (config.patch_m, config.stride_m, config.margin_m, config.search_m)
    )
    centers, slides, correlations = [], [], []
    for row in range(margin, first.shape[0] - patch - margin + 1, stride):
        for column in range(margin, first.shape[1] - patch - margin + 1, stride):
            window = first[row : row + patch, column : column + patch]
            top, left = max(row - search, 0), max(column - search, 0)
            around = later[top : row + patch + search, left : column + patch + search]
            scores = cv2.matchTemplate(around, window, cv2.TM_CCOEFF_NORMED)
            scores = np.nan_to_num(scores, nan=0.0, posinf=0.0, neginf=0.0)
            best = np.unravel_index(int(scores.argmax()), scores.shape)
            found = _peak(scores, best) + np.array([top - row, left - column])
            centers.append(np.array([column + 0.5 * patch, row + 0.5 * patch]) * config.texel_m)
            slides.append(float(np.hypot(*found)) * config.texel_m)
            correlations.append(float(scores[best]))
    return PatternDrift(
        np.array(centers).reshape(-1, 2),
        np.array(slides),
        np.array(correlations),
        config.correlation,
    )


def _peak(
    scores: Float[np.ndarray, "rows columns"], best: tuple[np.intp, ...]
) -> Float[np.ndarray, " 2"]:
    """Return the place of the maximum between the pixels: a parabola along each axis."""
    place = np.array(best, dtype=float)
    for axis, size in enumerate(scores.shape):
        if 0 < best[axis] < size - 1:
            line = np.take(scores, best[1 - axis], axis=1 - axis)
            before, here, after = line[best[axis] - 1 : best[axis] + 2].astype(float)
            bend = before - 2.0 * here + after
            if bend < 0:
                place[axis] += 0.5 * (before - after) / bend
    return place
