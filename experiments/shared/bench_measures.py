"""The row of one mesh: every measure of the evaluation, also for the world's own mesh."""

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.evaluation.metrics import CLOSE_PAIR_M
from clothtrack.evaluation.naming import true_places
from clothtrack.evaluation.results import evaluate
from clothtrack.evaluation.truth import Truth, material_points
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import close_pairs, crossings, edge_strain
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.recordings.recording import Recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

Row = dict[str, object]
"""One mesh: the end of one action, before or after TTO2. Units stand in the names."""

ROW_FORMAT = 1
"""Raise it when a measure is added or changes its meaning: kept rows are then made anew."""

REGIONS = ("all", "visible", "hidden")
STAGES = {"before_final_alignment": "before", "after_final_alignment": "after"}


def measure(tracked: TrackedTrajectory, recording: Recording, truth: Truth) -> list[Row]:
    """Return two rows per action: before and after TTO2."""
    where = true_places(tracked, truth)
    assert where is not None  # both have canonical coordinates
    worlds = {}
    rows = []
    for row in evaluate(tracked, recording, truth).rows:
        action = tracked.actions[row.action]
        if row.action not in worlds:
            surface = truth.at(action.last_frame)
            points = material_points(surface, truth.faces, where)
            seen = visible_vertices(surface, truth.faces, recording.cameras)
            weights = np.einsum("ij,ij->i", where[1], seen[truth.faces[where[0]]].astype(float))
            world = _world(tracked.mesh, points, surface, truth)
            worlds[row.action] = points, weights > 0.5, world
        points, visible, world = worlds[row.action]
        vertices = np.asarray(getattr(action, f"positions_{row.stage}"), np.float64)
        edges = len(tracked.mesh.edges)
        cloth = {key: value for key, value in asdict(row.cloth).items() if key != "coverage"}
        rows.append(
            {
                "action": row.action + 1,
                "actions": len(tracked.actions),
                "stage": STAGES[row.stage],
                "frame": row.frame,
                **_errors(row.vertex_error_mm),
                **_parts_of_error(vertices, points),
                **_groups_of_error(vertices, points, visible, tracked.mesh),
                "chamfer_pc_m2": row.chamfer_pc,
                "chamfer_floor_m2": row.chamfer_floor,
                "chamfer_surface_m2": row.chamfer_surface,
                **cloth,
                "coverage_m2": row.cloth.coverage,
                "vertices": len(vertices),
                "edges": edges,
                "crossings_per_1000_edges": 1e3 * row.cloth.crossings / edges,
                "close_pairs_per_1000_vertices": 1e3 * row.cloth.close_pairs / len(vertices),
                **world,
                **_effort(tracked, row.action),
            }
        )
    return rows


def _errors(summaries: Mapping[str, object]) -> Row:
    errors: Row = {}
    for region in REGIONS:
        summary = summaries[region]
        errors[f"error_{region}_mm"] = summary.mean
        errors[f"error_{region}_p95_mm"] = summary.p95
        errors[f"share_{region}"] = summary.count / max(1, summaries["all"].count)
    return errors


def _parts_of_error(
    vertices: Float[np.ndarray, "vertices 3"], points: Float[np.ndarray, "vertices 3"]
) -> Row:
    """Return the direction of the error, and the rest after aligning the cloth as a whole."""
    gaps = vertices - points
    return {
        "error_along_table_mm": 1e3 * float(np.linalg.norm(gaps[:, :2], axis=1).mean()),
        "error_vertical_mm": 1e3 * float(np.abs(gaps[:, 2]).mean()),
        "error_without_slip_mm": 1e3 * without_slip(vertices, points),
    }


def _groups_of_error(
    vertices: Float[np.ndarray, "vertices 3"],
    points: Float[np.ndarray, "vertices 3"],
    visible: Bool[np.ndarray, " vertices"],
    mesh: ClothMesh,
) -> Row:
    """Return the contributions of swapped, visible and hidden vertices to the mean error."""
    errors = 1e3 * np.linalg.norm(vertices - points, axis=1)
    wrong = swapped_layers(vertices, points, mesh)
    groups = {"swapped": wrong, "visible": visible & ~wrong, "hidden": ~visible & ~wrong}
    parts = {f"part_{name}_mm": float(errors[own].sum()) for name, own in groups.items()}
    return {
        "share_swapped": float(wrong.mean()),
        **{name: total / len(errors) for name, total in parts.items()},
    }


