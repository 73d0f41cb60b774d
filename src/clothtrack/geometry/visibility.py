"""Rendering of a mesh in a camera: depth image, face per pixel, visible vertices (z-buffer)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry import raster_kernels as kernels
from clothtrack.geometry.camera import Camera

_NEAREST_DEPTH_M = 1e-3
"""Surfaces nearer to the camera than this [m] are not drawn."""


@dataclass(frozen=True, eq=False)
class DepthBuffer:
    """Rendering of a mesh in a camera.

    Attributes:
        depth: distance along the optical axis at each pixel center [m]; infinite without a face.
        faces: index of the nearest face at each pixel center; -1 without a face.
    """

    depth: Float[np.ndarray, "height width"]
    faces: Int[np.ndarray, "height width"]


class Rasterizer:
    """Renderer of one mesh topology in one camera, with buffers that it reuses.

    Args:
        faces: vertex indices per triangle; drawn from both sides.
        camera: the camera; pixel centers at integers.
    """

    def __init__(
        self, faces: Int[np.ndarray, "faces 3"], camera: Camera, *, device: str = "cpu"
    ) -> None:
        if len(faces) == 0:
            raise InvalidConfigError("nothing to draw: the mesh has no face")
        self.camera = camera
        self.device = device
        self.faces = wp.array(np.ascontiguousarray(faces, np.int32), dtype=wp.vec3i, device=device)
        self.kernel_camera = _kernel_camera(camera)
        self.pixels = wp.empty(camera.width * camera.height, dtype=wp.uint64, device=device)

    def render(self, vertices: Float[np.ndarray, "vertices 3"] | wp.array) -> DepthBuffer:
        """Return depth and face of every pixel for vertices in the world [m]."""
        self.draw(_on_device(vertices, self.device))
        shape = (self.camera.height, self.camera.width)
        depth = wp.empty(len(self.pixels), dtype=wp.float32, device=self.device)
        faces = wp.empty(len(self.pixels), dtype=wp.int32, device=self.device)
        wp.launch(
            kernels.unpack_pixels,
            dim=len(self.pixels),
            inputs=[self.pixels],
            outputs=[depth, faces],
            device=self.device,
        )
        return DepthBuffer(depth.numpy().reshape(shape), faces.numpy().reshape(shape))

    def window(self, vertices: Float[np.ndarray, "vertices 3"]) -> tuple[slice, slice]:
        """Return rows and columns outside which no pixel shows the mesh at these vertices [m]."""
        pixels, depth = self.camera.project(vertices)
        # A mesh that reaches behind the camera may appear anywhere in the image.
        if not ((depth >= 2.0 * _NEAREST_DEPTH_M).all() and np.isfinite(pixels).all()):
            return slice(0, self.camera.height), slice(0, self.camera.width)
        # Add a pixel on each side, for rounding to single precision.
        size = (self.camera.width, self.camera.height)
        left, top = np.clip(np.floor(pixels.min(axis=0)) - 1, 0, size).astype(int).tolist()
        right, bottom = np.clip(np.ceil(pixels.max(axis=0)) + 2, 0, size).astype(int).tolist()
        return slice(top, bottom), slice(left, right)

    def faces_within(
        self, vertices: Float[np.ndarray, "vertices 3"], window: tuple[slice, slice]
    ) -> Int[np.ndarray, "height width"]:
        """Return the index of the nearest face at each pixel of a window, or -1."""
        self.draw(_on_device(vertices, self.device))
        # The lower half of a pixel is its face; it is -1 in an empty pixel.
        halves = self.pixels.numpy().view("<i4")
        return halves.reshape(self.camera.height, self.camera.width, 2)[*window, 0]

    def draw(self, vertices: wp.array) -> None:
        """Fill `pixels` for world vertices [m], a vec3 array on this device; no copy or wait."""
        self.pixels.fill_(kernels.EMPTY_PIXEL)
        wp.launch(
            kernels.draw_faces,
            dim=len(self.faces),
            inputs=[vertices, self.faces, self.kernel_camera],
            outputs=[self.pixels],
            device=self.device,
        )


class VisibilityCheck:
    """Reusable check of which vertices some camera sees, for one topology.

    A vertex is visible if a face around it covers a pixel of some camera, it projects into that
    image, and it lies no deeper than the surface there plus a tolerance. The tolerance must be
    smaller than the distance of two layers of cloth that lie on each other.

    Args:
        cameras: one or more cameras. A small image (`Camera.resized`) is fast and usually enough;
            its pixels should not be larger than the mesh's edges.
        tolerance_m: how much deeper than the surface a visible vertex may lie [m].
    """

    def __init__(
        self,
        faces: Int[np.ndarray, "faces 3"],
        cameras: Sequence[Camera],
        *,
        tolerance_m: float = 0.003,
        device: str = "cpu",
    ) -> None:
        if not cameras:
            raise InvalidConfigError("visibility needs at least one camera; none was given")
        if not tolerance_m >= 0:
            raise InvalidConfigError(f"tolerance_m is {tolerance_m}; it must be 0 or more")
        self.tolerance_m = tolerance_m
        self.device = device
        self.rasterizers = [Rasterizer(faces, camera, device=device) for camera in cameras]
        self._hit = wp.empty(0, dtype=wp.bool, device=device)
        self._visible = wp.empty(0, dtype=wp.bool, device=device)

    def __call__(
        self, vertices: Float[np.ndarray, "vertices 3"] | wp.array
    ) -> Bool[np.ndarray, " vertices"]:
        """Return which vertices are visible, for vertices in the world [m]."""
        return self.on_device(_on_device(vertices, self.device)).numpy().astype(bool)

    def on_device(self, vertices: wp.array) -> wp.array:
        """Return the same as a bool array on the device, which the next call overwrites."""
        count = len(vertices)
        if len(self._visible) != count:
            self._hit = wp.empty(count, dtype=wp.bool, device=self.device)
            self._visible = wp.empty(count, dtype=wp.bool, device=self.device)
        self._visible.zero_()
        for rasterizer in self.rasterizers:
            rasterizer.draw(vertices)
            self._hit.zero_()
            wp.launch(
                kernels.mark_hit_vertices,
                dim=-(-len(rasterizer.pixels) // kernels.STRIP_PIXELS),
                inputs=[rasterizer.pixels, rasterizer.faces],
                outputs=[self._hit],
                device=self.device,
            )
            wp.launch(
                kernels.mark_visible_vertices,
                dim=count,
                inputs=[
                    vertices,
                    self._hit,
                    rasterizer.kernel_camera,
                    rasterizer.pixels,
                    self.tolerance_m,
                ],
                outputs=[self._visible],
                device=self.device,
            )
        return self._visible


def visible_vertices(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    cameras: Sequence[Camera],
    *,
    tolerance_m: float = 0.003,
    device: str = "cpu",
) -> Bool[np.ndarray, " vertices"]:
    """Return the vertices that at least one camera sees (`VisibilityCheck`)."""
    return VisibilityCheck(faces, cameras, tolerance_m=tolerance_m, device=device)(vertices)


def _kernel_camera(camera: Camera) -> object:
    value = kernels.RasterCamera()
    value.width, value.height = camera.width, camera.height
    value.fx, value.fy, value.cx, value.cy = camera.fx, camera.fy, camera.cx, camera.cy
    value.camera_from_world = wp.mat33(*camera.world_from_camera[:3, :3].T.ravel().tolist())
    value.position = wp.vec3(*camera.position.tolist())
    value.near = _NEAREST_DEPTH_M
    return value


def _on_device(vertices: Float[np.ndarray, "vertices 3"] | wp.array, device: str) -> wp.array:
    if isinstance(vertices, wp.array):
        return vertices
    return wp.array(np.ascontiguousarray(vertices, np.float32), dtype=wp.vec3, device=device)
