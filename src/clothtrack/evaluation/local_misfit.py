"""Local misfit between a mesh and the observation, as a distance per vertex, without the truth.

A mean over the mesh hides a lost flap: 20 mm on 15 % of the cloth is 3 mm on average. Three
measures are therefore local: observed cloth outside the outline of the mesh, mesh outside the
outline of the cloth, and the distance between the visible surface and its points.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from clothtrack.alignment.silhouette import cloud_picture
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.point_cloud import Observation

_PIXELS_OF_NOISE = 1.5
"""Tolerated difference of outlines [pixels], since masks and z-buffers are rounded to pixels."""

_PATCH_M = 0.04
"""Radius of the patch of flat cloth over which a vertex collects misfits [m]. A shifted flap shows
a misfit only at its rim."""

_PATCH_QUANTILE = 80.0
"""Percentile of the misfits in a patch assigned to its center; with a higher one, a single vertex
could decide."""


@dataclass(frozen=True, eq=False)
class LocalMisfit:
    """Misfit between a mesh and the observation at each vertex.

    Attributes:
        uncovered_m: largest distance [m] from the mesh's outline to observed cloth outside it, for
            which the vertex is the nearest; 0 if there is none.
        unsupported_m: largest distance [m] from the cloth's outline to the mesh outside it, over
            triangles at the vertex; 0 if there is none.
        surface_m: mean distance [m] from the surface to the cloud points nearest to the vertex; NaN
            if there is none.
        patch_m: misfit of the patch around the vertex [m].
    """

    uncovered_m: Float[np.ndarray, " vertices"]
    unsupported_m: Float[np.ndarray, " vertices"]
    surface_m: Float[np.ndarray, " vertices"]
    patch_m: Float[np.ndarray, " vertices"]


def local_misfit(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    observation: Observation,
    cloud: Float[np.ndarray, "points 3"],
    away_m: Float[np.ndarray, " points"],
    *,
    device: str = "cpu",
) -> LocalMisfit:
    """Compute the misfit between a mesh and the observation at each vertex.

    Args:
        vertices: positions of its vertices [m].
        cloud: the same cloud thinned [m].
        away_m: distance of each of its points from the surface of the mesh [m].
    """
    uncovered, unsupported = np.zeros((2, len(vertices)))
    silent = observation.unobservable(vertices)[mesh.faces].any(axis=1)
    for camera in observation.cameras:
        faces = Rasterizer(mesh.faces, camera, device=device).render(vertices).faces
        hidden = observation.hidden.get(camera.name, np.zeros(faces.shape, bool))
        cloth = cloud_picture(observation.points, camera)
        pixel_m = float(np.median(camera.project(observation.points)[1])) / camera.fx
        # Unobservable pixels are not part of an outline.
        rows, columns, away = _outside(cloth & ~hidden, (faces >= 0) | hidden)
        if len(away) and (faces >= 0).any():
            seen = np.unique(mesh.faces[np.unique(faces[faces >= 0])])
            tree = cKDTree(camera.project(vertices[seen])[0])
            owner = seen[tree.query(np.stack([columns, rows], axis=1))[1]]
            np.maximum.at(uncovered, owner, pixel_m * away)
        drawn = (faces >= 0) & ~hidden & ~np.append(silent, False)[faces]
        rows, columns, away = _outside(drawn, cloth | hidden)
        for corner in mesh.faces[faces[rows, columns]].T:
            np.maximum.at(unsupported, corner, pixel_m * away)
    surface = _beside(vertices, cloud, away_m)
    worst = np.fmax(np.maximum(uncovered, unsupported), np.nan_to_num(surface))
    return LocalMisfit(uncovered, unsupported, surface, _by_patch(mesh, worst))


def _outside(
    shape: Bool[np.ndarray, "height width"], other: Bool[np.ndarray, "height width"]
) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"], Float[np.ndarray, " pixels"]]:
    """Return the pixels of a shape outside another: rows, columns and distances [pixels]."""
    away = cv2.distanceTransform((~other).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    rows, columns = np.nonzero(shape & (away > _PIXELS_OF_NOISE))
    return rows, columns, away[rows, columns].astype(np.float64)


def _beside(
    vertices: Float[np.ndarray, "vertices 3"],
    cloud: Float[np.ndarray, "points 3"],
    away_m: Float[np.ndarray, " points"],
) -> Float[np.ndarray, " vertices"]:
    """Return the mean over the points nearest to each vertex [m]; NaN if there is none."""
    if not len(cloud):
        return np.full(len(vertices), np.nan)
    owner = cKDTree(vertices).query(cloud)[1]
    count = np.bincount(owner, minlength=len(vertices))
    total = np.bincount(owner, away_m, minlength=len(vertices))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _by_patch(
    mesh: ClothMesh, misfit_m: Float[np.ndarray, " vertices"]
) -> Float[np.ndarray, " vertices"]:
    """Return a high percentile of the misfits in the patch around each vertex [m]."""
    flat = np.asarray(mesh.vertices, np.float64)
    near = cKDTree(flat).sparse_distance_matrix(cKDTree(flat), _PATCH_M, output_type="ndarray")
    order = np.lexsort((misfit_m[near["j"]], near["i"]))
    ends = np.cumsum(np.bincount(near["i"], minlength=len(flat)))
    starts = np.concatenate([[0], ends[:-1]])
    place = starts + ((ends - 1 - starts) * _PATCH_QUANTILE / 100.0).astype(np.int64)
    return misfit_m[near["j"][order]][place]
