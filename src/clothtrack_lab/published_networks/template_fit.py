"""Fitting of the category's mesh to an observation, which always gives a mesh for the solver.

Visible points attract the mesh points that they show. Hidden parts follow from smoothness, from the
warp field and from the layer they are sewn to, in one sparse least-squares problem. Then the cloth
solver corrects the result, so that edges have their lengths, layers do not cross and nothing is
under the table.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, garment
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.alignment_frame import align
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.reconstruction.smoothness import smoothness_matrix
from clothtrack.recordings.recording import Table
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment
from clothtrack_lab.published_networks.canonical_frame import CanonicalFrame

CLOTH = ClothParameters(
    stretch_compliance=3e-3, bend_compliance=0.3, table_friction=0.0, particle_friction=0.0
)
"""Material of the garment during the fit. It slides freely, because a correction is not a motion,
and it is slightly compliant. It bends stiffly, so that vertices that a network places too close
together slide apart instead of forming wrinkles that were not observed."""

_SMOOTHNESS = 0.5
"""Weight of bending away from a flat sheet, relative to 1 for a well-observed vertex."""

_LAYER_WEIGHT = 0.02
"""Weight that keeps a vertex near the other layer of its garment."""

_POSE_WEIGHT = 1e-5
"""Weight of the rigidly aligned flat garment; it matters only where nothing else does."""

_OFF_TEMPLATE_M = 0.02
"""Distance of a canonical coordinate from the template at which its weight is 1 / e [m]."""

_PULL_S = 0.02
"""Time step of the solver that corrects the fit [s]."""

NO_CANONICAL = "the template has no canonical coordinates; make it with clothtrack's garments"


@dataclass(frozen=True)
class TemplateFitConfig:
    """The configuration of a template fit; weights are relative to 1 for a well-observed vertex.

    Attributes:
        vertex_count: approximate number of vertices of the template.
        warp_weight: weight of the warp field.
        outlier_m: distance of a point from the fit at which its weight is a quarter [m], because
            its canonical coordinate is wrong (S. Geman, D. McClure, 1987).
        rounds: number of fits, each with the weights from the one before.
        pulls: number of solver steps that correct the fit; 0 leaves it unchanged.
        pull: strength of the pull on visible vertices in each (`simulation.state.Attachment`).
        thickness_m: distance between layers [m].
    """

    vertex_count: int = 1000
    warp_weight: float = 0.02
    outlier_m: float = 0.02
    rounds: int = 3
    pulls: int = 12
    pull: float = 0.9
    thickness_m: float = 0.003


def template_of(
    frame: CanonicalFrame,
    seen: SeenPoints,
    *,
    size_m: tuple[float, float] | None = None,
    vertex_count: int = 1000,
) -> ClothMesh:
    """Return the flat garment of a category in the size given by canonical coordinates.

    Args:
        size_m: width and length if known [m].
    """
    if size_m is None:
        usual = np.array(DEFAULT_SIZES_M[frame.kind])
        sure = seen.confidence >= np.median(seen.confidence)
        reach = 2.0 * np.percentile(np.abs(seen.canonical[sure, :2]), 99.0, axis=0)
        # Limit the size from below, because parts of the garment may be hidden.
        width, length = np.clip(reach, 0.75 * usual, 2.0 * np.array(frame.half_m[:2]))
        size_m = float(width), float(length)
    return garment(frame.kind, vertex_count=vertex_count, size_m=size_m)


def fit_template(
    template: ClothMesh,
    seen: SeenPoints,
    config: TemplateFitConfig,
    *,
    warp: Float[np.ndarray, "vertices 3"] | None = None,
    table: Table | None = None,
) -> ClothMesh:
    """Return the template fitted to the observed garment.

    Args:
        warp: vertex positions by the warp field [m], world; None leaves it out.
    """
    vertices, sightings = _least_squares(template, seen, config, warp)
    if config.pulls:
        table = table or _table_under(seen.points, config)
        start = _below_what_is_seen(vertices, sightings, seen.points, table, config)
        vertices = _pulled_straight(template, start, sightings, table, config)
    return template.with_vertices(vertices)


def _least_squares(
    template: ClothMesh,
    seen: SeenPoints,
    config: TemplateFitConfig,
    warp: Float[np.ndarray, "vertices 3"] | None,
) -> tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, " vertices"]]:
    """Return vertices [m], and how well each was observed (1 is well)."""
    flat = _canonical(template)
    face, blend = closest_on_mesh(seen.canonical, flat, template.faces)
    shows = _barycentric(template, face, blend)
    away = np.linalg.norm(shows @ flat - seen.canonical, axis=1)
    weight = seen.confidence * np.exp(-((away / _OFF_TEMPLATE_M) ** 2)) + 1e-6
    frame = align(seen.points, seen.canonical, weight)
    prior, target = _prior(template, config, frame.to_world(flat), warp)
    trusted, vertices = weight, template.vertices
    for _ in range(config.rounds):
        sightings = shows.T @ trusted
        # Scale weights so that the mean visible vertex has weight 1 for any number of pixels.
        trusted = trusted / np.mean(sightings[sightings > 0.01 * sightings.max()])
        data = shows.T @ sparse.diags_array(trusted)
        vertices = splu((data @ shows + prior).tocsc()).solve(data @ seen.points + target)
        miss = np.linalg.norm(shows @ vertices - seen.points, axis=1)
        trusted = weight / (1.0 + (miss / config.outlier_m) ** 2) ** 2
    sightings = shows.T @ trusted
    return vertices, sightings / np.mean(sightings[sightings > 0.01 * sightings.max()])


def _canonical(template: ClothMesh) -> Float[np.ndarray, "vertices 3"]:
    if template.canonical is None:
        raise InvalidConfigError(NO_CANONICAL)
    return template.canonical


def _prior(
    template: ClothMesh,
    config: TemplateFitConfig,
    pose: Float[np.ndarray, "vertices 3"],
    warp: Float[np.ndarray, "vertices 3"] | None,
) -> tuple[sparse.csc_array, Float[np.ndarray, "vertices 3"]]:
    """Return normal matrix and right side of all terms without observed points."""
    bends = smoothness_matrix(template)
    count = template.vertex_count
    matrix = _SMOOTHNESS * (bends.T @ bends)
    matrix = matrix + _POSE_WEIGHT * sparse.eye_array(count)
    target = _POSE_WEIGHT * pose
    if warp is not None:
        matrix = matrix + config.warp_weight * sparse.eye_array(count)
        target = target + config.warp_weight * warp
    inflated = template.canonical
    if inflated is not None and np.ptp(inflated[:, 2]) > 0:
        face, blend = closest_on_mesh(inflated * (1.0, 1.0, -1.0), inflated, template.faces)
        apart = sparse.eye_array(count) - _barycentric(template, face, blend)
        matrix = matrix + _LAYER_WEIGHT * (apart.T @ apart)
    return matrix.tocsc(), target


def _pulled_straight(
    template: ClothMesh,
    start: Float[np.ndarray, "vertices 3"],
    sightings: Float[np.ndarray, " vertices"],
    table: Table,
    config: TemplateFitConfig,
) -> Float[np.ndarray, "vertices 3"]:
    """Return the fit corrected by the solver, with visible vertices pulled to observations."""
    solver_config = SolverConfig(thickness_m=config.thickness_m, table=table)
    flat = template.vertices + table.point + (0.0, 0.0, 0.05)
    solver = ClothSolver(replace(template, vertices=flat), solver_config, parameters=CLOTH)
    # Step once at rest so that the solver stores on which sides of each other the layers are.
    solver.step(1e-3)
    solver.place(start)
    pull = np.minimum(sightings, 1.0) * config.pull
    attachment = Attachment(start[None], pull[None])
    for _ in range(config.pulls):
        solver.set_velocities(np.zeros_like(start))
        solver.step(_PULL_S, attachment)
    return solver.positions[0].astype(np.float64)


def _below_what_is_seen(
    vertices: Float[np.ndarray, "vertices 3"],
    sightings: Float[np.ndarray, " vertices"],
    points: Float[np.ndarray, "points 3"],
    table: Table,
    config: TemplateFitConfig,
) -> Float[np.ndarray, "vertices 3"]:
    """Return the fit with hidden vertices moved below the visible surface and above the table."""
    hidden = sightings < _SEEN
    floor = table.point[2] + 0.5 * config.thickness_m
    near, nearest = cKDTree(points[:, :2]).query(vertices[:, :2])
    covered = hidden & (near < 2.0 * config.thickness_m)
    moved = vertices.copy()
    ceiling = points[nearest, 2] - config.thickness_m
    moved[covered, 2] = np.minimum(moved[covered, 2], ceiling[covered])
    moved[:, 2] = np.maximum(moved[:, 2], floor)
    return moved


_SEEN = 0.2
"""Least sightings of a visible vertex; with fewer it is hidden."""


def _table_under(points: Float[np.ndarray, "points 3"], config: TemplateFitConfig) -> Table:
    lowest = float(np.percentile(points[:, 2], 1.0)) - 0.5 * config.thickness_m
    return Table(np.array([0.0, 0.0, lowest]), np.array([0.0, 0.0, 1.0]))


def _barycentric(
    template: ClothMesh, face: Int[np.ndarray, " places"], blend: Float[np.ndarray, "places 3"]
) -> sparse.csr_array:
    """Return matrix rows that interpolate vertices at points on faces."""
    rows = np.repeat(np.arange(len(face)), 3)
    places = (rows, template.faces[face].ravel())
    return sparse.coo_array((blend.ravel(), places), (len(face), template.vertex_count)).tocsr()
