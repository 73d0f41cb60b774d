"""The picker in the pictures: laws of the path, and the simulated camera with a colored tip."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.recording import Table
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack_capture.picker_detection import (
    find_picker,
    keep_picker,
    nearest_visible_vertex,
    tip_members,
)
from clothtrack_capture.picker_motion import (
    closed_by_gap,
    closed_by_rest,
    without_jumps,
)
from clothtrack_capture.tip_finder import learned_finder, tip_colors
from clothtrack_lab.world.appearance import Appearance
from clothtrack_lab.world.scene import Scene
from clothtrack_lab.world.sensor import Sensor, top_down_camera
from clothtrack_lab.world.tool import Tool


def visit(heights):
    """A path over one spot at these heights [m], all of one visit."""
    heights = np.asarray(heights, dtype=float)
    positions = np.stack([np.zeros(len(heights)), np.zeros(len(heights)), heights], axis=1)
    return positions, heights, [np.arange(len(heights))]


UP, DOWN = 0.1, 0.005


@pytest.mark.parametrize(
    ("heights", "spans"),
    [
        # A pick is where the tip comes to rest, a release where it leaves.
        ([UP, 0.05, DOWN, DOWN, DOWN, 0.04, UP, 0.06, DOWN, DOWN, 0.05, UP], [(2, 9)]),
        ([UP, DOWN, 0.06, DOWN, UP, DOWN, 0.06, DOWN, UP], [(1, 3), (5, 7)]),
        # Swings high over the table count for nothing.
        ([0.2, 0.1, 0.2, DOWN, 0.1, 0.06, 0.1, DOWN, 0.2, 0.12, 0.2], [(3, 7)]),
    ],
)
def test_picks_and_releases_are_where_the_tip_rests_low(heights, spans):
    assert closed_by_rest(*visit(heights)) == spans


def test_a_touch_without_a_partner_is_left_out_and_said(caplog):
    assert closed_by_rest(*visit([UP, DOWN, UP, DOWN, UP, DOWN, UP])) == [(1, 3)]
    assert "comes down 3 times" in caplog.text


def test_tweezers_are_closed_where_their_gap_is():
    heights = np.array([UP, 0.03, 0.01, 0.01, 0.05, UP, 0.05, 0.01, 0.01, 0.05, UP])
    gaps = np.array([20, 20, 20, 0, 0, 0, 0, 0, 20, 20, 20]) / 1000.0
    assert closed_by_gap(gaps, heights, [np.arange(11)]) == [(3, 8)]
    blinked = gaps.copy()
    blinked[5] = 0.02
    assert closed_by_gap(blinked, heights, [np.arange(11)]) == [(3, 8)]
    # Closed in the air, or without lifting anything, it holds nothing.
    assert closed_by_gap(gaps, heights + 0.1, [np.arange(11)]) == []
    assert closed_by_gap(gaps, np.full(11, 0.01), [np.arange(11)]) == []


def test_a_single_jump_goes_and_a_fast_path_stays():
    path = np.stack([0.06 * np.arange(8), np.zeros(8), np.zeros(8)], axis=1)
    np.testing.assert_array_equal(without_jumps(path), path)
    jumped = path.copy()
    jumped[4, 1] = 0.5
    kept = without_jumps(jumped)
    assert np.isnan(kept[4]).all()
    np.testing.assert_array_equal(np.delete(kept, 4, 0), np.delete(path, 4, 0))


def test_the_nearest_vertex_in_view_is_picked():
    sheet = np.array([[x, y, z] for z in (0.0, 0.05) for y in (0, 0.1) for x in (0, 0.1)], float)
    cloth = ClothMesh(sheet, np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]]))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0.05, 0.05, 0.6]
    camera = Camera("top", 200, 200, 300.0, 300.0, 99.5, 99.5, pose)
    # Vertex 0 is nearer, but lies right under vertex 4.
    assert nearest_visible_vertex(cloth, np.array([0.0, 0.0, 0.02]), [camera], radius_m=0.04) == 4
    assert nearest_visible_vertex(cloth, np.array([0.0, 0.0, 0.2]), [camera]) is None


def tip_path():
    """Down, rest, over, down, rest and away: frames of a pick-and-place, and when it was closed."""
    corners = np.array(
        [[-0.1, 0.25, 0.15], [-0.08, 0.05, 0.004], [0.0, 0.0, 0.09], [0.1, -0.03, 0.006],
         [0.12, 0.2, 0.15], [0.14, 0.5, 0.36]]
    )  # fmt: skip
    ways = [(0, 1, 2), (1, 1, 2), (1, 2, 4), (2, 3, 4), (3, 3, 2), (3, 4, 2), (4, 5, 4)]
    path, closed = [corners[0]], [False]
    for start, end, frames in ways:
        for step in range(1, frames + 1):
            path.append(corners[start] + step / frames * (corners[end] - corners[start]))
            closed.append((start, end) in {(1, 2), (2, 3)})
    return np.array(path), np.array(closed)


def filmed(folder, kind, tip, cloth_color):
    """A tip with a color over a cloth that lies still, filmed by the simulated camera."""
    cloth = garment(kind, vertex_count=300)
    vertices = cloth.vertices - [0, 0, cloth.vertices[:, 2].min() - 0.002]
    config = SensorConfig()
    camera = top_down_camera(config, np.random.default_rng(4))
    scene = Scene(cloth, Tool(), camera)
    sensor = Sensor(scene, config, Appearance(cloth=cloth_color, tip=tip), seed=1)
    path, closed = tip_path()
    with RecordingWriter(
        folder, [camera], {"top": 0.0005}, table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    ) as writer:
        for number, point in enumerate(path):
            picture = sensor.capture(vertices, point)
            writer.add_frame(
                number / 20.0, color={"top": picture.color}, depth={"top": picture.depth}
            )
    return folder, path, closed, tip


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A pink tip over a purple towel: colors that mix at the towel's edge."""
    return filmed(tmp_path_factory.mktemp("film") / "towel", "towel", "pink", "purple")


