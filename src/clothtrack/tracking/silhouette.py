"""How well the outline of a mesh covers the cloth in the picture.

Of all that can be observed, this follows the true error of a tracked mesh best: Chamfer distances
hardly see cloth that lies in the wrong place on other cloth, an outline does.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasteriser
from clothtrack.recordings.point_cloud import Observation


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
    both = either = 0
    # The cloud may have been cut away there, so that its absence says nothing.
    silent_face = np.append(observation.silent(vertices)[mesh.faces].any(axis=1), False)
    for camera in observation.cameras:
        faces = Rasteriser(mesh.faces, camera, device=device).render(vertices).faces
        seen = _picture(observation.points, camera)
        drawn = (faces >= 0) & (seen | ~silent_face[faces])
        hidden = observation.hidden.get(camera.name)
        if hidden is not None:
            drawn, seen = drawn & ~hidden, seen & ~hidden
        both += int((drawn & seen).sum())
        either += int((drawn | seen).sum())
    return 1.0 - both / either if either else float("nan")


def _picture(
    points: Float[np.ndarray, "points 3"], camera: Camera
) -> Bool[np.ndarray, "height width"]:
    """Pixels that a cloud covers: those of its points, and the gaps between them."""
    pixels, depth = camera.project(points)
    pixels = np.rint(pixels[depth > 0]).astype(np.int64)
    size = (camera.width, camera.height)
    pixels = np.unique(pixels[((pixels >= 0) & (pixels < size)).all(axis=1)], axis=0)
    shown = np.zeros(size[::-1], np.uint8)
    if len(pixels) > 1:
        shown[pixels[:, 1], pixels[:, 0]] = 1
        spacing = np.median(cKDTree(pixels).query(pixels[:: 1 + len(pixels) // 1000], k=2)[0][:, 1])
        side = 2 * int(np.ceil(spacing)) + 1
        shown = cv2.morphologyEx(shown, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    return shown.view(bool)
