"""theta is the cloth's: what the solver makes of it depends on the mesh."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.simulation.constraints import bend_constraints
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.theta import BEND_SPACING_M

THETA = RunConfig().cloth.theta()


def bending_energy(spacing_m: float, radius_m: float) -> float:
    """Energy per area [J/m^2] of a towel laid around a cylinder."""
    flat = towel(width_m=0.24, length_m=0.24, spacing_m=spacing_m)
    x, y, _ = np.asarray(flat.vertices, float).T
    bent = np.stack([radius_m * np.sin(x / radius_m), y, radius_m * np.cos(x / radius_m)], axis=1)
    pairs = bend_constraints(flat)
    ends = bent[pairs.pairs]
    shortened = pairs.lengths - np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    compliance = THETA.cloth_parameters(flat).bend_compliance
    return float(0.5 * np.sum(shortened**2) / compliance / 0.24**2)


@pytest.mark.parametrize("radius_m", [0.05, 0.1])
def test_a_bent_cloth_stores_the_same_energy_whatever_its_mesh(radius_m: float) -> None:
    coarse, fine = bending_energy(0.015, radius_m), bending_energy(0.0075, radius_m)
    assert coarse == pytest.approx(fine, rel=0.1)
    assert coarse > 0.0


def test_the_other_parameters_do_not_depend_on_the_mesh() -> None:
    mesh = towel(width_m=0.24, length_m=0.24, spacing_m=0.016)
    made = THETA.cloth_parameters(mesh)
    assert made.stretch_compliance == THETA.stretch_compliance
    assert made.table_friction == THETA.table_friction
    assert made.particle_friction == THETA.particle_friction
    ratio = float(mesh.edge_lengths.mean()) / BEND_SPACING_M
    assert made.bend_compliance == pytest.approx(THETA.bend_compliance * ratio**4)
