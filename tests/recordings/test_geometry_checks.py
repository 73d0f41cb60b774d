"""Wrong geometry is found and named, on a drawn towel that is carried; the right one is not.

The recording is drawn here, without noise: a flat towel on a table, seen by a tilted camera, one
end of which is lifted, carried over the other and laid down.
"""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.table_plane import world_from_table
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.geometry_checks.checks import check_geometry
from clothtrack.recordings.geometry_checks.cloth import mesh_gap_m
from clothtrack.recordings.geometry_checks.finding import ObservedFrames
from clothtrack.recordings.geometry_checks.picker import picker_lag
from clothtrack.recordings.inspection import inspect
from clothtrack.recordings.recorded_table import fit_recorded_table
from clothtrack.recordings.recording import ClothDescription, PickerPath, Table
from clothtrack.recordings.store import RecordingWriter, read_recording

WIDTH_M, LENGTH_M, RATE = 0.24, 0.3, 10.0
COLUMNS, ROWS = 13, 16
TURN = Rotation.from_euler("x", 20.0, degrees=True).as_matrix()
FRAMES = 24
CLOSED, OPEN = 6, 18


def camera():
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ TURN
    pose[:3, 3] = -0.7 * pose[:3, 2]
    return Camera("top", 240, 180, 220.0, 220.0, 119.5, 89.5, pose)


