import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver

MESH = towel(0.12, 0.1, 0.01, pattern="random")


@pytest.mark.parametrize("buckling", [1.0, 20.0])
def test_all_colors_at_once_are_the_colors_one_after_the_other(buckling):
    softness = [ClothParameters(1e-5, 1.0), ClothParameters(0.0, 100.0)]
    config = SolverConfig(buckling=buckling)
    solver = ClothSolver(MESH, config, parameters=softness, environments=2)
    solver._set_clock(0.001, 1, solver.config.rebuild_s)
    noise = np.random.default_rng(1).normal(scale=0.002, size=(2, *MESH.vertices.shape))
    # Folded as well: pairs under the bend limit resist without compliance.
    shape = MESH.vertices * (0.4, 1.0, 1.0) + noise
    masses = solver._buffers.inverse_masses.numpy()
    masses[1, :5] = 0.0
    solver._buffers.inverse_masses.assign(masses)

    solver.place(shape)
    solver._launch_constraints()
    at_once = solver.positions
    solver.place(shape)
    # As on a GPU: one launch for each color.
    solver._stretch._is_cpu = solver._bend._is_cpu = False
    solver._launch_constraints()

    assert np.abs(at_once - shape).max() > 1e-3
    np.testing.assert_array_equal(at_once[1, :5], shape.astype(np.float32)[1, :5])
    np.testing.assert_allclose(at_once, solver.positions, atol=2e-8)
