"""Measures of a mesh against the observation, against the truth, and as a cloth.

A Chamfer distance alone must not rank methods because it hardly follows the true error. It is
always shown with its floor (the score of the truth itself), edge strain and crossings.
"""

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.geometry.chamfer import sample_surface, two_way
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import close_pairs, crossings, edge_strain
from clothtrack.recordings.recording import Table

CLOSE_PAIR_M = 0.005
"""Non-adjacent vertices nearer than this [m] count as a close pair (paper, Sec. IV)."""

_BELOW_TABLE_M = 0.003
"""Distance under its resting height [m] from which a vertex lies below the table."""

SURFACE_SAMPLES = 40_000
"""Area-uniform samples of each surface in `chamfer_surface`."""


@dataclass(frozen=True)
class ErrorSummary:
    """Summary of the distances of vertices to their true positions [mm].

    Attributes:
        mean: arithmetic mean [mm].
        median: median [mm].
        p95: 95th percentile [mm].
        max: maximum [mm].
    """

    mean: float
    median: float
    p95: float
    max: float
    count: int

    @classmethod
    def of(cls, errors_mm: Float[np.ndarray, " vertices"]) -> "ErrorSummary":
        """Summarize distances [mm]; NaN if there is no vertex."""
        if len(errors_mm) == 0:
            return cls(np.nan, np.nan, np.nan, np.nan, 0)
        return cls(
            float(errors_mm.mean()),
            float(np.median(errors_mm)),
            float(np.percentile(errors_mm, 95)),
            float(errors_mm.max()),
            len(errors_mm),
        )


@dataclass(frozen=True)
class ClothMeasures:
    """Measures of whether a mesh is a possible cloth, and its coverage; they need no truth.

    Attributes:
        edge_strain: mean absolute relative change of edge length against the flat rest state.
        crossings: edges that pass through a triangle they do not belong to.
        close_pairs: non-adjacent vertex pairs nearer than 5 mm.
        below_table: share of vertices more than 3 mm under their resting height; NaN without a
            table.
        coverage: area seen from above the table [m^2].
    """

    edge_strain: float
    crossings: int
    close_pairs: int
    below_table: float
    coverage: float

    def as_dict(self) -> dict[str, float]:
        """Return the measures by name."""
        return asdict(self)


def chamfer_pc(
    vertices: Float[np.ndarray, "vertices 3"],
    seen: Bool[np.ndarray, " vertices"],
    cloud: Float[np.ndarray, "points 3"],
) -> float:
    """Return the two-way Chamfer distance of visible vertices and observed cloud [m^2].

    Both directions are summed. Each is the mean squared distance to the nearest neighbor, which is
    the unit that the paper's "1e-4 m" must have. NaN if nothing is visible or observed.
    """
    if not seen.any() or len(cloud) == 0:
        return float("nan")
    return two_way(vertices[seen], cloud)


def root_mean_square_mm(chamfer_m2: float) -> float:
    """Convert a two-way Chamfer distance [m^2] to the root mean square of one direction [mm]."""
    return 1e3 * float(np.sqrt(0.5 * chamfer_m2))


def chamfer_surface(
    mesh: tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]],
    measured: tuple[Float[np.ndarray, "true_vertices 3"], Int[np.ndarray, "true_faces 3"]],
    *,
    samples: int = SURFACE_SAMPLES,
    seed: int = 0,
) -> float:
    """Return the two-way Chamfer distance [m^2] of whole surfaces, hidden layers included."""
    return two_way(
        sample_surface(*mesh, samples, seed), sample_surface(*measured, samples, seed + 1)
    )


def cloud_floor(cloud: Float[np.ndarray, "points 3"], seed: int = 0) -> float:
    """Return the Chamfer distance [m^2] of two random halves of a cloud, due to sampling alone."""
    if len(cloud) < 2:
        return float("nan")
    order = np.random.default_rng(seed).permutation(len(cloud))
    half = len(cloud) // 2
    return two_way(cloud[order[:half]], cloud[order[half:]])


def vertex_error_mm(
    vertices: Float[np.ndarray, "vertices 3"],
    true_points: Float[np.ndarray, "vertices 3"],
    truly_visible: Bool[np.ndarray, " vertices"],
) -> dict[str, ErrorSummary]:
    """Summarize the distances of tracked vertices to their true material points [mm].

    Args:
        vertices: tracked vertices in the world [m].
        true_points: true positions of the same material points [m].
    """
    errors = 1e3 * np.linalg.norm(vertices - true_points, axis=1)
    return {
        "all": ErrorSummary.of(errors),
        "visible": ErrorSummary.of(errors[truly_visible]),
        "hidden": ErrorSummary.of(errors[~truly_visible]),
    }


def cloth_measures(
    rest: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    table: Table | None,
    *,
    rest_height_m: float,
) -> ClothMeasures:
    """Compute strain, self-intersection, table and coverage measures of one mesh.

    Args:
        vertices: vertices to measure, in the world [m].
        rest_height_m: height of the mid-surface of a cloth that lies on the table [m].
    """
    normal = (0.0, 0.0, 1.0) if table is None else tuple(float(n) for n in table.normal)
    return ClothMeasures(
        edge_strain=float(edge_strain(rest, vertices)),
        crossings=int(crossings(vertices, rest.faces)),
        close_pairs=int(close_pairs(vertices, rest.faces, CLOSE_PAIR_M)),
        below_table=below_table(vertices, table, rest_height_m),
        coverage=float(projected_area(vertices, rest.faces, normal)),
    )


def below_table(
    vertices: Float[np.ndarray, "vertices 3"], table: Table | None, rest_height_m: float
) -> float:
    """Return the share of vertices over 3 mm under resting height; NaN without a table."""
    if table is None:
        return float("nan")
    return float((table.heights(vertices) < rest_height_m - _BELOW_TABLE_M).mean())