def towel(progress):
    """Flat at 0; at 1 the far end lies 0.1 m nearer, what is between stands up as an arch."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, COLUMNS) * WIDTH_M, np.linspace(0, 1, ROWS))
    moved = np.clip((y - 0.5) / 0.5, 0.0, 1.0)
    height = 0.003 + 0.12 * np.sin(np.pi * progress) * moved**2
    along = LENGTH_M * (y - 0.5) - 0.1 * progress * moved
    vertices = np.stack([x, along, height], axis=-1).reshape(-1, 3)
    corner = np.arange(COLUMNS * ROWS).reshape(ROWS, COLUMNS)
    a, b, c, d = (part.ravel() for part in (
        corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))  # fmt: skip
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return ClothMesh(vertices, faces.astype(np.int32))


def progress_at(frame):
    return np.clip((frame - CLOSED) / (OPEN - CLOSED), 0.0, 1.0)


def tip_at(frame):
    return towel(progress_at(frame)).vertices[-1 - COLUMNS // 2]


@pytest.fixture(scope="module")
def towel_film(tmp_path_factory):
    return drawn(tmp_path_factory.mktemp("film") / "towel", camera())


def hung(vertices, edge_m):
    """What is beyond an edge of the table, towards -y, hangs down from it."""
    beyond = np.maximum(edge_m - vertices[:, 1], 0.0)
    return vertices + beyond[:, None] * (0.0, 1.0, -1.0)


def drawn(folder, eye, edge_m=-9.0):
    ground = np.array([[-9.0, edge_m, 0], [9, edge_m, 0], [9, 9, 0], [-9, 9, 0]])
    plane = Rasterizer(np.array([[0, 1, 2], [0, 2, 3]]), eye)
    floor = np.array([[-9.0, -9, -0.6], [9, -9, -0.6], [9, 9, -0.6], [-9, 9, -0.6]])
    table = np.minimum(plane.render(ground).depth, plane.render(floor).depth)
    draw = Rasterizer(towel(0.0).faces, eye)
    with RecordingWriter(
        folder,
        [eye],
        {"top": 0.0005},
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])),
        cloth=ClothDescription("towel", None, (WIDTH_M, LENGTH_M), towel(0.0)),
    ) as writer:
        for frame in range(FRAMES):
            cloth = draw.render(hung(towel(progress_at(frame)).vertices, edge_m)).depth
            writer.add_frame(
                frame / RATE, color={}, depth={"top": np.minimum(table, cloth)},
                mask={"top": cloth < table}, cloud=None,
            )  # fmt: skip
        number = np.arange(FRAMES)
        tips = np.stack([tip_at(frame) for frame in number])
        writer.set_picker_path(
            "hand", PickerPath(number / RATE, tips, (number >= CLOSED) & (number < OPEN))
        )
        writer.add_action(0, FRAMES - 1, ["hand"])
    return folder


@pytest.fixture(scope="module")
def film(towel_film):
    return read_recording(towel_film)


def with_camera(recording, **changes):
    return replace(recording, cameras=(replace(recording.cameras[0], **changes),))


def posed(recording, change):
    pose = np.array(recording.cameras[0].world_from_camera)
    return with_camera(recording, world_from_camera=change(pose))


def with_cloth(recording, **changes):
    return replace(recording, cloth=replace(recording.cloth, **changes))


def with_path(recording, **changes):
    path = replace(recording.picker_paths["hand"], **changes)
    return replace(recording, picker_paths={"hand": path})


def with_unit(recording, factor):
    return replace(recording, depth_units_m={"top": factor * recording.depth_units_m["top"]})


def lifted(recording, by_m):
    return posed(recording, lambda pose: pose + by_m * np.eye(4)[2][:, None] * np.eye(4)[3])


def turned(recording, degrees):
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    return posed(recording, lambda pose: pose @ turn)


def moved_path(recording, *by_m):
    return with_path(recording, positions=recording.picker_paths["hand"].positions + by_m)


def moved_template(recording, change):
    template = recording.cloth.template
    return with_cloth(recording, template=template.with_vertices(change(template.vertices)))


def late(recording, by_s):
    """A picker whose clock differs, its path going on at rest."""
    path = recording.picker_paths["hand"]
    times = np.array([-9.0, *(path.time_s + by_s), 99.0])
    return with_path(
        recording,
        time_s=times,
        positions=path.positions[[0, *range(FRAMES), -1]],
        closed=np.array([False, *path.closed, False]),
    )


FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
WRONG = {
    "inverted": (lambda r: posed(r, np.linalg.inv), "camera_pose", "inverted"),
    "opengl": (lambda r: posed(r, lambda pose: pose @ FLIP), "camera_pose", "OpenGL"),
    "tilted": (lambda r: turned(r, 4.0), "camera_pose", "4.0 degrees"),
    "lifted": (lambda r: lifted(r, 0.1), "camera_pose", "world_from_camera"),
    "unit * 10": (lambda r: with_unit(r, 10.0), "depth_unit", "0.005 is likely to be 0.0005"),
    "unit / 1000": (lambda r: with_unit(r, 1e-3), "depth_unit", "5e-07 is likely to be 0.0005"),
    "longer": (lambda r: with_cloth(r, size_m=(WIDTH_M, 0.6)), "size", "cloth.size_m"),
    "smaller": (lambda r: with_cloth(r, size_m=(0.2, 0.25)), "size", "fx and fy"),
    "beside": (lambda r: moved_template(r, lambda v: v + (0.5, 0, 0)), "template", "(-0.50 "),
    "a little beside": (lambda r: moved_template(r, lambda v: v + (0.02, 0, 0)), "template",
        "20 mm beside"),
    "larger": (lambda r: moved_template(r, lambda v: 1.4 * v), "template", "cloth.template"),
    "picker": (lambda r: moved_path(r, 0.2, 0.0, 0.0), "picker_path", "x_m, y_m, z_m"),
    "high": (lambda r: moved_path(r, 0.0, 0.0, 0.08), "picker_path", "world of the cameras"),
    "open": (lambda r: with_path(r, closed=np.zeros(FRAMES, bool)), "picker_path", "in no frame"),
    "late": (lambda r: late(r, 0.5), "picker_clock", "subtract 0.50 s"),
    "early": (lambda r: late(r, -0.4), "picker_clock", "add 0.40 s"),
}  # fmt: skip


def test_a_right_recording_is_not_accused(film, towel_film):
    assert check_geometry(film) == ()
    inspection = inspect(towel_film)
    assert inspection.as_dict()["geometry"] == []
    assert "doubtful" not in inspection.text()


@pytest.mark.parametrize("name", WRONG)
def test_wrong_geometry_is_found_and_its_field_named(film, name):
    change, check, words = WRONG[name]
    finding = check_geometry(change(film))[0]
    assert finding.kind == check
    assert words in finding.text
    assert "\n" not in finding.text
    assert finding.measured != finding.limit


def test_a_folded_first_frame_is_smaller_than_its_size(film):
    # At the end of the action one end lies nearer.
    frames = (film.frames[FRAMES - 1],)
    begun_late = replace(film, frames=frames, actions=(), cloth=replace(film.cloth, template=None))
    (finding,) = check_geometry(begun_late)
    assert finding.kind == "size"
    assert "flat" in finding.text


def test_a_pick_beyond_the_rim_of_the_picture_is_not_doubted(tmp_path):
    # The upper third is missing, and with it the end of the towel that is picked.
    folder = drawn(tmp_path / "cut", replace(camera(), height=120, cy=29.5))
    inspection = inspect(folder)
    assert inspection.geometry == ()
    assert "the cloth reaches the rim of the picture in frame 0" in inspection.text()
    inside = moved_path(read_recording(folder), 0.2, -0.2, 0.0)
    assert "picker_path" in [finding.kind for finding in check_geometry(inside)]


def test_what_was_cut_away_accuses_nobody(film):
    observed = replace(film.observed, lowest_height_m=0.05)
    elsewhere = moved_template(replace(film, observed=observed), lambda v: v + (0.05, 0.0, 0.0))
    template = elsewhere.cloth.template
    seen = ObservedFrames(elsewhere).at(0)
    assert mesh_gap_m(template.vertices, template.faces, seen) is None
    assert "template" not in [finding.kind for finding in check_geometry(elsewhere)]


def test_the_lag_is_that_of_the_clock(film):
    lags = [picker_lag(ObservedFrames(late(film, by))).lag_s for by in (0.6, 0.3, 0, -0.5)]
    np.testing.assert_allclose(lags, [-0.6, -0.3, 0.0, 0.5], atol=0.051)
    assert all(a < b for a, b in pairwise(lags))


def test_a_picker_whose_hold_is_named_may_be_beside_the_cloth(film):
    beside = moved_path(film, 0.2, 0.0, 0.0)
    named = with_cloth(beside, held_vertices={"hand": np.array([0])})
    assert check_geometry(named) == ()


def test_a_template_that_no_camera_sees_is_not_where_the_cloth_is(film):
    template, seen = film.cloth.template, ObservedFrames(film).at(0)
    assert mesh_gap_m(template.vertices, template.faces, seen) < 0.003
    behind = template.vertices + (0.0, 0.0, 3.0)
    assert mesh_gap_m(behind, template.faces, seen) > 1.0


def test_inspect_leaves_a_doubtful_recording_valid(towel_film, tmp_path, edit):
    import shutil

    copy = tmp_path / "doubtful"
    shutil.copytree(towel_film, copy)
    edit(copy, lambda document: document["cloth"].update(size_m=[0.24, 0.6]))
    inspection = inspect(copy)
    assert inspection.valid
    assert "a valid recording; its geometry is doubtful in 1 place\n" in inspection.text()
    (found,) = json.loads(json.dumps(inspection.as_dict()))["geometry"]
    assert found["kind"] == "size"
    assert found["field"] == "cloth.size_m"
    assert found["unit"] == "m"
    assert found["measured"] == pytest.approx(LENGTH_M, abs=0.01)
    assert found["limit"] == pytest.approx(0.6)


def unconfirmed(recording, factor=1.0):
    """Depth, world and path in a unit that is wrong by a factor, without size and template."""
    pose = np.array(recording.cameras[0].world_from_camera)
    pose[:3, 3] *= factor
    path = recording.picker_paths["hand"].positions
    smaller = with_path(with_unit(recording, factor), positions=factor * path)
    return with_cloth(with_camera(smaller, world_from_camera=pose), size_m=None, template=None)


def test_a_scale_that_nothing_confirms_is_a_usual_one(film):
    assert check_geometry(unconfirmed(film)) == ()
    for factor, shown in (
        (0.25, "side is 0.07"),
        (4.0, "camera is 2.6 m above"),
        (0.1, "side is 0.0"),
    ):
        found = check_geometry(unconfirmed(film, factor))
        assert [each.kind for each in found] == ["scale"]
        assert shown in found[0].text
        assert "depth_unit_m" in found[0].text
    # With a size, or a pose that is not from the depth, the unit itself is named.
    stated = with_cloth(unconfirmed(film, 0.25), size_m=(WIDTH_M, LENGTH_M))
    for wrong in (stated, with_unit(film, 0.25), with_unit(film, 4.0)):
        (found,) = check_geometry(wrong)
        assert found.kind == "depth_unit"
        assert found.text.endswith("is likely to be 0.0005")
    # What a ruler measures confirms a doll's towel.
    size = (0.3 * WIDTH_M, 0.3 * LENGTH_M)
    assert check_geometry(with_cloth(unconfirmed(film, 0.3), size_m=size)) == ()


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_lens_of_another_picture_size_is_found_without_a_size(film, factor):
    eye = film.cameras[0]
    eye = replace(eye, fx=factor * eye.fx, fy=factor * eye.fy)
    wrong = with_cloth(replace(film, cameras=(eye,)), size_m=None, template=None)
    # The pose is that of the depth with this lens, as calibrate-camera makes it.
    fitted = world_from_table(eye, fit_recorded_table(wrong, eye))
    found = check_geometry(with_camera(wrong, world_from_camera=fitted))
    assert [(each.kind, each.field) for each in found] == [("scale", "cameras[0].fx, fy")]


def test_a_towel_is_no_shirt(film):
    shirt = garment("tshirt", vertex_count=300, size_m=(WIDTH_M, LENGTH_M))
    laid = shirt.with_vertices(shirt.vertices - shirt.vertices.mean(axis=0) + (0, 0, 0.003))
    alone = {"kind": "tshirt", "template": None}
    for cloth, kind in (
        (alone, "garment_kind"),
        (alone | {"size_m": None}, "garment_kind"),
        ({"kind": "tshirt", "template": laid}, "template"),
    ):
        assert kind in [each.kind for each in check_geometry(with_cloth(film, **cloth))]


def test_cloth_over_the_edge_of_the_table_is_found(tmp_path):
    beside = read_recording(drawn(tmp_path / "beside", camera(), edge_m=-0.19))
    assert check_geometry(beside) == ()
    over = read_recording(drawn(tmp_path / "over", camera(), edge_m=-0.11))
    (found,) = check_geometry(with_cloth(over, size_m=None, template=None))
    assert (found.kind, found.field) == ("cloth_over_edge", "frames[0]")
    assert found.measured == pytest.approx(WIDTH_M, abs=0.05)
