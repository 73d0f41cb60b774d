"""Table 2 on real cloth: what is learned from, what is judged, and that they share nothing."""

import json
import shutil

import numpy as np
import pytest
from real import drawn_robot_clouds, robot_clouds, table2_real
from real.drawn_robot_clouds import SIDE_M, TABLE_M
from real.robot_learning import (
    LEAST_UNDER,
    Napkin,
    napkins,
    refuse_shared,
)

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry import Camera
from clothtrack.reconstruction.tokens import token_learning
from clothtrack_lab.published_networks import training

NAMES = ("lift_white", "lift_grey", "lift_tan2")


class Tracked:
    """The drawn square as a tracker without fault would follow it."""

    def __init__(self, napkin: Napkin) -> None:
        self.mesh = napkin.flat
        flat = self.mesh.vertices - (0.0, 0.0, robot_clouds.RESTING_HEIGHT_M)
        steps = range(drawn_robot_clouds.FRAMES)
        self.positions = np.stack(
            [flat + (0.0, 0.0, drawn_robot_clouds.STEP_M * frame) for frame in steps]
        )


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("napkins")
    return drawn_robot_clouds.write(folder, NAMES, lowest_z_m=TABLE_M)


@pytest.fixture(scope="module")
def found(data, tmp_path_factory):
    return {one.name: one for one in napkins(data, tmp_path_factory.mktemp("recordings"))}


def test_every_frame_that_is_judged_is_a_label_too(found):
    white = found["lift_white"]
    labeled = white.labeled(Tracked(white))
    assert labeled.frames == (6, 7, 8)
    for picture in labeled.pictures:
        assert (picture.faces[picture.mask] >= 0).mean() > 0.95


def test_the_control_has_the_cut_and_the_tool_and_as_many_points(found):
    gray = found["lift_grey"]
    labeled = gray.simulated(Tracked(gray))
    assert labeled.name == "simulated_lift_grey"
    for frame, picture in zip(labeled.frames, labeled.pictures, strict=True):
        points = picture.camera.back_project(picture.depth_m, picture.mask)
        assert 0 < len(points) <= len(gray.sequence.clouds[frame])
        apart = np.linalg.norm(points - gray.sequence.gripper[frame], axis=1)
        assert apart.min() > robot_clouds.TOOL_CLEARANCE_M - 0.01
        # Its surface is the simulated one, which does not lean as the measured one does.
        assert np.median(points[:, 2]) == pytest.approx(TABLE_M + 0.02 * frame, abs=0.002)
    again = gray.simulated(Tracked(gray))
    np.testing.assert_array_equal(again.pictures[0].depth_m, labeled.pictures[0].depth_m)


def test_the_gripper_judges_the_corner_and_no_one_is_told_of_it(found):
    white = found["lift_white"]
    tracked = Tracked(white)
    mesh = tracked.mesh.with_vertices(tracked.positions[7])
    row = white.judged(7, mesh, tracked.mesh, tracked)
    assert row["corner_mm"] == pytest.approx(0.0, abs=1e-3)
    assert row["chamfer_mesh_m2"] < 2e-5
    assert row["edge_strain"] < 1e-6
    assert row["second_camera_mm"] is None
    turned = tracked.positions[7].copy()
    turned[:, :2] = 1.5 * SIDE_M - turned[:, :2]
    moved = white.judged(7, mesh.with_vertices(turned), tracked.mesh, tracked)
    assert moved["corner_mm"] == pytest.approx(1e3 * np.hypot(0.5, 0.5) * SIDE_M, rel=0.01)
    assert moved["chamfer_pc_m2"] > row["chamfer_pc_m2"]


def test_points_under_others_are_those_of_the_second_camera(found, tmp_path):
    white = found["lift_white"]
    assert len(white.under(8)) < LEAST_UNDER
    below = white.sequence.clouds[8][::5] - (0.0, 0.0, 0.05)
    clouds = [*white.sequence.clouds[:8], np.concatenate([white.sequence.clouds[8], below])]
    file = tmp_path / robot_clouds.NAME / "sequences" / "lift_white.npz"
    file.parent.mkdir(parents=True)
    meta = white.file.parents[1] / "meta.json"
    (tmp_path / robot_clouds.NAME / "meta.json").write_text(meta.read_text())
    np.savez(
        file,
        points_tenth_mm=np.rint(np.concatenate(clouds) * 1e4).astype(np.int16),
        offsets=np.cumsum([0, *map(len, clouds)]),
        gripper_m=white.sequence.gripper,
        time_s=white.sequence.time_s,
    )
    (two_layers,) = napkins(tmp_path, tmp_path / "recordings")
    under = two_layers.under(8)
    assert len(under) == pytest.approx(len(below), rel=0.1)
    assert under[:, 2].max() < TABLE_M + 0.02 * 8 - 0.04