def swapped_layers(
    vertices: Float[np.ndarray, "vertices 3"],
    points: Float[np.ndarray, "vertices 3"],
    mesh: ClothMesh,
    *,
    apart_m: float = 0.001,
) -> Bool[np.ndarray, " vertices"]:
    """Return vertices whose order with another layer is swapped.

    Two vertices count as layers of each other where they are nearer than three quarters of an edge
    seen from above, in truth and in the mesh, and four times as far apart in the flat cloth.

    Args:
        vertices: to judge [m].
        points: where they really are [m].
        apart_m: layers nearer than this in truth [m] have no order.
    """
    reach_m = 0.75 * float(np.median(mesh.edge_lengths))
    pairs = cKDTree(points[:, :2]).query_pairs(reach_m, output_type="ndarray")
    a, b = pairs.T
    rest = np.asarray(mesh.canonical if mesh.canonical is not None else mesh.vertices)
    near = np.linalg.norm(vertices[a, :2] - vertices[b, :2], axis=1) < reach_m
    layers = near & (np.linalg.norm(rest[a] - rest[b], axis=1) > 4.0 * reach_m)
    true_gap, gap = points[a, 2] - points[b, 2], vertices[a, 2] - vertices[b, 2]
    wrong = layers & (np.abs(true_gap) > apart_m) & (true_gap * gap < 0.0)
    swapped = np.zeros(len(vertices), bool)
    swapped[pairs[wrong].ravel()] = True
    return swapped


def in_order(
    vertices: Float[np.ndarray, "vertices 3"],
    points: Float[np.ndarray, "vertices 3"],
    mesh: ClothMesh,
) -> float | None:
    """Return the share of the vertices that are as high among their layers as they really are.

    Vertices count that have other layers above or below them, in truth and in the mesh, wherever
    these lie; half of them would be in order by chance where there are two layers. None where
    fewer than twenty count.

    Args:
        vertices: to judge [m].
        points: where they really are [m].
    """
    found, true = _place_among_layers(vertices, mesh), _place_among_layers(points, mesh)
    apart = np.abs(found - true)
    apart = apart[np.isfinite(apart)]
    return float((apart < 0.5).mean()) if len(apart) >= 20 else None


def _place_among_layers(
    positions: Float[np.ndarray, "vertices 3"], mesh: ClothMesh, *, apart_m: float = 0.0003
) -> Float[np.ndarray, " vertices"]:
    """Return the share of the other layers at each vertex that lie under it; NaN without any."""
    reach_m = 0.75 * float(np.median(mesh.edge_lengths))
    a, b = cKDTree(positions[:, :2]).query_pairs(reach_m, output_type="ndarray").T
    rest = np.asarray(mesh.canonical if mesh.canonical is not None else mesh.vertices)
    gap_m = positions[a, 2] - positions[b, 2]
    layers = np.linalg.norm(rest[a] - rest[b], axis=1) > 4.0 * reach_m
    layers &= np.abs(gap_m) > apart_m
    a, b, on_top = a[layers], b[layers], gap_m[layers] > 0.0
    count = len(positions)
    under = np.bincount(a, on_top, count) + np.bincount(b, ~on_top, count)
    others = np.bincount(a, minlength=count) + np.bincount(b, minlength=count)
    return np.divide(under, others, out=np.full(count, np.nan), where=others > 0)


def without_slip(
    vertices: Float[np.ndarray, "vertices 3"], points: Float[np.ndarray, "vertices 3"]
) -> float:
    """Mean distance [m] after the rigid motion that fits the vertices to the points best.

    The motion is the least squares one (Kabsch, DOI 10.1107/S0567739476001873).
    """
    centerd, wanted = vertices - vertices.mean(axis=0), points - points.mean(axis=0)
    left, _, right = np.linalg.svd(centerd.T @ wanted)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return float(np.linalg.norm(centerd @ (left @ flip @ right) - wanted, axis=1).mean())


def _world(
    mesh: ClothMesh,
    points: Float[np.ndarray, "vertices 3"],
    surface: Float[np.ndarray, "true_vertices 3"],
    truth: Truth,
) -> Row:
    """Return the same measures of the true cloth: on its own mesh, and drawn on the tracker's."""
    true_edges = len(ClothMesh(surface, truth.faces).edges)
    own = crossings(surface, truth.faces)
    return {
        "world_crossings": own,
        "world_crossings_per_1000_edges": 1e3 * own / true_edges,
        "world_close_pairs": close_pairs(surface, truth.faces, CLOSE_PAIR_M),
        "world_close_pairs_per_1000_vertices": 1e3
        * close_pairs(surface, truth.faces, CLOSE_PAIR_M)
        / len(surface),
        "world_vertices": len(surface),
        "truth_crossings": crossings(points, mesh.faces),
        "truth_close_pairs": close_pairs(points, mesh.faces, CLOSE_PAIR_M),
        "truth_edge_strain": edge_strain(mesh, points),
    }


def _effort(tracked: TrackedTrajectory, number: int) -> Row:
    action, steps = tracked.actions[number], tracked.steps
    frames = slice(action.first_frame + 1, action.last_frame + 1)
    return {
        "parameters": dict(action.parameters),
        "calibration_roll_outs": action.calibration.roll_outs,
        "line_search_trials": int(steps.trials[frames].sum()),
        "corrections_dropped": int(steps.gave_up[frames].sum()),
    }


def finite(value: object) -> object:
    """Return the same with nothing that JSON lacks: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
