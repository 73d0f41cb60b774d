"""A two-layer shirt is folded over by its corner: its layers stay apart."""

from dataclasses import replace

import numpy as np

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.quality import crossings
from clothtrack.recordings.recording import Table
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.picker_action import HeldMotion
from clothtrack.simulation.solver import ClothSolver

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
STEPS = 24
STEP_S = 0.05


def most_crossings(edge_contact: bool) -> int:
    """Most edges that pass through a triangle, while a sleeve is carried inwards and down."""
    flat = garment("tshirt", vertex_count=700, size_m=(0.30, 0.27), seed=0)
    mesh = flat.with_vertices(flat.vertices + (0.0, 0.0, 0.002 - flat.vertices[:, 2].min()))
    held = int(np.argmax(mesh.vertices @ (1.0, 0.0, 0.5)))
    share = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    tips = mesh.vertices[held] + share * (-0.12, -0.03, 0.01)
    tips[:, 2] += 0.08 * np.sin(np.pi * share[:, 0])
    config = replace(SolverConfig(table=TABLE), edge_contact=edge_contact)
    dynamics = ClothDynamics(ClothSolver(mesh, config, parameters=ClothParameters()))
    counts = []
    for step in range(STEPS):
        motion = HeldMotion(np.array([held], np.int32), tips[step : step + 2, None])
        rolled = dynamics.roll_out(None, motion, STEP_S)
        counts.append(crossings(rolled.positions[0], mesh.faces))
    return max(counts)


def test_the_layers_of_a_folded_sleeve_stay_apart():
    assert most_crossings(True) <= 1


def test_vertices_and_triangles_alone_do_not_keep_them_apart():
    assert most_crossings(False) >= 4