def test_the_picture_is_one_from_straight_above(found):
    picture = found["lift_white"].picture(6)
    assert isinstance(picture.camera, Camera)
    assert picture.size_m == pytest.approx((SIDE_M, SIDE_M))
    seen = picture.camera.back_project(picture.depth_m, picture.mask)
    assert np.median(seen[:, 2]) == pytest.approx(TABLE_M + 0.02 * 6, abs=1e-3)


def test_what_is_learned_from_is_not_judged_under_another_name(found, data, tmp_path):
    other = tmp_path / robot_clouds.NAME / "sequences"
    other.mkdir(parents=True)
    inside = data / robot_clouds.NAME
    (other.parent / "meta.json").write_text((inside / "meta.json").read_text())
    (other / "lift_new.npz").write_bytes((inside / "sequences" / "lift_white.npz").read_bytes())
    again = napkins(tmp_path, tmp_path / "recordings")
    refuse_shared([found["lift_white"]], [found["lift_grey"]])
    with pytest.raises(InvalidConfigError, match=r"lift_new\.npz has \d+ frames of .*lift_white"):
        refuse_shared([found["lift_white"]], again)
    code = table2_real.main(
        ["--data", str(data), "--test", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    )
    assert code == 1


def test_an_empty_folder_is_named(tmp_path, capsys):
    out = tmp_path / "rows.json"
    assert table2_real.main(["--data", str(tmp_path), "--json", str(out)]) == 1
    assert f"{tmp_path}: there are no sequences" in capsys.readouterr().err


def test_statistics_are_over_pictures_and_the_error_over_sequences():
    rows = [
        {"sequence": "a", "corner_mm": 1.0},
        {"sequence": "a", "corner_mm": 3.0},
        {"sequence": "b", "corner_mm": 6.0},
        {"sequence": "b"},
    ]
    found = table2_real._statistics("corner_mm", rows)
    assert found["corner_mm"] == pytest.approx(10 / 3)
    assert found["corner_mm_median"] == 3.0
    assert found["corner_mm_standard_error"] == pytest.approx(np.std([2, 6], ddof=1) / np.sqrt(2))


@pytest.mark.slow
def test_everything_runs_and_a_second_call_learns_nothing(tmp_path, capsys, monkeypatch):
    out = tmp_path / "rows.json"
    arguments = [
        "--smoke", "--json", str(out), "--networks", "published", "--labels", "none",
        "default_and_simulated",
    ]  # fmt: skip
    assert table2_real.main(arguments) == 0
    report = json.loads(out.read_text())
    names = [(row["network"], row["labels"], row["split"]) for row in report["rows"]]
    told = ("none", "default_and_simulated", "tracker")
    assert names == [("published", labels, "choose") for labels in told]
    for row in report["rows"]:
        assert row["pictures"] == 3
        assert all(row[name] is not None for name in ("chamfer_pc_m2", "corner_mm", "edge_strain"))
    assert report["rows"][1]["learned_pictures"] == 12
    assert report["provenance"]["sequences"]["choose"] == ["lift_tan2"]
    assert "| published | default_and_simulated | choose |" in capsys.readouterr().out

    # Measured again by other processes, from the weights and meshes that were kept: the same.
    shutil.rmtree(tmp_path / "rows" / "rows")
    assert table2_real.main([*arguments, "--workers", "2"]) == 0
    assert json.loads(out.read_text())["rows"] == report["rows"]

    monkeypatch.setattr(table2_real, "track", None)
    monkeypatch.setattr(table2_real, "load_model", None)
    for module in (token_learning, training):
        monkeypatch.setattr(module, "train", None)
    assert table2_real.main(arguments) == 0
    assert json.loads(out.read_text())["rows"] == report["rows"]


@pytest.mark.slow
def test_labels_that_teach_nothing_are_a_row_that_says_so(tmp_path):
    out = tmp_path / "rows.json"
    arguments = ["--smoke", "--json", str(out), "--networks", "tokens", "--labels", "open_loop"]
    assert table2_real.main(arguments) == 0
    first, *others = json.loads(out.read_text())["rows"]
    assert "no labeled picture whose mesh lies where" in first["error"]
    assert [row["labels"] for row in others] == ["tracker"]
