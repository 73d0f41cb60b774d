"""Scores of a mesh against one real picture: its silhouette, and the stickers on its corners."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from real.topdown import STICKER_INSET

Points = Float[np.ndarray, "points 2"]


def drawn_depth(mesh: ClothMesh, camera: Camera) -> Float[np.ndarray, "height width"]:
    """Return the depth of the mesh in a camera [m]; 0 where it is not."""
    depth = Rasterizer(mesh.faces, camera).render(mesh.vertices.astype(np.float64)).depth
    return np.where(np.isfinite(depth), depth, 0.0).astype(np.float64)


def silhouette_iou(
    drawn: Bool[np.ndarray, "height width"], shown: Bool[np.ndarray, "height width"]
) -> float:
    """Return shared pixels over all pixels of both silhouettes."""
    return float((drawn & shown).sum() / max((drawn | shown).sum(), 1))


def assigned(
    stickers: Points, corners: Points
) -> tuple[Float[np.ndarray, " stickers"], Int[np.ndarray, " stickers"]]:
    """Return each sticker's corner and its distance, assigned one to one with the least sum."""
    apart = cdist(stickers, corners)
    rows, columns = linear_sum_assignment(apart)
    return apart[rows, columns], columns


def at_stickers(
    mesh: ClothMesh, values: Float[np.ndarray, "vertices n"]
) -> Float[np.ndarray, "4 n"]:
    """Return values of the vertices of a towel where the stickers on its corners are."""
    flat = np.asarray(mesh.canonical, np.float64)
    low, high = flat.min(axis=0), flat.max(axis=0)
    inset = STICKER_INSET / np.sqrt(2.0) * (high - low).max()
    x, y = (np.array([low[axis] + inset, high[axis] - inset]) for axis in (0, 1))
    wanted = np.array([(a, b, 0.5 * (low[2] + high[2])) for a in x for b in y])
    face, weights = closest_on_mesh(wanted, flat, mesh.faces)
    return np.einsum("ij,ijk->ik", weights, values[mesh.faces[face]])


def moved_in(rectangle: Float[np.ndarray, "4 2"], inset: float) -> Float[np.ndarray, "4 2"]:
    """Return the corners of a rectangle, each moved inwards by `inset` along its angle bisector.

    They move at most to the middle of a side.
    """
    moved = rectangle.copy()
    for way in (1, -1):
        side = np.roll(rectangle, way, axis=0) - rectangle
        length = np.linalg.norm(side, axis=1, keepdims=True)
        step = np.minimum(inset / np.sqrt(2.0), 0.5 * length)
        moved += side / np.maximum(length, 1e-9) * step
    return moved