@pytest.mark.slow
def test_a_tip_over_a_tshirt_is_found_too(tmp_path):
    test_the_tip_is_found_to_a_few_millimeters_and_the_pick_to_two_frames(
        filmed(tmp_path / "tshirt", "tshirt", "cyan", "blue")
    )


def test_the_tip_is_found_to_a_few_millimeters_and_the_pick_to_two_frames(film):
    folder, path, closed, tip = film
    recording = read_recording(folder)
    found = find_picker(recording, recording.cameras[0], tip_colors(tip), name="hand")
    errors = [
        np.linalg.norm(found.path.position_at(frame.time_s) - path[frame.index])
        for frame in recording.frames
        if found.seen[frame.index]
    ]
    pixels, _ = recording.cameras[0].project(path)
    inside = ((pixels > 0) & (pixels < (639, 479))).all(axis=1)
    assert found.seen[inside].mean() > 0.9
    assert not found.seen[~inside].any()
    assert np.median(errors) < 0.002
    assert np.percentile(errors, 95) < 0.008
    assert found.by == "dwell"
    (pick,), (release,) = found.picks, found.releases
    true_pick, true_release = np.flatnonzero(np.diff(closed.astype(int))) + 1
    # The tip rests for two frames before it moves, closed or not.
    assert true_pick - 4 <= pick <= true_pick + 1
    assert true_release - 1 <= release <= true_release + 4
    assert found.actions[0].last_frame == len(path) - 1


def test_a_click_on_the_tip_does_as_well_as_its_color(film):
    folder, path, _, _ = film
    recording = read_recording(folder)
    camera = recording.cameras[0]
    on_tip = path[1] + 0.01 * Tool().axis
    column, row = camera.project(on_tip[None])[0][0].round().astype(int)
    members = tip_members(recording, camera, (1, int(column), int(row)))
    found = find_picker(recording, camera, members)
    errors = np.linalg.norm(found.path.positions - path[[
        round(time * 20.0) for time in found.path.time_s
    ]], axis=1)  # fmt: skip
    assert np.median(errors) < 0.003
    assert len(found.actions) == 1


def test_what_is_found_becomes_the_recording(film, tmp_path, capsys):
    folder, _, _, tip = film
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    assert cli.main(["find-picker", str(copy), "--tip-color", tip, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    again = read_recording(copy)
    assert [one["last_frame"] for one in told["actions"]] == [again.actions[0].last_frame]
    assert again.actions[0].pickers == ("tip",)
    assert again.provenance["picker_found"]["by"] == "dwell"
    text = (copy / "picker.csv").read_bytes()
    assert cli.main(["find-picker", str(copy), "--tip-color", tip]) == 1
    assert "use --force" in capsys.readouterr().err
    assert (copy / "picker.csv").read_bytes() == text
    assert cli.main(["find-picker", str(copy), "--tip-color", tip, "--force"]) == 0
    assert (copy / "picker.csv").read_bytes() == text


def test_what_cannot_be_found_is_refused(film):
    recording = read_recording(film[0])
    camera = recording.cameras[0]
    with pytest.raises(InvalidRecordingError, match="the tip is seen in"):
        find_picker(recording, camera, tip_colors("green"))
    with pytest.raises(InvalidConfigError, match="covers"):
        find_picker(recording, camera, tip_colors("orange"))
    with pytest.raises(InvalidConfigError, match="known names"):
        tip_colors("mauve")
    with pytest.raises(InvalidRecordingError, match="calibrate-camera first"):
        find_picker(replace(recording, table=None), camera, tip_colors("pink"))
    found = find_picker(recording, camera, tip_colors(film[3]))
    with pytest.raises(InvalidRecordingError, match="never picks and places"):
        keep_picker(recording, replace(found, actions=()), "tip", "pink")
    with pytest.raises(InvalidConfigError, match="there is no color picture of frame 999"):
        tip_members(recording, camera, (999, 1, 1))


def test_two_arms_are_one_tip_between_them_with_a_gap():
    camera = Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5)
    color = np.full((240, 320, 3), (200, 166, 124), np.uint8)
    depth = np.full((240, 320), 0.7)
    for column in (140, 156):
        cv2.line(color, (column, 60), (148 + (column - 148) // 2, 100), (232, 40, 150), 4)
        arm = np.zeros(depth.shape, np.uint8)
        cv2.line(arm, (column, 60), (148 + (column - 148) // 2, 100), 1, 4)
        # From above: 0.56 m at the upper end, 0.6 m at the tip.
        rows, columns = np.nonzero(arm)
        depth[rows, columns] = 0.6 + 0.001 * (rows - 100.0)
    finder = learned_finder([(color, depth)], tip_colors("pink"), camera)
    tip = finder.find(color, depth)
    assert tip.gap_m == pytest.approx(8 * 0.6 / 300.0, abs=0.006)
    np.testing.assert_allclose(tip.pixel, [148.0, 101.0], atol=3.0)
    assert tip.position[2] == pytest.approx(0.6, abs=0.004)
