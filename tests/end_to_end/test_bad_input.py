"""Whatever is wrong with the input: one clear line, exit code 1, nothing half-written."""

import json
import shutil

import cv2
import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording

# What is tracked does not matter here: long substeps and few iterations.
FAST = (
    "--set", "search.method=none", "--set", "cloth.substep_s=3.3e-3",
    "--set", "objective.iterations=20",
)  # fmt: skip


def document(folder, change):
    path = folder / "recording.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def missing_picture(folder):
    (folder / "depth/000003.png").unlink()


def truncated_picture(folder):
    path = folder / "depth/000000.png"
    path.write_bytes(path.read_bytes()[:-100])


def shallow_depth(folder):
    path = folder / "depth/000000.png"
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), (depth // 8).astype(np.uint8))


def wrong_unit(folder):
    document(folder, lambda content: content["cameras"][0].update(depth_unit_m=1.0))


def swapped(*pairs):
    def change(folder):
        def swap(content):
            camera = content["cameras"][0]
            for one, other in pairs:
                camera[one], camera[other] = camera[other], camera[one]

        document(folder, swap)

    return change


def picker_outside_the_frames(folder):
    path = folder / "picker.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:5]) + "\n")


def empty_mask(folder):
    (folder / "mask").mkdir()

    def add(content):
        for frame in content["frames"]:
            name = f"mask/{frame['index']:06d}.png"
            shape = (content["cameras"][0]["height"], content["cameras"][0]["width"])
            cv2.imwrite(str(folder / name), np.zeros(shape, np.uint8))
            frame["mask"] = name

    document(folder, add)


def template_line(number, text):
    def change(folder):
        path = folder / "template.obj"
        lines = path.read_text().splitlines()
        lines[number] = text
        path.write_text("\n".join(lines) + "\n")

    return change


def doubled_part(folder):
    """The same part of the cloth twice: every edge of it has too many triangles."""
    path = folder / "template.obj"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, *[line for line in lines if line.startswith("f ")]]) + "\n")


def third_triangle(folder):
    path = folder / "template.obj"
    text = path.read_text()
    count = sum(line.startswith("v ") for line in text.splitlines())
    a, b, _ = next(line for line in text.splitlines() if line.startswith("f ")).split()[1:]
    c = int(b) + 2 if int(b) + 2 <= count else 1
    path.write_text(f"{text}v 0 0 0.5\nf {a} {b} {count + 1}\nf {a} {b} {c}\n")
    canonical = folder / "template_canonical.csv"
    canonical.write_text(canonical.read_text() + "0,0,0.5\n")


def stretched_extrinsics(folder):
    def stretch(content):
        content["cameras"][0]["world_from_camera"][0][0] *= 1.2

    document(folder, stretch)


def from_the_future(folder):
    document(folder, lambda content: content.update(version=99))


CASES = {
    "missing PNG": (missing_picture, ["depth/000003.png", "missing", "add the file"]),
    "truncated PNG": (truncated_picture, ["depth/000000.png", "breaks off", "copy or record"]),
    "8-bit depth": (shallow_depth, ["depth/000000.png", "bits is 8", "16-bit"]),
    "wrong unit": (wrong_unit, ["recording.json", "depth_unit_m", "1", "0.001"]),
    "swapped center": (
        swapped(("cx", "cy")),
        ["recording.json", "cameras[0].cx, cy", "(59.5, 79.5)", "swap them"],
    ),
    "swapped focal length and center": (
        swapped(("fx", "cx"), ("fy", "cy")),
        [
            "recording.json",
            "cameras[0].cx, cy",
            "(150, 150)",
            "far from the middle",
            "fx, fy and cx, cy swapped?",
        ],
    ),
    "picker outside": (picker_outside_the_frames, ["picker.csv", "time_s", "record the whole"]),
    "empty mask": (empty_mask, ["mask/000000.png", "empty", "paint the cloth white"]),
    "NaN": (template_line(3, "v nan 0 0"), ["template.obj", "vertex 3", "nan", "re-export"]),
    "duplicate part": (doubled_part, ["template.obj", "edge", "drop the duplicate faces"]),
    "non-manifold": (third_triangle, ["template.obj", "edge", "3 triangles", "split the mesh"]),
    "non-rigid": (stretched_extrinsics, ["recording.json", "world_from_camera", "rotation"]),
    "future": (from_the_future, ["recording.json", "version", "99", "upgrade"]),
}


