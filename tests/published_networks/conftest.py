"""Folded garments at rest on a table, and what a camera above sees of them."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import closest_on_triangle
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer, visible_vertices
from clothtrack.recordings.recording import Table
from clothtrack.simulation.dynamics import ClothDynamics, HeldMotion
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.simulation.solver import ClothSolver

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, eq=False)
class FoldedGarment:
    """The flat garment, where it is, and its depth picture."""

    kind: str
    flat: ClothMesh
    vertices: np.ndarray
    camera: Camera
    depth: np.ndarray
    face: np.ndarray

    @property
    def visible(self):
        return visible_vertices(self.vertices, self.flat.faces, [self.camera.resized(200)])

    def canonical_at(self, rows, columns, points):
        """True canonical positions of points seen at these pixels."""
        corners = self.flat.faces[self.face[rows, columns]]
        blend = closest_on_triangle(points, self.vertices[corners])
        return np.einsum("pk,pki->pi", blend, self.flat.canonical[corners])


def settle(solver, speed, limit_s):
    """Let the cloth move freely until no vertex exceeds a speed [m/s], or a limit [s]."""
    for _ in range(round(limit_s / 0.02)):
        if solver.step(0.02).max() < speed:
            break


@cache
def fold(kind):
    """Lifts a corner of a towel, or a sleeve, over the rest and lets it down."""
    mesh = garment(kind, vertex_count=500)
    raised = mesh.vertices - (0.0, 0.0, mesh.vertices[:, 2].min() - 0.0015)
    mesh = replace(mesh, vertices=raised)
    solver = ClothSolver(mesh, SolverConfig(table=TABLE))
    settle(solver, speed=0.1, limit_s=0.3)
    start = solver.positions[0]
    along, to = start[:, 0] + start[:, 1], np.array([-0.13, -0.09, 0.012])
    if kind == "tshirt":
        along, to = start[:, 0], np.array([-0.30, 0.02, 0.012])
    held = np.argsort(-along)[:6]
    share = np.linspace(0.0, 1.0, 15)[:, None, None]
    way = start[held] + share * to + (0.0, 0.0, 0.12) * np.sin(np.pi * share)
    ClothDynamics(solver).roll_out(None, HeldMotion(held, way), 1.2)
    settle(solver, speed=0.03, limit_s=1.0)
    vertices = solver.positions[0].astype(np.float64)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = vertices[:, 0].mean(), vertices[:, 1].mean(), 0.8
    camera = Camera("above", 400, 400, 480.0, 480.0, 199.5, 199.5, pose)
    buffer = Rasterizer(mesh.faces, camera).render(vertices)
    depth = np.where(np.isfinite(buffer.depth), buffer.depth, 0.0)
    return FoldedGarment(kind, mesh, vertices, camera, depth, buffer.faces)


@pytest.fixture(scope="session", params=["towel", "tshirt"])
def folded(request):
    return fold(request.param)


@pytest.fixture(scope="session")
def folded_towel():
    return fold("towel")
