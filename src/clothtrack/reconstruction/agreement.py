"""Agreement of a reconstruction with the picture that it was made from.

No measure here uses ground truth. Only visible cloth can contradict a mesh: hidden layers may be
wrong although the silhouette fits. `evaluation.verdict` judges the measures.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.chamfer import two_way
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.point_cloud import thin

if TYPE_CHECKING:
    from clothtrack.reconstruction.depth_input import DepthInput

_SPACING_M = 0.004


@dataclass(frozen=True)
class Agreement:
    """Agreement of a mesh with the picture that it was made from.

    Attributes:
        iou: intersection over union of the silhouettes in the picture.
        chamfer_m2: two-way Chamfer distance of the mesh's visible surface and the cloud [m^2]; None
            if either is empty.
    """

    iou: float
    chamfer_m2: float | None

    @property
    def surface_m(self) -> float:
        """Root mean square distance between visible surface and cloud, both directions [m].

        NaN if nothing of the mesh is visible.
        """
        return float("nan") if self.chamfer_m2 is None else (0.5 * self.chamfer_m2) ** 0.5


def agreement_of(mesh: ClothMesh, picture: "DepthInput") -> Agreement:
    """Return the agreement of a mesh with a picture, rendered into the picture's own camera."""
    camera = picture.camera
    vertices = np.asarray(mesh.vertices, np.float64)
    depth = Rasterizer(mesh.faces, camera).render(vertices).depth
    covered = np.isfinite(depth)
    union = int((covered | picture.mask).sum())
    iou = float((covered & picture.mask).sum() / union) if union else 0.0
    surface: Float[np.ndarray, "points 3"] = camera.back_project(
        np.where(covered, depth, 0.0), covered
    )
    cloud = camera.back_project(picture.depth_m, picture.mask & (picture.depth_m > 0))
    if not len(surface) or not len(cloud):
        return Agreement(iou, None)
    return Agreement(iou, two_way(thin(surface, _SPACING_M), thin(cloud, _SPACING_M)))
