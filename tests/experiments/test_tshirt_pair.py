"""The T-shirt pair's converter and scorer on a made-up set of the same layout."""

import json
import shutil

import cv2
import numpy as np
import pytest
from real import tshirt_pair
from real.upright import WORLD_FROM_CAMERA, upright

from clothtrack.recordings import read_mask, read_recording

SHIFT_PX, DEPTH_MM, FOCAL = 40, 1000, 400.0
SHIFT_M = SHIFT_PX / FOCAL * DEPTH_MM * 1e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A blue cloth in front of a gray wall, carried sideways by 10 cm, with some sensor noise."""
    folder = tmp_path_factory.mktemp("set") / tshirt_pair.NAME
    folder.mkdir()
    intrinsics = {"width": 320, "height": 240, "fx": FOCAL, "fy": FOCAL, "cx": 159.5, "cy": 119.5}
    (folder / "intrinsics.json").write_text(json.dumps(intrinsics))
    rng = np.random.default_rng(0)
    for number, left in ((3, 100), (9, 100 + SHIFT_PX)):
        cloth = np.zeros((240, 320), bool)
        cloth[60:180, left : left + 100] = True
        color = np.where(cloth[..., None], (150, 60, 30), (120, 120, 120))
        color = np.clip(color + rng.normal(0, 4, color.shape), 0, 255).astype(np.uint8)
        depth = np.where(cloth, DEPTH_MM, 2000).astype(np.uint16)
        cv2.imwrite(str(folder / f"color_{number:03d}.png"), color)
        cv2.imwrite(str(folder / f"depth_{number:03d}.png"), depth)
        if number == 3:
            cv2.imwrite(str(folder / "mask_003.png"), cloth.astype(np.uint8) * 255)
            rows, columns = np.nonzero(cloth)
    motion = np.tile(np.array([SHIFT_M, 0, 0], np.float32), (len(rows), 1))
    np.savez(
        folder / "flow_003_to_009.npz",
        u=columns.astype(np.int16),
        v=rows.astype(np.int16),
        scene_flow_m=motion,
        optical_flow_px=motion[:, :2],
    )
    start = [-0.14, -0.14, 1.0]
    grips = [{"start_m": start, "end_m": [start[0] + SHIFT_M, *start[1:]]}]
    (folder / "grips.json").write_text(json.dumps(grips))
    return folder


def test_the_mesh_is_what_the_first_frame_shows(folder):
    mesh = tshirt_pair.front_mesh(folder)
    np.testing.assert_allclose(mesh.vertices[:, 1], 1.0, atol=1e-6)
    assert np.median(mesh.edge_lengths) == pytest.approx(0.01, rel=0.01)
    # Whole cells of 1 cm inside the mask without its rim.
    assert mesh.vertex_areas.sum() == pytest.approx(0.23 * 0.28, rel=1e-3)


def test_the_right_motion_scores_nothing_and_none_scores_its_length(folder):
    mesh = tshirt_pair.front_mesh(folder)
    moved = mesh.vertices + upright(np.array([SHIFT_M, 0.0, 0.0]))
    exact = tshirt_pair.score(np.stack([mesh.vertices, moved]), mesh.faces, folder)
    still = tshirt_pair.score(np.stack([mesh.vertices] * 2), mesh.faces, folder)
    assert exact.summary()["end_point_error_mm"] == pytest.approx(0.0, abs=1e-3)
    assert still.summary()["end_point_error_mm"] == pytest.approx(SHIFT_M * 1e3, rel=1e-4)
    assert exact.summary()["pixels"] == 120 * 100


def test_a_rotation_is_carried_by_the_triangles(folder):
    mesh = tshirt_pair.front_mesh(folder)
    points, _ = tshirt_pair.true_motion(folder)
    angle = 0.2
    turn = np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    score = tshirt_pair.score(np.stack([mesh.vertices, mesh.vertices @ turn.T]), mesh.faces, folder)
    expected = np.linalg.norm(points @ turn.T - points - (SHIFT_M, 0, 0), axis=1)
    inside = score.off_mesh_m < 1e-6
    assert inside.mean() > 0.85
    np.testing.assert_allclose(score.end_point_error_m[inside], expected[inside], atol=1e-6)


def test_the_recording_follows_the_shirt_by_its_color(folder, tmp_path):
    recording = read_recording(tshirt_pair.convert(folder, tmp_path / "r"))
    assert [frame.time_s for frame in recording.frames] == pytest.approx([0.0, 6 / 30.0])
    later = read_mask(recording.frames[1].mask[tshirt_pair.CAMERA])
    truth = np.zeros_like(later)
    truth[60:180, 140:240] = True
    assert (later & truth).sum() / (later | truth).sum() > 0.97
    held = recording.cloth.held_vertices["hand0"]
    path = recording.picker_paths["hand0"]
    away = np.linalg.norm(recording.cloth.template.vertices[held] - path.positions[0], axis=1)
    assert away.max() <= max(tshirt_pair.GRIP_RADIUS_M, away.min()) + 1e-9
    np.testing.assert_allclose(np.diff(path.positions, axis=0), [[SHIFT_M, 0, 0]], atol=1e-9)


@pytest.mark.parametrize(("pitch_deg", "yaw_deg"), [(10.0, -6.0), (-5.0, 20.0)])
def test_the_wall_tells_where_down_is(folder, tmp_path, pitch_deg, yaw_deg):
    """A hand-held camera looks down or up at a wall that it does not face squarely."""
    tilted = tmp_path / "tilted"
    shutil.copytree(folder, tilted)
    pitch, yaw = np.deg2rad([pitch_deg, yaw_deg])
    # Camera frame: x right, y down, z forward. Looking down, the horizontal is above the middle.
    away = np.array([np.sin(yaw), -np.cos(yaw) * np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    columns, rows = np.meshgrid(np.arange(320), np.arange(240))
    sights = np.stack([(columns - 159.5) / FOCAL, (rows - 119.5) / FOCAL, np.ones((240, 320))], -1)
    depth = 2000.0 / (sights @ away)
    depth[60:180, 100:200] = DEPTH_MM
    cv2.imwrite(str(tilted / "depth_003.png"), np.rint(depth).astype(np.uint16))
    pose = tshirt_pair.standing_camera(tilted).world_from_camera
    np.testing.assert_allclose(pose[:3, :3] @ away, [np.sin(yaw), np.cos(yaw), 0.0], atol=0.01)
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)


def test_without_a_wall_the_camera_is_level(folder, tmp_path):
    cluttered = tmp_path / "cluttered"
    shutil.copytree(folder, cluttered)
    depth = np.random.default_rng(0).integers(1000, 4000, (240, 320)).astype(np.uint16)
    cv2.imwrite(str(cluttered / "depth_003.png"), depth)
    pose = tshirt_pair.standing_camera(cluttered).world_from_camera
    np.testing.assert_array_equal(pose, WORLD_FROM_CAMERA)
