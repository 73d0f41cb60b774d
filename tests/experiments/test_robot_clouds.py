"""The robot's converter and scorer on a made-up set of the same layout."""

import numpy as np
import pytest
from real import drawn_robot_clouds, robot_clouds
from real.drawn_robot_clouds import CUT_M, FRAMES, SIDE_M, TABLE_M

from clothtrack.recordings import observe, read_recording


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A square that rises as a whole by 2 cm a frame, seen from above, cut at 6 cm."""
    folder = drawn_robot_clouds.write(tmp_path_factory.mktemp("set")) / robot_clouds.NAME
    return folder / "sequences" / "lift_white.npz"


@pytest.fixture(scope="module")
def rising(file):
    """The square's true positions, and its mesh."""
    mesh = robot_clouds.start_mesh(robot_clouds.load(file))
    flat = mesh.vertices - (0, 0, robot_clouds.RESTING_HEIGHT_M)
    return np.stack([flat + np.array([0, 0, 0.02 * frame]) for frame in range(FRAMES)]), mesh


def test_the_start_square_is_the_stored_one(file):
    mesh = robot_clouds.start_mesh(robot_clouds.load(file))
    assert mesh.vertex_count == 33 * 33
    assert mesh.vertex_areas.sum() == pytest.approx(SIDE_M**2)
    assert mesh.vertices[:, 2] == pytest.approx(TABLE_M + robot_clouds.RESTING_HEIGHT_M)


def test_the_recording_carries_clouds_cut_and_tool(file, tmp_path):
    raised = robot_clouds.load(file)
    recording = read_recording(robot_clouds.convert(file, tmp_path / "r"))
    assert recording.table.point[2] == TABLE_M
    assert recording.observed.lowest_height_m == CUT_M
    assert recording.observed.tool_clearance_m == 0.045
    held = recording.cloth.held_vertices[robot_clouds.PICKER]
    distance = np.linalg.norm(recording.cloth.template.vertices[held] - raised.picked, axis=1)
    assert distance.max() < 0.002
    assert recording.actions[0].last_frame == FRAMES - 1
    observation = observe(recording, recording.frames[-1], spacing_m=None)
    np.testing.assert_allclose(observation.points, raised.clouds[-1], atol=1e-9)
    np.testing.assert_allclose(observation.tool_positions[0], raised.gripper[-1])


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
    near = np.linalg.norm(mesh.vertices[:, :2] - SIDE_M, axis=1) < 0.02
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


def test_what_lies_under_the_band_does_not_count(file, rising):
    positions, mesh = rising
    low = positions.copy()
    # A third of the square drops out of what the sensor kept.
    dropped = mesh.vertices[:, 0] < SIDE_M / 3
    low[:, dropped, 2] = CUT_M + 0.5 * robot_clouds.BAND_M
    score = robot_clouds.score(low, mesh.faces, file)
    exact = robot_clouds.score(positions, mesh.faces, file)
    back, back_exact = (s.chamfer_pc_m2 - s.cloud_to_mesh_m2 for s in (score, exact))
    np.testing.assert_allclose(back, back_exact, atol=2e-6)
    assert (score.cloud_to_mesh_m2 > exact.cloud_to_mesh_m2 + 1e-4).all()


def test_a_mesh_that_hides_under_the_band_is_still_far_from_the_points(file, rising):
    positions, mesh = rising
    hidden = np.repeat(mesh.vertices[None], FRAMES, axis=0)
    score = robot_clouds.score(hidden, mesh.faces, file)
    heights = positions[6:, 0, 2] - hidden[0, 0, 2]
    np.testing.assert_array_less(heights**2, score.chamfer_pc_m2)


def test_small_clusters_are_strays():
    rng = np.random.default_rng(0)
    cloth = rng.uniform(0, 0.1, (1000, 3)) * (1, 1, 0)
    stray, large = (rng.uniform(0, 0.01, (n, 3)) + np.array([0.3, 0, 0]) for n in (30, 60))
    assert len(robot_clouds.without_strays(np.concatenate([cloth, stray]))) == 1000
    assert len(robot_clouds.without_strays(np.concatenate([cloth, large]))) == 1060
    assert robot_clouds.without_strays(cloth[:0]).shape == (0, 3)
