"""What helps against a doubtful mesh is an option that works, and none that was given."""

import shutil

import cv2
import numpy as np

from clothtrack.cli import command_line as cli
from clothtrack.garments.garment_meshes import garment
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.template_file import write_template


def test_the_advised_command_works_and_advises_something_else(tmp_path, capsys):
    """Half of a shirt is given as a mask, so that the outline is never right."""
    recording = shipped_recording("")
    depth = recording / "depth" / "000042.png"
    half = np.zeros(cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).shape, np.uint8)
    half[:, half.shape[1] // 2 :] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), half)
    write_template(garment("tshirt", vertex_count=300, size_m=(0.3, 0.5)), tmp_path / "t.npz")
    options = {
        "--size": ["0.3", "0.5"],
        "--mask": [str(tmp_path / "mask.png")],
        "--template": [str(tmp_path / "t.npz")],
    }
    shutil.copy(depth, tmp_path / "depth.png")
    words = ["reconstruct", str(tmp_path / "depth.png"), "--garment", "tshirt", "--no-refined",
             "--depth-unit", "0.001", "--output", str(tmp_path / "out.obj"), "--force"]  # fmt: skip
    given = {name: options[name] for name in ("--size", "--mask")}
    for expected in (["--template"], []):
        assert (
            cli.main([*words, *(word for pair in given.items() for word in (pair[0], *pair[1]))])
            == 0
        )
        advice = capsys.readouterr().out.partition("what helps: ")[2]
        advised = [name for name in options if name in advice.partition(" instead of")[0]]
        assert advice
        assert advised == expected
        if "instead of its --size" in advice:
            del given["--size"]
        if expected:
            given[expected[0]] = options[expected[0]]
