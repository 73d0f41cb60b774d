"""Every way in which a recording can be wrong gives one clear message."""

import json
import re
import shutil

import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.validation import check_recording


def replace_text(name, old, new):
    def change(folder):
        path = folder / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return change


def rewrite_depth(change):
    def rewrite(folder):
        path = folder / "depth/000000.png"
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert cv2.imwrite(str(path), change(picture))

    return rewrite


def truncate(folder):
    path = folder / "depth/000000.png"
    path.write_bytes(path.read_bytes()[:-200])


def black_mask(folder):
    assert cv2.imwrite(str(folder / "mask/000003.png"), np.zeros((48, 64), np.uint8))


FILES = {
    "missing": (
        lambda folder: (folder / "depth/000001.png").unlink(),
        ["depth/000001.png", "missing", "add the file"],
    ),
    "truncated": (truncate, ["depth/000000.png", "breaks off", "copy or record it again"]),
    "not a picture": (
        lambda folder: (folder / "color/000004.png").write_text("hello"),
        ["color/000004.png", "not a PNG"],
    ),
    "8-bit depth": (
        rewrite_depth(lambda depth: (depth // 4).astype(np.uint8)),
        ["depth/000000.png", "bits is 8", "write depth as one 16-bit gray channel"],
    ),
    "picture size": (
        rewrite_depth(lambda depth: depth[:40]),
        ["depth/000000.png", "size is 64 x 40", "camera 'top' has 64 x 48", "correct width"],
    ),
    "empty depth": (
        rewrite_depth(lambda depth: depth * 0),
        ["depth/000000.png", "0 everywhere", "nothing was measured"],
    ),
    "empty mask": (black_mask, ["mask/000003.png", "empty", "paint the cloth white"]),
    "broken JSON": (
        replace_text("recording.json", '"version"', '"version'),
        ["recording.json", "line 2", "broken JSON", "correct the JSON"],
    ),
    "not a number": (
        replace_text("recording.json", "31.5", "NaN"),
        ["recording.json", "NaN stands where a number belongs"],
    ),
    "too large a number": (
        replace_text("recording.json", "31.5", "1e999"),
        ["recording.json", "1e999 is too large"],
    ),
    "field twice": (
        replace_text("recording.json", '"width": 64', '"width": 64, "width": 65'),
        ["recording.json", "'width' stands twice"],
    ),
    "no document": (
        lambda folder: (folder / "recording.json").unlink(),
        ["recording.json", "missing", "docs/data_format.md"],
    ),
    "text in a CSV number": (
        replace_text("picker.csv", "0.1,0.0,0.3", "0.1,zero,0.3"),
        ["picker.csv", "line 4", "y_m is 'zero'", "write a number"],
    ),
    "picker beyond all numbers": (
        replace_text("picker.csv", "0.1,0.0,0.3", "0.1,1e200,0.3"),
        ["picker.csv", "(0.1, 1e+200, 0.3)", "inf m from the nearest camera", "write meters"],
    ),
    "picker in millimeters": (
        replace_text("picker.csv", "0.1,0.0,0.3", "100,0,30000"),
        ["picker.csv", "x_m, y_m, z_m of picker 'arm' at", "(100, 0, 30000)", "write meters"],
    ),
    "CSV head": (
        replace_text("picker.csv", "x_m", "x_mm"),
        ["picker.csv", "first line", "time_s,picker,x_m,y_m,z_m,closed"],
    ),
    "CSV fields": (
        replace_text("picker.csv", ",0.3,", ",0.3"),
        ["picker.csv", "line 4 has 5 fields"],
    ),
    "closed": (
        replace_text("picker.csv", "0.3,0", "0.3,open"),
        ["picker.csv", "line 4", "closed is 'open'", "write 1 or 0"],
    ),
    "times that turn back": (
        replace_text("picker.csv", "2.0,arm", "0.5,arm"),
        ["picker.csv", "line 4", "time_s of picker 'arm' is 0.5", "sort the rows"],
    ),
    "path shorter than the action": (
        replace_text("picker.csv", "2.0,arm", "1.7,arm"),
        ["picker.csv", "time_s of picker 'arm' is 0 to 1.7", "1 to 2 s", "record the whole path"],
    ),
    "template with NaN": (
        replace_text("template.obj", "v 0.1 0.0 0.1", "v nan 0.0 0.1"),
        ["template.obj", "vertex 1 is [nan", "not finite", "re-export"],
    ),
    "duplicate vertices": (
        replace_text("template.obj", "v 0.1 0.0 0.1", "v 0.0 0.0 0.1"),
        ["template.obj", "edge [0, 1]", "duplicate vertices", "merge them"],
    ),
    "non-manifold": (
        replace_text("template.obj", "f 1 3 4", "f 1 3 4\nv 0.3 0 0\nf 1 3 5"),
        ["template.obj", "edge [0, 2] belongs to 3 triangles", "split the mesh"],
    ),
    "OBJ text": (
        replace_text("template.obj", "v 0.1 0.0 0.1", "v 0.1 0,0 0.1"),
        ["template.obj", "line 2", "re-export"],
    ),
    "canonical count": (
        lambda folder: (folder / "template_canonical.csv").write_text("x_m,y_m,z_m\n0,0,0\n"),
        ["template_canonical.csv", "1 canonical coordinates for 4 vertices", "one row per vertex"],
    ),
    "canonical text": (
        lambda folder: (folder / "template_canonical.csv").write_text("x_m,y_m,z_m\n0,a,0\n"),
        ["template_canonical.csv", "line 2", "write meters"],
    ),
}


def camera_field(name, value):
    return lambda document: document["cameras"][0].__setitem__(name, value)


def set_pose(document):
    document["cameras"][0]["world_from_camera"][0][0] = 1.1


def several(*changes):
    return lambda document: [change(document) for change in changes]


DOCUMENT = {
    "unit": (
        camera_field("depth_unit_m", 1),
        ["depth/000000.png", "median depth is 500 m", "depth_unit_m = 1", "0.001 for millimeters"],
    ),
    "unit of tenths": (
        camera_field("depth_unit_m", 1e-5),
        ["depth/000000.png", "median depth is 0.005 m", "correct depth_unit_m"],
    ),
    "no unit": (
        lambda document: document["cameras"][0].pop("depth_unit_m"),
        ["recording.json", "cameras[0].depth_unit_m", "missing", "0.001"],
    ),
    "cx outside": (
        camera_field("cx", 130.0),
        ["recording.json", "cameras[0]", "cx is 130.0", "beside the image", "(-64 to 128)"],
    ),
    "cx and cy swapped": (
        several(camera_field("cx", 23.5), camera_field("cy", 31.5)),
        ["recording.json", "cameras[0].cx, cy is (23.5, 31.5)", "swap them"],
    ),
    "focal length of another size": (
        several(camera_field("fx", 6.0), camera_field("fy", 6.0)),
        ["recording.json", "cameras[0].fx is 6", "implausible for a width of 64", "pixels"],
    ),
    "oblong pixels": (
        camera_field("fx", 90.0),
        ["recording.json", "cameras[0].fx / fy is 1.5", "nearly square"],
    ),
    "pose": (set_pose, ["recording.json", "cameras[0]", "not rigid", "write a rotation"]),
    "future": (
        lambda document: document.update(version=2),
        ["recording.json", "version is 2", "newer clothtrack", "upgrade"],
    ),
    "unknown field": (
        lambda document: document.update(camera=[]),
        ["recording.json", "camera is []", "unknown field", "did you mean 'cameras'?"],
    ),
    "missing field": (
        lambda document: document["cameras"][0].pop("fx"),
        ["recording.json", "cameras[0].fx", "missing", "add it"],
    ),
    "wrong kind": (
        camera_field("fx", "60"),
        ["recording.json", 'cameras[0].fx is "60"', "write a JSON number"],
    ),
    "unknown picker": (
        lambda document: document["actions"][0].update(pickers=["hand"]),
        ["recording.json", 'actions[0].pickers is "hand"', "no such picker", "arm"],
    ),
    "action out of range": (
        lambda document: document["actions"][1].update(last_frame=5),
        ["recording.json", "actions[1].last_frame is 5", "the last frame is 4"],
    ),
    "actions overlap": (
        lambda document: document["actions"][1].update(first_frame=1),
        ["recording.json", "actions[1].first_frame is 1", "overlaps", "ends at frame 2"],
    ),
    "action of no time": (
        lambda document: document["actions"][1].update(last_frame=2),
        ["recording.json", "actions[1].last_frame is 2", "at least two frames"],
    ),
    "held vertex": (
        lambda document: document["cloth"].update(held_vertices={"arm": [4]}),
        ["recording.json", "cloth.held_vertices.arm is [4]", "(0 to 3)", "counted from 0"],
    ),
    "held by nobody": (
        lambda document: document["cloth"].update(held_vertices={"hand": [0]}),
        ["recording.json", "cloth.held_vertices.hand", "no such picker", "picker.csv"],
    ),
    "held without template": (
        lambda document: document["cloth"].update(template=None, template_canonical=None),
        ["recording.json", "cloth.held_vertices.arm", "no template", "add cloth.template"],
    ),
    "color name": (
        lambda document: document["cloth"].update(color="bleu"),
        ["recording.json", 'cloth.color is "bleu"', "unknown color name", "blue"],
    ),
    "cloth kind": (
        lambda document: document["cloth"].update(kind="sock"),
        ["recording.json", 'cloth.kind is "sock"', "towel"],
    ),
    "path that leads out": (
        lambda document: document["frames"][2].update(depth="../depth/000002.png"),
        ["recording.json", "frames[2].depth", "leads out", "inside"],
    ),
    "absolute path": (
        lambda document: document["cloth"].update(template="/etc/passwd"),
        ["recording.json", 'cloth.template is "/etc/passwd"', "leads out"],
    ),
    "unknown camera": (
        lambda document: document["frames"][2].update(color={"side": "color/000002.png"}),
        ["recording.json", 'frames[2].color is "side"', "no such camera", "top"],
    ),
    "time": (
        lambda document: document["frames"][2].update(time_s=0.5),
        ["recording.json", "frames[2].time_s is 0.5", "not after", "sort the frames"],
    ),
    "index": (
        lambda document: document["frames"][2].update(index=7),
        ["recording.json", "frames[2].index is 7", "at place 2"],
    ),
    "frame of nothing": (
        lambda document: document["frames"][2].pop("depth"),
        ["recording.json", "frames[2]", "neither depth nor a cloud"],
    ),
    "table upside down": (
        lambda document: document["table"].update(normal=[0, 0, -1]),
        ["recording.json", "table.normal is [0, 0, -1]", "points down", "turn it around"],
    ),
    "table normal": (
        lambda document: document["table"].update(normal=[0, 0, 2]),
        ["recording.json", "table.normal", "its length is 2", "divide"],
    ),
}


def assert_refused(folder, words):
    violations = check_recording(folder).violations
    assert len(violations) == 1
    for word in words:
        assert word in violations[0].message
    assert violations[0].remedy
    with pytest.raises(InvalidRecordingError) as refused:
        read_recording(folder)
    assert violations[0].message in str(refused.value)


@pytest.mark.parametrize("case", FILES)
def test_a_broken_file_is_named_with_its_remedy(case, write, tmp_path):
    change, words = FILES[case]
    write(tmp_path / "recording")
    change(tmp_path / "recording")
    assert_refused(tmp_path / "recording", words)


@pytest.mark.parametrize("case", DOCUMENT)
def test_a_wrong_field_is_named_with_its_value_and_remedy(case, write, edit, tmp_path):
    change, words = DOCUMENT[case]
    write(tmp_path / "recording")
    edit(tmp_path / "recording", change)
    assert_refused(tmp_path / "recording", words)


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y"])
def test_a_world_with_another_axis_up_is_told_how_to_turn(up, write, edit, tmp_path):
    folder = tmp_path / "recording"
    write(folder)
    normal = np.array([0.01, 0.01, 0.02])
    normal["xy".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    normal /= np.linalg.norm(normal)
    edit(folder, lambda document: document["table"].update(normal=normal.tolist()))
    (violation,) = check_recording(folder).violations
    assert f"the world has {up} up" in violation.problem
    written = re.search(r"write \((.*)\) for \(x, y, z\)", violation.remedy)[1].split(", ")
    signs = [-1.0 if word.startswith("-") else 1.0 for word in written]
    turn = np.eye(3)[["xyz".index(word[-1]) for word in written]] * np.array(signs)[:, None]
    assert np.linalg.det(turn) == pytest.approx(1)
    assert (turn @ normal)[2] > 0.99


def test_every_violation_is_found_and_counted(write, edit, tmp_path):
    folder = tmp_path / "recording"
    write(folder)
    edit(folder, lambda document: document["cloth"].update(color="bleu"))
    (folder / "depth/000001.png").unlink()
    (folder / "color/000002.png").unlink()
    assert len(check_recording(folder).violations) == 3
    with pytest.raises(InvalidRecordingError, match="and 2 more"):
        read_recording(folder)


def test_every_missing_and_every_unknown_field_is_named(write, edit, tmp_path):
    folder = tmp_path / "recording"
    write(folder)
    edit(folder, several(*(lambda document, name=name: document["cameras"][0].pop(name)
                           for name in ("fx", "cy")), camera_field("focal", 60.0),
                         camera_field("width_px", 64)))  # fmt: skip
    fields = {violation.field for violation in check_recording(folder).violations}
    assert fields == {f"cameras[0].{name}" for name in ("fx", "cy", "focal", "width_px")}


def test_a_picture_damaged_in_the_middle_is_found_when_all_are_decoded(write, tmp_path):
    folder = tmp_path / "recording"
    write(folder)
    path = folder / "depth/000003.png"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(bytes(content))
    (violation,) = check_recording(folder, thorough=True).violations
    assert violation.file == "depth/000003.png"
    assert "damaged" in violation.problem


def test_a_link_out_of_the_folder_is_refused(write, edit, tmp_path):
    folder = tmp_path / "recording"
    write(folder)
    shutil.copy(folder / "depth/000001.png", tmp_path / "outside.png")
    (folder / "depth/000001.png").unlink()
    (folder / "depth/000001.png").symlink_to(tmp_path / "outside.png")
    assert_refused(folder, ["frames[1].depth", "leads out"])


def test_a_picker_file_out_of_the_folder_is_refused_and_not_shown(write, tmp_path):
    folder = tmp_path / "recording"
    write(folder)
    (tmp_path / "secret").write_text("root:x:0:0\n")
    (folder / "picker.csv").unlink()
    (folder / "picker.csv").symlink_to(tmp_path / "secret")
    assert_refused(folder, ["picker.csv", "leads out"])
    assert not any("root" in one.message for one in check_recording(folder).violations)


def test_pictures_found_by_their_names_stay_inside_too(tmp_path):
    folder = tmp_path / "by_hand"
    folder.mkdir()
    test_a_recording_written_by_hand_needs_little(folder)
    (folder / "depth").rename(tmp_path / "elsewhere")
    (folder / "depth").symlink_to(tmp_path / "elsewhere")
    first = check_recording(folder).violations[0].message
    assert "frames[0].depth" in first
    assert "leads out" in first


def test_a_folder_of_recordings_is_told_from_a_recording(write, tmp_path):
    write(tmp_path / "fold")
    with pytest.raises(InvalidRecordingError, match="such as fold"):
        read_recording(tmp_path)
    with pytest.raises(InvalidRecordingError, match="not a folder"):
        read_recording(tmp_path / "nowhere")


@pytest.mark.parametrize("text", ["[" * 100_000, '["half a character: \\ud800"]'])
def test_deep_nesting_and_half_characters_are_errors_and_no_crash(tmp_path, text):
    (tmp_path / "recording.json").write_text(text)
    (violation,) = check_recording(tmp_path).violations
    assert violation.message.endswith("correct the JSON")


def test_a_recording_written_by_hand_needs_little(tmp_path):
    (tmp_path / "depth").mkdir()
    for frame in range(2):
        depth = np.full((48, 64), 500, np.uint16)
        assert cv2.imwrite(str(tmp_path / f"depth/{frame:06d}.png"), depth)
    lens = {"width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5}
    document = {
        "version": 1,
        "cameras": [{"name": "a", "depth_unit_m": 0.001, **lens}],
        "frames": [{"time_s": 0}, {"time_s": 0.1}],
    }
    (tmp_path / "recording.json").write_text(json.dumps(document))
    recording = read_recording(tmp_path)
    assert recording.frames[1].depth["a"] == tmp_path.resolve() / "depth/000001.png"
    assert recording.table is None
    np.testing.assert_array_equal(recording.cameras[0].world_from_camera, np.eye(4))


def test_a_folder_of_pictures_by_convention_must_be_complete(tmp_path):
    test_a_recording_written_by_hand_needs_little(tmp_path)
    (tmp_path / "depth/000001.png").unlink()
    assert_refused(tmp_path, ["depth/000001.png", "missing"])
