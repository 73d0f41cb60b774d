"""How well the outline of a mesh covers the cloth in the picture.

Of all that can be observed, this follows the true error of a tracked mesh best: Chamfer distances
hardly see cloth that lies in the wrong place on other cloth, an outline does.
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
"""First shift that is tried when an outline is to be fitted [m]."""

TRIALS = 50
"""Outlines that are drawn at most (Nelder and Mead's search over two shifts and a turn)."""

_CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
"""The four pixels beside one."""


def silhouette_gap(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    observation: Observation,
    *,
    device: str = "cpu",
) -> float:
    """1 minus intersection over union of the mesh's and the cloud's picture, over all cameras.

    Args:
        mesh: the topology.
        vertices: where its vertices are [m].
        observation: the cloud, as dense as it is, and where the cameras were blind.
        device: "cpu" or "cuda:0".

    Returns:
        0 for equal outlines, 1 for disjoint ones; NaN where nothing is in view.
    """
    return _Outline(mesh, observation, device).gap(vertices)


class _Outline:
    """The cloud's picture in every camera, drawn once for all meshes that are held against it."""

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
        # The cloud may have been cut away there, so that its absence says nothing.
        silent = self._observation.unobservable(vertices)[self._faces].any(axis=1)
        unobservable_face = np.append(silent, False)
        for rasterizer, seen, shown, hidden, count in self._views:
            # Where nothing is drawn, all that is shown is shown alone: there is no need to look.
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
    """Slide and turn a whole mesh on the table until its outline fits best.

    Nearest points hold a mesh where it is: all but the few at the rim have a partner right where
    they are, wherever the cloth has slipped to. The outline does not.

    Args:
        mesh: the topology.
        vertices: where its vertices are [m].
        observation: the cloud, and where the cameras were blind.
        table: the plane on which it slides.
        device: "cpu" or "cuda:0".

    Returns:
        The moved vertices [m]; the same ones where no move fits better.
    """
    middle = vertices.mean(axis=0)
    # A turn moves the rim about as far as a shift of the same number does.
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
    """Return the pixels that a cloud covers: those of its points, and the gaps between them."""
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
    """Return the median distance of a shown pixel from the nearest other one, of some thousand."""
    pixels = np.argwhere(shown.T)[:, ::-1]
    some = pixels[:: 1 + len(pixels) // 1000]
    beside = cv2.filter2D(shown, -1, _CROSS, borderType=cv2.BORDER_CONSTANT)
    # No other pixel is nearer than the one beside: what most have needs no search.
    if 2 * np.count_nonzero(beside[*some.T]) > len(some):
        return 1.0
    return float(np.median(cKDTree(pixels).query(some, k=2)[0][:, 1]))
