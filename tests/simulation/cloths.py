"""Small cloths for the tests of the simulation."""

import numpy as np

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table

FLOOR = Table(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))


def sheet(columns: int, rows: int, spacing: float, height: float = 0.0) -> ClothMesh:
    """A flat rectangle of squares cut along alternating diagonals, its corner at the origin."""
    x, y = np.meshgrid(np.arange(columns) * spacing, np.arange(rows) * spacing, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1)
    faces = []
    for i in range(columns - 1):
        for j in range(rows - 1):
            a, b, c, d = i * rows + j, (i + 1) * rows + j, (i + 1) * rows + j + 1, i * rows + j + 1
            faces += [[a, b, c], [a, c, d]] if (i + j) % 2 == 0 else [[a, b, d], [b, c, d]]
    return ClothMesh(vertices, np.array(faces))


def stack(lower: ClothMesh, upper: ClothMesh) -> ClothMesh:
    """Two cloths as one mesh."""
    return ClothMesh(
        np.concatenate([lower.vertices, upper.vertices]),
        np.concatenate([lower.faces, upper.faces + lower.vertex_count]),
    )


def two_layers(count: int = 9, gap: float = 0.003) -> ClothMesh:
    """Two square layers at 10 mm spacing, the upper one shifted off the lower one's lattice."""
    lower, upper = sheet(count, count, 0.01, 0.0015), sheet(count, count, 0.01, 0.0015 + gap)
    return stack(lower, upper.with_vertices(upper.vertices + np.array([0.0031, 0.0017, 0.0])))


def strain(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    """Relative change of length of every edge."""
    ends = positions[mesh.edges]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / mesh.edge_lengths - 1.0
