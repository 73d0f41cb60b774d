"""The network's picture: the cloth seen by a virtual camera straight above it.

The virtual camera always has the same lens, and its height grows with the width of the cloth, so
that the cloth fills the picture and the depth still determines its size. Training and
reconstruction take their pictures here, from one function each.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera

JUMP_M = 0.02
"""Neighboring pixels farther apart than this [m] are not joined; the nearer one hides the gap."""

LEAST_PIXELS = 16
"""A picture with fewer pixels of cloth [pixels] shows no cloth."""

OUTLIERS = 0.5
"""Share of the points beyond either end of the cloth's extent [%], which are noise."""

CLEAR = 1.5
"""Least height of the virtual camera over the cloth's lowest point, over the cloth's height."""


@runtime_checkable
class ViewConfig(Protocol):
    """Picture settings of a network."""

    @property
    def image_size(self) -> int:
        """Pixels of the picture along each side."""
        ...

    @property
    def output_size(self) -> int:
        """Pixels of the canonical picture along each side."""
        ...

    @property
    def output_stride(self) -> int:
        """Pixels of the picture per pixel of the canonical picture, along each axis."""
        ...

    @property
    def field_of_view_deg(self) -> float:
        """Field of view of the virtual camera [deg]."""
        ...

    @property
    def view_margin(self) -> float:
        """Free space around the cloth, over its extent."""
        ...

    @property
    def least_view_m(self) -> float:
        """Minimum extent that the picture shows [m]."""
        ...


@dataclass(frozen=True, eq=False)
class CroppedView:
    """The network's picture of a cloth.

    Attributes:
        depth: distance along the virtual camera's optical axis [m]; 0 where there is no cloth.
        camera: virtual camera; its pixels are those of `depth`.
        mask: pixels where cloth was measured.
    """

    depth: Float32[np.ndarray, "height width"]
    camera: Camera
    mask: Bool[np.ndarray, "height width"]


@dataclass(frozen=True, eq=False)
class ClothPixels:
    """Pixels of the canonical picture that show cloth, and the measurement of each.

    Attributes:
        pixels: row and column in the canonical picture.
        sources: row and column, in the depth picture, of the measurement that represents it.
    """

    pixels: Int[np.ndarray, "pixels 2"]
    sources: Int[np.ndarray, "pixels 2"]


def view_camera(points: Float[np.ndarray, "points 3"], config: ViewConfig) -> Camera:
    """Return the virtual camera above a cloth, looking straight down, image right along world x.

    Args:
        points: points of the cloth [m], world, z up.
    """
    low, high = np.percentile(points, [OUTLIERS, 100.0 - OUTLIERS], axis=0)
    middle = 0.5 * (low + high)
    side = max(float((high - low)[:2].max()) * (1.0 + 2.0 * config.view_margin),
               config.least_view_m)  # fmt: skip
    half_angle = np.radians(config.field_of_view_deg) / 2.0
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    # The plane of the lowest points is approximately the table and fills the picture exactly.
    # Raise the camera so that lifted cloth stays in the picture and below the camera.
    out, up = np.abs(points[:, :2] - middle[:2]).max(axis=1), points[:, 2] - low[2]
    in_view_m = np.percentile(out / np.tan(half_angle) + up, 100.0 - OUTLIERS)
    above_m = max(
        0.5 * side / np.tan(half_angle), float(in_view_m), CLEAR * float(high[2] - low[2])
    )
    pose[:3, 3] = middle[0], middle[1], low[2] + above_m
    size = config.image_size
    focal = 0.5 * size / np.tan(half_angle)
    center = 0.5 * (size - 1)
    return Camera("above", size, size, focal, focal, center, center, pose)


def crop(
    depth_m: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"] | None,
    camera: Camera,
    config: ViewConfig,
) -> CroppedView:
    """Return the network's picture from a depth picture of any camera.

    Neighboring pixels are joined to a surface that the virtual camera renders. The surface has no
    holes, and areas that the real camera did not see stay empty.

    Args:
        depth_m: measured depth [m]; 0 where nothing was measured.
    """
    # Imported here, because batches are cropped without Warp (`batch_view.py`), which may not be
    # installed there.
    from clothtrack.geometry.visibility import Rasterizer

    shown = _cloth_shown(depth_m, mask, camera)
    points = camera.back_project(depth_m, shown)
    above = view_camera(points, config)
    faces = _joined(depth_m, shown)
    if len(faces) == 0:
        raise InvalidRecordingError(
            f"camera {camera.name!r}: no three neighboring pixels of cloth have a depth; "
            "the depth picture is too sparse or its mask is wrong"
        )
    depth = Rasterizer(faces, above).render(points).depth
    seen = np.isfinite(depth)
    return CroppedView(np.where(seen, depth, 0.0).astype(np.float32), above, seen)


