"""The row of one reconstruction against cloud, pseudo-label and truth, also up to symmetry."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.evaluation.metrics import (
    chamfer_pc,
    chamfer_surface,
    cloth_measures,
    vertex_error_mm,
)
from clothtrack.evaluation.truth import Truth, material_map, material_points
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer, visible_vertices
from clothtrack.reconstruction.first_mesh import symmetries
from clothtrack.reconstruction.from_picture import NetworkMesh
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.simulation.parameters import SolverConfig
from clothtrack_lab.published_networks.canonical_frame import conventional
from shared.bench_measures import Row

LEARNING_ROW_FORMAT = 2
"""Raise it when a measure is added or changes its meaning: kept rows are then made anew."""

ON_CLOTH_M = 0.02
"""A measured point further than this [m] from the true cloth shows something else."""


@dataclass(frozen=True, eq=False)
class Case:
    """One frame to reconstruct, with the data to score it.

    Attributes:
        truth: the true meshes, with canonical coordinates.
        label: the tracker's mesh at that frame, where there is one.
    """

    recording: Recording
    truth: Truth
    frame: int
    kind: str
    label: ClothMesh | None = None


def measure_reconstruction(found: NetworkMesh, case: Case) -> Row:
    """Return every measure of one reconstruction; without a mesh its measures are missing."""
    row: Row = {
        "frame": case.frame,
        "status": found.reconstruction.status,
        "has_mesh": float(found.mesh is not None),
        **canonical_errors(found.reconstruction.seen, case),
    }
    if found.mesh is None:
        return {**row, "vertices": 0}
    mesh, vertices = found.mesh, found.mesh.vertices.astype(np.float64)
    truth, cameras = case.truth, case.recording.cameras
    surface = truth.at(case.frame)
    cloud = observe(case.recording, case.recording.frames[case.frame]).points
    rest = found.reconstruction.rest or mesh.with_vertices(np.asarray(mesh.canonical))
    cloth = cloth_measures(
        rest, vertices, case.recording.table, rest_height_m=SolverConfig().resting_height_m
    )
    drawn, best = vertex_errors(mesh, case)
    seen = visible_vertices(vertices, mesh.faces, cameras)
    true_points = _true_points(mesh, case, np.ones(3))
    truly_seen = visible_vertices(true_points, mesh.faces, cameras)
    label = case.label
    return {
        **row,
        "vertices": len(vertices),
        "chamfer_pc_m2": chamfer_pc(vertices, seen, cloud),
        "chamfer_floor_m2": chamfer_pc(true_points, truly_seen, cloud),
        "chamfer_surface_m2": chamfer_surface((vertices, mesh.faces), (surface, truth.faces)),
        "chamfer_label_m2": None
        if label is None
        else chamfer_surface(
            (vertices, mesh.faces), (label.vertices.astype(np.float64), label.faces)
        ),
        "error_all_mm": drawn["all"].mean,
        "error_visible_mm": drawn["visible"].mean,
        "error_hidden_mm": drawn["hidden"].mean,
        "error_all_p95_mm": drawn["all"].p95,
        "error_symmetric_mm": best["all"].mean,
        "error_symmetric_visible_mm": best["visible"].mean,
        "error_symmetric_hidden_mm": best["hidden"].mean,
        "edge_strain": cloth.edge_strain,
        "crossings": cloth.crossings,
        "crossings_per_1000_edges": 1e3 * cloth.crossings / len(mesh.edges),
        "close_pairs": cloth.close_pairs,
        "below_table": cloth.below_table,
        "refinement": None if found.refinement is None else list(found.refinement.chamfer_m2),
    }


def vertex_errors(mesh: ClothMesh, case: Case) -> tuple[dict, dict]:
    """Return vertex errors under the mesh's own correspondences, and under its best symmetry.

    The best symmetry is the one with the least mean error for the whole mesh. In both cases a towel
    has its longer side along x, regardless of its own coordinates.

    Returns:
        For each: summaries for "all", "visible" and "hidden" [mm].
    """
    found = []
    for signs in symmetries(case.kind):
        points = _true_points(mesh, case, signs)
        visible = _truly_visible(mesh, case, signs)
        found.append(vertex_error_mm(mesh.vertices.astype(np.float64), points, visible))
    return found[0], min(found, key=lambda one: one["all"].mean)


def canonical_errors(seen: SeenPoints, case: Case) -> Row:
    """Return canonical coordinates of measured points against the true ones [mm].

    A point's true coordinates are those of the nearest place on the part of the true cloth that the
    camera sees.
    """
    surface, truth = case.truth.at(case.frame), case.truth
    shown = [Rasterizer(truth.faces, camera).render(surface).faces for camera in _cameras(case)]
    faces = np.unique(np.concatenate([each[each >= 0] for each in shown]))
    face, weights = closest_on_mesh(seen.points, surface, truth.faces[faces])
    corners = truth.faces[faces][face]
    nearest = np.einsum("pc,pcx->px", weights, surface[corners])
    near = np.linalg.norm(nearest - seen.points, axis=1) < ON_CLOTH_M
    canonical = conventional(np.asarray(truth.canonical, np.float64), case.kind)
    true = np.einsum("pc,pcx->px", weights, canonical[corners])
    if not near.any():
        return {"canonical_mean_mm": None, "canonical_median_mm": None, "canonical_drawn_mm": None}
    errors = [
        1e3 * np.linalg.norm(seen.canonical[near] - true[near] * signs, axis=1)
        for signs in symmetries(case.kind)
    ]
    best = min(errors, key=np.mean)
    return {
        "canonical_mean_mm": float(best.mean()),
        "canonical_median_mm": float(np.median(best)),
        "canonical_drawn_mm": float(errors[0].mean()),
    }


def _cameras(case: Case) -> list:
    recording = case.recording
    return [one for one in recording.cameras if one.name in recording.frames[case.frame].depth]


def where_in(
    truth: Truth | ClothMesh, mesh: ClothMesh, kind: str, signs: Float[np.ndarray, " 3"]
) -> tuple:
    """Return the positions of the vertices on the true cloth under one symmetry."""
    canonical = conventional(np.asarray(truth.canonical, np.float64), kind)
    own = conventional(np.asarray(mesh.canonical, np.float64), kind)
    return material_map(canonical, truth.faces, own * signs)


def _true_points(
    mesh: ClothMesh, case: Case, signs: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "vertices 3"]:
    return material_points(
        case.truth.at(case.frame), case.truth.faces, where_in(case.truth, mesh, case.kind, signs)
    )


def _truly_visible(
    mesh: ClothMesh, case: Case, signs: Float[np.ndarray, " 3"]
) -> Bool[np.ndarray, " vertices"]:
    face, weights = where_in(case.truth, mesh, case.kind, signs)
    seen = visible_vertices(case.truth.at(case.frame), case.truth.faces, case.recording.cameras)
    shares = np.einsum("ij,ij->i", weights, seen[case.truth.faces[face]].astype(float))
    return shares > 0.5
