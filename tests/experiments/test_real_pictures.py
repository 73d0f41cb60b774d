"""The judge of single real pictures, on pictures that the project's own renderer drew."""

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from real import drawn_topdown, real_pictures, topdown
from real.picture_scores import assigned, at_stickers, moved_in, silhouette_iou

from clothtrack.garments import garment
from clothtrack.reconstruction import NetworkMesh, Reconstruction
from clothtrack.reconstruction.seen_points import SeenPoints

REAL = os.environ.get("CLOTHTRACK_TOPDOWN_REAL")
WORDS = ("trust: right", "look: right", "reject: right")
KEYS = {
    "garments": {"rows", "iou", "chamfer_median_m2", *WORDS},
    "stickers": {
        "rows", "iou", "one_to_one_side", "within_0_1", "within_bounds",
        "control_one_to_one_side", "control_within_0_1", *WORDS,
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return drawn_topdown.write(tmp_path_factory.mktemp("drawn"))


@pytest.fixture
def told_the_truth(data, monkeypatch):
    """A network that answers with the mesh that was drawn."""
    flat = garment("towel", vertex_count=400, size_m=(drawn_topdown.SIDE_M, drawn_topdown.SIDE_M))

    def truth(picture, *_args, **_settings):
        # Only the flat towel lies no higher than the first layer.
        points = picture.camera.back_project(picture.depth_m, picture.mask)
        mesh = flat if points[:, 2].max() < 0.004 else drawn_topdown.folded()
        if picture.camera.name == "top":
            mesh = mesh.with_vertices(placed(mesh.vertices, picture.camera))
        seen = SeenPoints(points, points, np.ones(len(points)))
        image, sure = np.zeros((2, 2, 3), np.float32), np.ones((2, 2), np.float32)
        return NetworkMesh(
            mesh,
            Reconstruction(mesh, "template", picture.camera, image, sure, seen),
            expected_error_m=1e-3,
            spread_m=np.full(mesh.vertex_count, 1e-3),
        )

    network = SimpleNamespace(mesh=truth)
    monkeypatch.setattr(real_pictures, "load_model", lambda *_, **__: network)
    return network


def placed(vertices, camera):
    """Vertices of the drawn world in the world that the fitted table gives."""
    turn, _ = cv2.Rodrigues(np.radians(drawn_topdown.TILT_DEG) * np.array([1.0, 0.0, 0.0]))
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn
    pose[:3, 3] = -pose[:3, 2] * drawn_topdown.DISTANCE_M
    change = camera.world_from_camera @ np.linalg.inv(pose)
    return (vertices @ change[:3, :3].T + change[:3, 3]).astype(np.float32)


def scored(data, folder, *words):
    out = folder / "scores.json"
    code = real_pictures.main(["--data", str(data), "--json", str(out), *words])
    return code, json.loads(out.read_text())


def test_the_truth_has_no_error(data, told_the_truth, tmp_path):
    code, report = scored(data, tmp_path)
    assert code == 0
    for name, keys in KEYS.items():
        assert {key for key in report[name] if "without" not in key} == keys
        assert len([key for key in report[name] if "without" in key]) == 4
        for row in report[name]["rows"]:
            assert row["iou"] > 0.95
            assert row["chamfer_m2"] < 2e-5
            assert row["word"] == "trust"
            assert row["right"]
    (tilted,) = report["garments"]["rows"]
    assert tilted["tilt_deg"] == pytest.approx(drawn_topdown.TILT_DEG, abs=0.1)
    assert tilted["table_source"] == "fitted"
    stickers = report["stickers"]
    assert stickers["one_to_one_side"] < 0.005
    assert stickers["within_0_1"] == 1.0
    assert stickers["within_bounds"] == 1.0
    assert stickers["trust: right"] == f"{len(stickers['rows'])} of {len(stickers['rows'])}"
    flat = stickers["rows"][0]
    # The control's corners are not moved in: a sticker's middle lies so far from the corner.
    assert flat["control_side"] == pytest.approx([topdown.STICKER_INSET] * 2, abs=0.006)
    assert flat["control_moved_in_side"] == pytest.approx([0.0, 0.0], abs=0.006)


def test_a_run_goes_on_where_it_stopped(data, told_the_truth, tmp_path, monkeypatch, capsys):
    keep = tmp_path / "keep"
    _, first = scored(data, tmp_path, "--keep", str(keep))
    assert cv2.imread(str(keep / "garments.png")) is not None
    assert cv2.imread(str(keep / "stickers.png")) is not None
    (keep / "stickers" / "square_01.ply").unlink()
    capsys.readouterr()
    asked = []
    answer = told_the_truth.mesh
    monkeypatch.setattr(told_the_truth, "mesh", lambda *a, **k: asked.append(1) or answer(*a, **k))
    _, second = scored(data, tmp_path, "--keep", str(keep))
    assert len(asked) == 1
    assert second["garments"] == first["garments"]
    (keep / "stickers" / "square_01.ply").unlink()
    # Without --keep no mesh is wanted.
    scored(data, tmp_path)
    assert len(asked) == 1


def test_rows_of_other_pictures_are_not_taken(data, told_the_truth, tmp_path):
    scored(data, tmp_path)
    other = tmp_path / "other"
    shutil.copytree(data, other)
    meta = json.loads((other / "garments" / "meta.json").read_text())
    meta["frames"][0]["garment"] = "polo"
    (other / "garments" / "meta.json").write_text(json.dumps(meta))
    _, report = scored(other, tmp_path)
    assert report["garments"]["rows"][0]["kind"] == "tshirt"


def test_a_set_that_is_absent_is_skipped(data, told_the_truth, tmp_path, capsys):
    alone = tmp_path / "alone"
    shutil.copytree(data / "stickers", alone / "stickers")
    code, report = scored(alone, tmp_path)
    assert code == 0
    assert set(report) == {"provenance", "stickers"}
    assert f"garments: skipped, there is no {alone / 'garments'}" in capsys.readouterr().out
    assert real_pictures.main(["--data", str(tmp_path / "nothing")]) == 1


def test_a_picture_without_a_table_is_a_row_that_says_so(data, told_the_truth, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(data / "garments", broken / "garments")
    noise = np.random.default_rng(0).integers(300, 3000, (120, 160)).astype(np.uint16)
    cv2.imwrite(str(broken / "garments" / "depth" / "03.png"), noise)
    code, report = scored(broken, tmp_path)
    assert code == 0
    (row,) = report["garments"]["rows"]
    assert "no plane dominates" in row["error"]
    assert report["garments"]["iou"] == 0.0
    assert report["garments"]["chamfer_median_m2"] is None
    assert report["garments"]["reject: right"] == "0 of 1"


def test_stickers_are_given_to_corners_one_to_one():
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    # Both are nearest to the first corner; one must take the second.
    stickers = np.array([[1.0, 0.0], [4.0, 0.0]])
    apart, corner = assigned(stickers, corners)
    np.testing.assert_allclose(apart, [1.0, 6.0])
    assert corner.tolist() == [0, 1]


def test_places_of_stickers_lie_inside_the_corners():
    mesh = garment("towel", vertex_count=300, size_m=(0.3, 0.2))
    corners = np.array([(x, y, 0.0) for x in (-0.15, 0.15) for y in (-0.1, 0.1)])
    apart = np.linalg.norm(at_stickers(mesh, mesh.vertices.astype(float)) - corners, axis=1)
    np.testing.assert_allclose(apart, 0.3 * topdown.STICKER_INSET, rtol=1e-4)
    rectangle = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])
    moved = moved_in(rectangle, 2.0)
    np.testing.assert_allclose(np.linalg.norm(moved - rectangle, axis=1), 2.0)
    assert (moved.min(axis=0) > 0).all()
    np.testing.assert_allclose(moved_in(rectangle, 99.0), np.tile((15.0, 10.0), (4, 1)))


def test_the_overlap_of_silhouettes():
    one, other = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    one[:2], other[1:3] = True, True
    assert silhouette_iou(one, other) == pytest.approx(1 / 3)


@pytest.mark.skipif(
    REAL is None, reason="CLOTHTRACK_TOPDOWN_REAL names no folder of real pictures from above"
)
def test_the_real_pictures_stand_on_their_tables():
    for entry in topdown.garments(Path(REAL) / "garments"):
        depth = entry.read().depth
        assert depth.table_source == "fitted"
        assert depth.table_residual_m < 0.004
        points = depth.camera.back_project(depth.depth_m, depth.mask)
        assert -0.005 < np.percentile(points[:, 2], 5.0) < 0.005
    for entry in topdown.stickers(Path(REAL) / "stickers"):
        picture = entry.read()
        assert picture.size_m[0] == pytest.approx(0.30, abs=0.02)
        assert len(picture.stickers) <= 4
