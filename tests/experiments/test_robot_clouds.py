"""The Chamfer distance of the robot's clouds on a drawn set of the same layout."""

import numpy as np
import pytest
from real import robot_clouds
from real.drawn_sets import FRAMES, SQUARE_M, write_robot_clouds


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A square that rises as a whole by 2 cm a frame, seen from above, cut at 6 cm."""
    folder = write_robot_clouds(tmp_path_factory.mktemp("set")) / robot_clouds.NAME
    return folder / "sequences" / "lift_white.npz"


@pytest.fixture(scope="module")
def rising(file):
    """The square's true positions, and its mesh."""
    mesh = robot_clouds.start_mesh(robot_clouds.load(file))
    flat = mesh.vertices - (0, 0, robot_clouds.RESTING_HEIGHT_M)
    return np.stack([flat + np.array([0, 0, 0.02 * frame]) for frame in range(FRAMES)]), mesh


def test_the_truth_scores_only_its_spacing(file, rising):
    positions, mesh = rising
    score = robot_clouds.score(positions, mesh.faces, file)
    assert score.frames.tolist() == [6, 7, 8]
    assert score.chamfer_pc_m2.max() < mesh.edge_lengths.max() ** 2
    assert score.edge_strain.max() < 1e-9


def test_a_shift_up_by_h_adds_two_h_squared(file, rising):
    positions, mesh = rising
    h = 0.03
    exact = robot_clouds.score(positions, mesh.faces, file).chamfer_pc_m2
    shifted = robot_clouds.score(positions + np.array([0, 0, h]), mesh.faces, file).chamfer_pc_m2
    np.testing.assert_allclose(shifted - exact, 2 * h**2, rtol=1e-3)


def test_the_tool_excuses_vertices_near_it_and_no_others(file, rising):
    positions, mesh = rising
    wrong = positions.copy()
    near = np.linalg.norm(mesh.vertices[:, :2] - SQUARE_M, axis=1) < 0.02
    wrong[:, near, 2] += 0.02
    far = np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.02
    wrong_far = positions.copy()
    wrong_far[:, far, 2] += 0.02

    def vertices_to_cloud(moved):
        score = robot_clouds.score(moved, mesh.faces, file)
        return score.chamfer_pc_m2 - score.cloud_to_mesh_m2

    exact = vertices_to_cloud(positions)
    np.testing.assert_allclose(vertices_to_cloud(wrong), exact, rtol=1e-3)
    assert (vertices_to_cloud(wrong_far) > exact + far.sum() / len(far) * 0.015**2).all()
