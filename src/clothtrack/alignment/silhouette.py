"""Compare the outline of a mesh with that of the cloth in the picture.

Of all observable measures, this one follows the true error of a tracked mesh best. Cloth in the
wrong place on other cloth hardly changes Chamfer distances, but it changes the outline.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Table

_FIRST_STEP_M = 0.006
"""First shift tried when an outline is fitted [m]."""

TRIALS = 50
"""Maximum number of rendered outlines (Nelder-Mead search over two shifts and a rotation)."""

_CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
"""Kernel of the four neighbors of a pixel."""


def silhouette_gap(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    observation: Observation,
    *,
    device: str = "cpu",
) -> float:
    """Return 1 minus the IoU of the mesh's and the cloud's silhouettes, over all cameras.

    Args:
        vertices: positions of its vertices [m].
    """
    return _Outline(mesh, observation, device).gap(vertices)


class _Outline:
    """Silhouette of the cloud in every camera, computed once for all meshes compared with it."""

    def __init__(self, mesh: ClothMesh, observation: Observation, device: str) -> None:
        self._faces, self._observation = mesh.faces, observation
        self._views = []
        for camera in observation.cameras:
            seen = shown = cloud_picture(observation.points, camera)
            if (hidden := observation.hidden.get(camera.name)) is not None:
                shown = seen & ~hidden
            rasterizer = Rasterizer(mesh.faces, camera, device=device)
            self._views.append((rasterizer, seen, shown, hidden, int(np.count_nonzero(shown))))

    def gap(self, vertices: Float[np.ndarray, "vertices 3"]) -> float:
        """Return the `silhouette_gap` of the mesh with these vertices [m]."""
        both = either = 0
        # The cloud may have been cut away there, so missing points are no evidence.
        silent = self._observation.unobservable(vertices)[self._faces].any(axis=1)
        unobservable_face = np.append(silent, False)
        for rasterizer, seen, shown, hidden, count in self._views:
            # Outside the window the mesh covers nothing, so only the cloud's pixels count there.
            window = rasterizer.window(vertices)
            faces = rasterizer.faces_within(vertices, window)
            drawn = (faces >= 0) & (seen[window] | ~unobservable_face[faces])
            if hidden is not None:
                drawn &= ~hidden[window]
            common = int(np.count_nonzero(drawn & shown[window]))
            both += common
            either += count + int(np.count_nonzero(drawn)) - common
        return 1.0 - both / either if either else float("nan")


def slide_to_outline(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    observation: Observation,
    table: Table,
    *,
    device: str = "cpu",
) -> Float[np.ndarray, "vertices 3"]:
    """Slide and rotate a whole mesh on the table until its outline fits best.

    Nearest-point matches keep a mesh in place even if the cloth has slipped, because all vertices
    except a few at the rim have a partner where they are. The outline does not have this problem.

    Args:
        vertices: positions of its vertices [m].

    Returns:
        The moved vertices [m]; unchanged if no move fits better.
    """
    middle = vertices.mean(axis=0)
    # Scale the rotation so that it moves the rim about as far as a shift of the same number.
    lever_m = max(float(np.linalg.norm(vertices - middle, axis=1).mean()), 1e-6)
    across = np.linalg.svd(table.normal[None])[2][1:]

    def moved(step: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "vertices 3"]:
        turn = Rotation.from_rotvec(step[2] / lever_m * table.normal)
        return turn.apply(vertices - middle) + middle + step[:2] @ across

    outline = _Outline(mesh, observation, device)

    def gap(step: Float[np.ndarray, " 3"]) -> float:
        return outline.gap(moved(step))

    first = gap(np.zeros(3))
    if not np.isfinite(first):
        return vertices
    simplex = np.vstack([np.zeros(3), _FIRST_STEP_M * np.eye(3)])
    options = {"initial_simplex": simplex, "maxfev": TRIALS, "xatol": 3e-4, "fatol": 1e-4}
    best = minimize(gap, np.zeros(3), method="Nelder-Mead", options=options)
    return moved(best.x) if best.fun < first else vertices


def cloud_picture(
    points: Float[np.ndarray, "points 3"], camera: Camera
) -> Bool[np.ndarray, "height width"]:
    """Return the pixels that a cloud covers: its points and the gaps between them."""
    pixels, depth = camera.project(points)
    pixels = np.rint(pixels[depth > 0]).astype(np.int64)
    size = (camera.width, camera.height)
    columns, rows = pixels[((pixels >= 0) & (pixels < size)).all(axis=1)].T
    shown = np.zeros(size[::-1], np.uint8)
    shown[rows, columns] = 1
    if np.count_nonzero(shown) < 2:
        return np.zeros(shown.shape, dtype=bool)
    side = 2 * int(np.ceil(_spacing_px(shown))) + 1
    return cv2.morphologyEx(shown, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)).view(bool)


def _spacing_px(shown: UInt8[np.ndarray, "height width"]) -> float:
    """Return the median distance of a shown pixel to the nearest other one, from about 1000."""
    pixels = np.argwhere(shown.T)[:, ::-1]
    some = pixels[:: 1 + len(pixels) // 1000]
    beside = cv2.filter2D(shown, -1, _CROSS, borderType=cv2.BORDER_CONSTANT)
    # An adjacent pixel is always the nearest: if most have one, no search is needed.
    if 2 * np.count_nonzero(beside[*some.T]) > len(some):
        return 1.0
    return float(np.median(cKDTree(pixels).query(some, k=2)[0][:, 1]))
