"""What an action is good for: how much of the table the cloth covers, seen from above.

Cloth that the camera does not see counts for nothing: what has left the picture can be neither
perceived nor picked any more.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.actions import in_picture

CoverageMeasure = Literal["exact", "raster"]

RASTER_CELLS = 100
RASTER_RADIUS_M = 0.005


def coverage(
    positions: Float[np.ndarray, "candidates vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    measure: CoverageMeasure = "exact",
    camera: Camera | None = None,
) -> Float[np.ndarray, " candidates"]:
    """Area [m^2] that each predicted cloth covers in the picture; minus infinity where it burst.

    Args:
        positions: vertices of each candidate [m], z up.
        faces: their triangles.
        measure: "exact", the area of the union of all triangles; or "raster", the literature's
            count of cells around vertices, to compare with.
        camera: triangles that are not wholly in its picture do not count; None: all do.
    """
    areas = np.full(len(positions), -np.inf)
    for index, vertices in enumerate(np.asarray(positions, dtype=np.float64)):
        if not np.isfinite(vertices).all():
            continue
        shown = in_picture(vertices, camera, 0.0)
        if not shown.any():
            areas[index] = 0.0
        elif measure == "exact":
            areas[index] = projected_area(vertices, faces[shown[faces].all(axis=1)])
        else:
            areas[index] = raster_coverage(vertices[shown])
    return areas


def raster_coverage(
    vertices: Float[np.ndarray, "vertices 3"],
    *,
    cells: int = RASTER_CELLS,
    radius_m: float = RASTER_RADIUS_M,
) -> float:
    """Coverage as SoftGym counts it [m^2]: cells of the bounding box near a vertex.

    Every vertex stands for a square of twice the particle radius. It depends on how the cloth is
    turned, and reads too little on a coarse mesh: it is here to compare with, no more.

    Args:
        vertices: positions [m].
        cells: cells along each side of the bounding box.
        radius_m: half the side of a vertex's square [m].
    """
    flat = np.asarray(vertices[:, :2], dtype=np.float64)
    low, high = flat.min(axis=0), flat.max(axis=0)
    side = np.maximum((high - low) / cells, 1e-9)
    first = np.clip(np.floor((flat - radius_m - low) / side), 0, cells - 1).astype(int)
    last = np.clip(np.floor((flat + radius_m - low) / side), 0, cells - 1).astype(int)
    # Corners of all squares, summed twice along each axis, give how often a cell is covered.
    marks = np.zeros((cells + 1, cells + 1), dtype=np.int64)
    np.add.at(marks, (first[:, 0], first[:, 1]), 1)
    np.add.at(marks, (last[:, 0] + 1, last[:, 1] + 1), 1)
    np.add.at(marks, (last[:, 0] + 1, first[:, 1]), -1)
    np.add.at(marks, (first[:, 0], last[:, 1] + 1), -1)
    covered = marks.cumsum(axis=0).cumsum(axis=1)[:cells, :cells] > 0
    return float(covered.sum() * side.prod())
