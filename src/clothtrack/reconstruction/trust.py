"""Whether to trust a reconstruction: does it cover what was seen, and is the network sure of it.

No measure here knows the truth. What is seen can contradict a mesh, and nothing else can: hidden
layers may be wrong under a silhouette that fits.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.chamfer import two_way
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasteriser
from clothtrack.recordings.point_cloud import thin

if TYPE_CHECKING:
    from clothtrack.reconstruction.depth_input import DepthInput

LEAST_IOU = 0.8
"""Overlap of silhouettes (intersection over union) below which a mesh is not trusted."""

LARGEST_CHAMFER_M2 = 6e-4
"""Two-way Chamfer distance of the visible surface [m^2] above which a mesh is not trusted."""

_LARGEST_EXPECTED = 0.1
"""Expected error over the longer side of the garment above which a mesh is not trusted."""

_SPACING_M = 0.004


@dataclass(frozen=True)
class Agreement:
    """How a mesh agrees with the picture that it was made from.

    Attributes:
        iou: intersection over union of the silhouettes in the picture.
        chamfer_m2: two-way Chamfer distance of the mesh's visible surface and the cloud [m^2]; None
            where one of them is empty.
    """

    iou: float
    chamfer_m2: float | None

    def contradiction(self) -> str:
        """Why the mesh cannot be right; empty where nothing contradicts it."""
        if self.iou < LEAST_IOU:
            return (
                f"it covers what was seen to {self.iou:.2f} only (intersection over union; "
                f"at least {LEAST_IOU:.2f})"
            )
        if self.chamfer_m2 is None or self.chamfer_m2 > LARGEST_CHAMFER_M2:
            if self.chamfer_m2 is None:
                return "no part of it is visible"
            apart_mm, limit_mm = (
                1e3 * (0.5 * value) ** 0.5 for value in (self.chamfer_m2, LARGEST_CHAMFER_M2)
            )
            return (
                f"its visible surface is {apart_mm:.0f} mm from the cloud (root mean square; at "
                f"most {limit_mm:.0f} mm)"
            )
        return ""


def agreement_of(mesh: ClothMesh, picture: "DepthInput") -> Agreement:
    """How a mesh agrees with a picture, by rendering it into the picture's own camera."""
    camera = picture.camera
    vertices = np.asarray(mesh.vertices, np.float64)
    depth = Rasteriser(mesh.faces, camera).render(vertices).depth
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


def distrust(agreement: Agreement, expected_error_m: float | None, mesh: ClothMesh) -> str:
    """Why a reconstruction is not to be trusted; empty where it is.

    Args:
        agreement: with its picture.
        expected_error_m: what the network expects [m]; None from one that does not say.
        mesh: the reconstruction, whose canonical coordinates tell its size.
    """
    reason = agreement.contradiction()
    if reason or expected_error_m is None:
        return reason
    flat = mesh.vertices if mesh.canonical is None else mesh.canonical
    size_m = float(np.ptp(np.asarray(flat)[:, :2], axis=0).max())
    if expected_error_m > _LARGEST_EXPECTED * size_m:
        return (
            f"the network expects its vertices to be {1e3 * expected_error_m:.0f} mm off (at most "
            f"{1e3 * _LARGEST_EXPECTED * size_m:.0f} mm for a garment of {size_m:.2f} m)"
        )
    return ""