@pytest.fixture(params=CASES)
def broken(request, towels, tmp_path):
    """A recording with one thing wrong, and the words that must be said about it."""
    change, words = CASES[request.param]
    folder = tmp_path / "recordings" / "broken"
    shutil.copytree(towels / "recordings" / "towel_0001", folder)
    change(folder)
    return folder, words


def test_track_says_it_in_one_line_and_leaves_nothing(broken, tmp_path, capsys):
    folder, words = broken
    out = tmp_path / "out"
    assert cli.main(["track", str(folder), "--output", str(out)]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert shown.err.startswith(f"clothtrack: {folder}: ")
    assert "Traceback" not in shown.err
    for word in words:
        assert word in shown.err
    assert list(out.iterdir()) == []


def test_a_frame_without_cloth_in_the_middle_is_named(towels, tmp_path, capsys):
    folder = tmp_path / "broken"
    shutil.copytree(towels / "recordings" / "towel_0001", folder)
    for name in ("color", "depth"):
        picture = cv2.imread(str(folder / name / "000005.png"), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(folder / name / "000005.png"), np.full_like(picture, picture.max()))
    words = ["--output", str(tmp_path / "out"), *FAST]
    assert cli.main(["track", str(folder), *words]) == 1
    told = capsys.readouterr().err
    assert "no cloth is found in frame 5" in told
    assert told.count("\n") == 1
    assert list((tmp_path / "out").iterdir()) == []


def set_forward(source, folder, at, by_s):
    """Copy a recording whose clock jumps at a frame, in frames and picker alike."""
    shutil.copytree(source, folder)
    start_s = read_recording(folder).frames[at].time_s

    def later(content):
        for frame in content["frames"][at:]:
            frame["time_s"] += by_s

    document(folder, later)
    head, *rows = (folder / "picker.csv").read_text().splitlines()
    for place, row in enumerate(rows):
        time, rest = row.split(",", 1)
        if float(time) >= start_s - 1e-9:
            rows[place] = f"{float(time) + by_s!r},{rest}"
    (folder / "picker.csv").write_text("\n".join([head, *rows]) + "\n")


def test_a_day_without_a_frame_is_not_simulated(tmp_path, capsys):
    set_forward(shipped_recording(""), tmp_path / "held", 8, 86400.0)
    words = ["track", str(tmp_path / "held"), "--output", str(tmp_path / "out")]
    assert cli.main([*words, "--force"]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    for word in ("/held: ", "'gripper'", "86400.1 s", "frames 7 and 8 of action 1", "at most 10",
                 "subtract 86400 from", "leave the action out"):  # fmt: skip
        assert word in told
    # The advice: subtract what is said.
    set_forward(tmp_path / "held", tmp_path / "right", 8, -86400.0)
    assert cli.main(["inspect", str(tmp_path / "right")]) == 0
    assert "time_s steps" not in capsys.readouterr().out


def test_a_pause_in_which_nothing_holds_the_cloth_is_cut(towels, tmp_path):
    source = towels / "recordings" / "towel_0001"
    last = read_recording(source).actions[-1].last_frame
    set_forward(source, tmp_path / "pause", last, 86400.0)
    words = ["--output", str(tmp_path / "out"), *FAST]
    assert cli.main(["track", str(tmp_path / "pause"), *words]) == 0


def test_a_recording_after_which_no_result_can_be_named(tmp_path, capsys):
    (tmp_path / "a\nb").mkdir()
    words = ["track", str(tmp_path / "a\nb"), "--output", str(tmp_path / "out")]
    assert cli.main(words) == 1
    told = capsys.readouterr().err
    assert "control character" in told
    assert told.count("\n") == 1