def cloth_pixels(depth: Float[np.ndarray, "height width"], config: ViewConfig) -> ClothPixels:
    """Return the pixels of the canonical picture that show cloth, in the order of their rows.

    An output pixel represents a block of the depth picture. It uses the measurement nearest to the
    camera and not the mean, which could lie between two layers.

    Args:
        depth: the network's picture [m]; 0 where there is no cloth.
    """
    stride, size = config.output_stride, config.output_size
    blocks = depth.reshape(size, stride, size, stride).transpose(0, 2, 1, 3)
    blocks = np.where(blocks > 0, blocks, np.inf).reshape(size, size, -1)
    rows, columns = np.nonzero(np.isfinite(blocks.min(axis=-1)))
    row_in, column_in = np.divmod(blocks[rows, columns].argmin(axis=-1), stride)
    pixels = np.stack([rows, columns], axis=1)
    return ClothPixels(pixels, pixels * stride + np.stack([row_in, column_in], axis=1))


def points_of(
    depth: Float[np.ndarray, "height width"], camera: Camera, sources: Int[np.ndarray, "pixels 2"]
) -> Float[np.ndarray, "pixels 3"]:
    """Return world positions [m] of measured pixels (row, column) of the network's picture."""
    rows, columns = sources.T
    along = depth[rows, columns].astype(np.float64)
    local = np.stack(
        [
            (columns - camera.cx) / camera.fx * along,
            (rows - camera.cy) / camera.fy * along,
            along,
        ],
        axis=1,
    )
    return local @ camera.world_from_camera[:3, :3].T + camera.position


def _cloth_shown(
    depth_m: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"] | None,
    camera: Camera,
) -> Bool[np.ndarray, "height width"]:
    """Return pixels where cloth was measured, or raise an error that explains why there is none."""
    where = f"camera {camera.name!r}"
    for name, picture in (("depth", depth_m), ("mask", mask)):
        if picture is not None and picture.shape != (camera.height, camera.width):
            raise InvalidRecordingError(
                f"{where}: the {name} picture has {picture.shape[1]} x {picture.shape[0]} pixels, "
                f"the camera {camera.width} x {camera.height}; give the camera of this picture"
            )
    shown = np.isfinite(depth_m) & (depth_m > 0)
    if mask is not None:
        shown &= mask
    if int(shown.sum()) < LEAST_PIXELS:
        raise InvalidRecordingError(
            f"{where}: {int(shown.sum())} pixels of cloth have a depth, at least {LEAST_PIXELS} "
            "are needed; check the mask, and that 0 means not measured"
        )
    typical = float(np.median(depth_m[shown]))
    if not 0.05 < typical < 20.0:
        raise InvalidRecordingError(
            f"{where}: the cloth is {typical:.4g} m away (allowed 0.05 to 20 m); "
            "is the depth in millimeters? Give the unit of a pixel in meters"
        )
    return shown


def _joined(
    depth_m: Float[np.ndarray, "height width"], shown: Bool[np.ndarray, "height width"]
) -> Int[np.ndarray, "faces 3"]:
    """Return triangles between neighboring pixels, as indices of the shown pixels in row order."""
    index = np.cumsum(shown.ravel()).reshape(shown.shape) - 1
    a, b = (slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))
    c, d = (slice(1, None), slice(None, -1)), (slice(1, None), slice(1, None))
    faces = []
    for corners in ((a, c, b), (b, c, d)):
        depths = np.stack([depth_m[one] for one in corners])
        whole = np.logical_and.reduce([shown[one] for one in corners])
        whole &= np.ptp(np.where(whole, depths, 0.0), axis=0) < JUMP_M
        faces.append(np.stack([index[one][whole] for one in corners], axis=1))
    return np.concatenate(faces)
