"""The hanging cloth's converter and scorer on a made-up set of the same layout."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from real import hanging_cloth
from real.hanging_learning import SPLITS, HangingFrames
from real.pattern import PatternConfig, Unwrapper, pattern_drift
from real.upright import WORLD_FROM_CAMERA, level_camera, upright

from clothtrack.garments import towel
from clothtrack.recordings import observe, read_recording

SIDE, WIDTH_M, DEPTH_M, FRAMES = 9, 0.4, 1.0, 3
COUNT = SIDE * SIDE
INTRINSICS = {"width": 320, "height": 240, "fx": 400.0, "fy": 400.0, "cx": 159.5, "cy": 119.5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A flat printed cloth facing the camera, which hangs still."""
    folder = tmp_path_factory.mktemp("set") / hanging_cloth.NAME
    for kind in ("color", "depth", "mask"):
        (folder / kind).mkdir(parents=True)
    (folder / "intrinsics.json").write_text(json.dumps(INTRINSICS))
    vertices = grid()
    index = np.arange(COUNT).reshape(SIDE, SIDE) + 1
    quads = np.stack([index[1:, 1:], index[:-1, 1:], index[:-1, :-1], index[1:, :-1]], -1)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += ["f " + " ".join(f"{v}/{v}" for v in quad) for quad in quads.reshape(-1, 4)]
    (folder / "template_frame000.obj").write_text("\n".join(lines))
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (240, 320, 3)).astype(np.float32), (0, 0), 2.0)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    half = round(0.5 * WIDTH_M / DEPTH_M * INTRINSICS["fx"])
    mask = np.zeros((240, 320), np.uint8)
    mask[120 - half : 120 + half, 160 - half : 160 + half] = 255
    mask[230:235, 10:20] = 255  # somebody's shoe
    for frame in range(FRAMES):
        cv2.imwrite(str(folder / f"color/{frame:03d}.png"), picture)
        cv2.imwrite(str(folder / f"mask/{frame:03d}.png"), mask)
        cv2.imwrite(
            str(folder / f"depth/{frame:03d}.png"),
            np.full((240, 320), 1000, np.uint16) * (mask > 0),
        )
    with (folder / "actions.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "grip", "vertex", "x", "y", "z"])
        for frame in range(FRAMES):
            for grip, vertex in ((0, 0), (1, COUNT - SIDE)):
                writer.writerow([frame, grip, vertex, *vertices[vertex]])
    dense = np.stack(np.meshgrid(*[np.linspace(-0.2, 0.2, 201)] * 2, [DEPTH_M]), -1).reshape(-1, 3)
    np.savez(
        folder / "points.npz",
        points_mm=np.tile(np.rint(dense * 1e3).astype(np.int16), (FRAMES, 1)),
        offsets=np.arange(FRAMES + 1) * len(dense),
    )
    return folder


def grid():
    ticks = np.linspace(-0.5 * WIDTH_M, 0.5 * WIDTH_M, SIDE)
    return np.stack(np.meshgrid(ticks, ticks, [DEPTH_M], indexing="ij"), -1).reshape(-1, 3)


def test_the_world_stands_upright():
    down, forward = upright(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(down, [0, 0, -1])
    np.testing.assert_array_equal(forward, [0, 1, 0])
    assert np.linalg.det(WORLD_FROM_CAMERA) == pytest.approx(1.0)


def test_the_template_is_cut_into_triangles_that_face_one_way(folder):
    mesh = hanging_cloth.template(folder)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(normals[:, 1], normals[0, 1], rtol=1e-4)
    assert mesh.vertex_areas.sum() == pytest.approx(WIDTH_M**2, rel=1e-4)
    assert len(mesh.edges) == 2 * SIDE * (SIDE - 1) + (SIDE - 1) ** 2
    # Neighboring cells are cut along different diagonals.
    diagonals = np.abs(np.diff(mesh.edges, axis=1))
    assert {SIDE - 1, SIDE + 1} <= set(diagonals.ravel().tolist())


def test_the_recording_shows_the_template_where_it_is(folder, tmp_path):
    recording = read_recording(hanging_cloth.convert(folder, tmp_path / "r"))
    mesh = recording.cloth.template
    assert recording.table is None
    assert [(a.first_frame, a.last_frame) for a in recording.actions] == [(0, FRAMES - 1)]
    for name, vertex in (("grip0", 0), ("grip1", COUNT - SIDE)):
        assert recording.cloth.held_vertices[name].tolist() == [vertex]
        path = recording.picker_paths[name]
        assert path.closed.all()
        np.testing.assert_allclose(path.positions, np.tile(mesh.vertices[vertex], (FRAMES, 1)))
    points = observe(recording, recording.frames[-1]).points
    # The shoe is left out, and what remains is the template's plane and extent.
    np.testing.assert_allclose(points[:, 1], DEPTH_M, atol=1e-6)
    np.testing.assert_allclose(np.ptp(points[:, [0, 2]], axis=0), WIDTH_M, atol=0.006)


def test_fewer_frames_can_be_taken(folder, tmp_path):
    recording = read_recording(hanging_cloth.convert(folder, tmp_path / "r", frames=2))
    assert len(recording.frames) == 2
    assert recording.actions[0].last_frame == 1


def test_the_still_cloth_scores_only_the_sampling(folder):
    mesh = hanging_cloth.template(folder)
    still = np.repeat(mesh.vertices[None], FRAMES, axis=0)
    score = hanging_cloth.score(still, mesh.faces, folder)
    assert score.chamfer_surface_m2.max() < 3e-6  # 2 mm grid of points
    assert score.edge_strain.max() == pytest.approx(0.0, abs=1e-9)
    assert score.worst_drift_mm < 0.1
    assert score.summary()["pattern_matched"] == 1.0


def test_a_cloth_too_near_by_h_scores_two_h_squared_and_stretching_is_strain(folder):
    mesh = hanging_cloth.template(folder)
    moved = mesh.vertices + np.array([0.0, 0.03, 0.0])
    score = hanging_cloth.score(moved[None], mesh.faces, folder)
    assert score.chamfer_surface_m2[0] == pytest.approx(2 * 0.03**2, rel=0.01)
    wider = mesh.vertices * 1.1
    assert hanging_cloth.score(wider[None], mesh.faces, folder).edge_strain[0] == pytest.approx(0.1)


def test_a_sliding_mesh_is_caught_although_the_surface_agrees(folder):
    mesh = hanging_cloth.template(folder)
    slid = np.repeat(mesh.vertices[None], FRAMES, axis=0) + np.array([0.012, 0.0, 0.009])
    score = hanging_cloth.score(slid, mesh.faces, folder)
    assert score.worst_drift_mm == pytest.approx(15.0, abs=0.5)
    assert score.chamfer_surface_m2.max() < 1e-4


def test_a_lost_print_is_called_lost(folder):
    mesh = hanging_cloth.template(folder)
    turned = mesh.vertices[::-1].copy()
    score = hanging_cloth.score(turned[None], mesh.faces, folder)
    assert score.worst_drift_mm is None
    assert score.summary()["pattern_matched"] == 0.0


def test_another_triangulation_finds_the_same_print(folder):
    mesh = hanging_cloth.template(folder)
    finer = np.stack(np.meshgrid(*[np.linspace(0, WIDTH_M, 15)] * 2, indexing="ij"), -1)
    finer = finer.reshape(-1, 2)
    origin = mesh.vertices[0]
    placed = origin + np.stack([finer[:, 0], np.zeros(len(finer)), -finer[:, 1]], axis=1)
    camera = level_camera(folder / "intrinsics.json")
    picture = hanging_cloth.read_picture(folder / "color/000.png")
    first = Unwrapper(mesh.canonical[:, :2])(picture, mesh.vertices, camera)
    later = Unwrapper(finer)(picture, placed, camera)
    drift = pattern_drift(first, later, PatternConfig())
    assert drift.matched == 1.0
    assert drift.mean_slide_mm < 0.1


@pytest.mark.parametrize(("count", "rows"), [(50, [10, 20, 30, 40, 49]), (3, [1, 2]), (1, [0])])
def test_the_judged_frames_end_with_the_last(count, rows):
    assert hanging_cloth.judged_rows(count) == rows


@pytest.fixture(scope="module")
def hanging(folder, tmp_path_factory):
    """The frames as Table 2 takes them, and the cloth as a faultless tracker would follow it."""
    recording = hanging_cloth.convert(folder, tmp_path_factory.mktemp("learned") / "recording")
    mesh = hanging_cloth.template(folder)
    still = SimpleNamespace(mesh=mesh, positions=np.stack([mesh.vertices] * FRAMES))
    return HangingFrames("hanging", folder, recording, range(FRAMES)), still


def test_the_network_is_shown_the_hanging_cloth_lying(hanging):
    frames, still = hanging
    picture = frames.picture(1)
    seen = picture.camera.back_project(picture.depth_m, picture.mask)
    np.testing.assert_allclose(seen[:, 2], -DEPTH_M, atol=1e-6)
    assert picture.size_m == pytest.approx((WIDTH_M, WIDTH_M))
    mesh, rest = frames.tracked_mesh(still)(1)
    np.testing.assert_allclose(mesh.vertices[:, 2], -DEPTH_M, atol=1e-6)
    assert rest is still.mesh
    for labeled in (frames.labeled(still), frames.simulated(still)):
        assert labeled.frames == tuple(range(FRAMES))
        for one in labeled.pictures:
            assert (one.faces[one.mask] >= 0).mean() > 0.95


def test_the_held_corners_and_the_print_judge_it(hanging):
    frames, still = hanging
    mesh, rest = frames.tracked_mesh(still)(1)
    row = frames.judged(1, mesh, rest, still)
    assert row["corner_mm"] == pytest.approx(0.0, abs=0.01)
    assert row["edge_strain"] < 1e-6
    assert row["print_matched"] > 0.95
    # A square without marks may be named in eight ways; nobody is told which is meant.
    renamed = mesh.canonical[:, [1, 0, 2]] * (-1, 1, 1)
    other = frames.judged(1, replace(mesh, canonical=renamed), rest, still)
    assert other["print_matched"] == pytest.approx(row["print_matched"])
    # A network's mesh has other vertices than the template.
    coarse = towel(WIDTH_M, WIDTH_M, WIDTH_M / 6)
    hung = coarse.with_vertices(coarse.vertices - (0.0, 0.0, DEPTH_M))
    assert frames.judged(1, hung, coarse, still)["print_matched"] > 0.9
    slid = mesh.with_vertices(mesh.vertices + (0.05, 0.0, 0.0))
    worse = frames.judged(1, slid, rest, still)
    assert worse["corner_mm"] == pytest.approx(50.0, abs=0.1)
    assert worse["chamfer_mesh_m2"] > row["chamfer_mesh_m2"]


@pytest.mark.parametrize("split", SPLITS)
def test_no_frame_is_judged_whose_neighbor_was_learned_from(split):
    learned, judged = SPLITS[split]
    frames = [frame for each in learned for frame in each]
    assert len(frames) == len(set(frames)) >= 25
    assert len(judged) == 15
    assert min(abs(one - other) for one in frames for other in judged) > 5
