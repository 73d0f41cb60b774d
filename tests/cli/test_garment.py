"""`garment` makes a template of a picture, and says in one line where it cannot."""

import json

import cv2
import numpy as np

from clothtrack.cli import command_line as cli
from clothtrack.garments.outlines import ShirtOutline
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.template_file import read_template


def picture(path, *, sixteen=False, hem=1.0):
    """A red shirt of 60 cm on a gray table, 2 mm a pixel; light falls from one side."""
    spans = ShirtOutline().spans(0.6, depth=0.018)
    points = np.concatenate([span.points[:-1] for span in spans])
    points[points[:, 1] < points[:, 1].min() + 0.01, 0] *= hem
    corners = points / 0.002 * (1, -1) + (320, 240)
    light = np.linspace(90, 170, 640)[None, :, None]
    shown = np.broadcast_to(light, (480, 640, 3)).astype(np.uint8).copy()
    cv2.fillPoly(shown, [np.rint(corners).astype(np.int32)], (40, 30, 180))
    cv2.imwrite(str(path), shown[:, :, 0].astype(np.uint16) * 10 if sixteen else shown)
    return path


def test_a_color_picture_becomes_a_template_and_its_outline_is_drawn(tmp_path, capsys):
    shown, output = picture(tmp_path / "flat.png"), tmp_path / "shirt.npz"
    words = ["garment", str(shown), "--kind", "tshirt", "--meters-per-pixel", "0.002"]
    assert cli.main([*words, "--output", str(output), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert abs(report["length_m"] / 0.6 - 1.0) < 0.02
    assert report["neck_seen"]
    assert report["mirrored"]
    mesh = read_template(output)
    assert mesh.vertex_count == report["vertices"]
    assert cv2.imread(report["outline"]).shape[1] == 1200
    as_obj = tmp_path / "shirt.obj"
    assert cli.main([*words, "--output", str(as_obj)]) == 0
    assert np.allclose(read_template(as_obj).canonical, mesh.canonical)


def test_a_hem_that_is_drawn_together_is_not_flat(tmp_path, capsys):
    for hem, warned in ((1.0, False), (0.5, True)):
        shown = picture(tmp_path / "flat.png", hem=hem)
        words = ["garment", str(shown), "--kind", "tshirt", "--meters-per-pixel", "0.002"]
        assert cli.main([*words, "--output", str(tmp_path / "shirt.npz")]) == 0
        told = capsys.readouterr().err
        assert ("does not lie flat" in told) == warned
        assert told.count("\n") == warned


def test_a_recording_becomes_a_template_of_the_size_that_it_states(tmp_path, capsys):
    words = ["garment", str(shipped_recording()), "--kind", "tshirt", "--json"]
    assert cli.main([*words, "--output", str(tmp_path / "shirt.npz")]) == 0
    report = json.loads(capsys.readouterr().out)
    assert abs(report["width_m"] / 0.5 - 1.0) < 0.03
    assert abs(report["length_m"] / 0.45 - 1.0) < 0.03


def test_what_means_nothing_is_refused_in_one_line(tmp_path, capsys):
    shown, output = str(picture(tmp_path / "flat.png")), ["--output", str(tmp_path / "t.npz")]
    recording = str(shipped_recording())
    for words, said in (
        ([shown, "--kind", "tshirt", *output], "--meters-per-pixel"),
        ([recording, "--kind", "tshirt", "--focal", "500", *output], "--focal"),
        ([recording, "--kind", "trousers", *output], "no gap between the legs"),
        ([recording, "--kind", "tshirt", "--openings", "a,b", *output], "COLUMN,ROW"),
        ([recording, "--kind", "tshirt", "--output", str(tmp_path / "t.stl")], ".npz or .obj"),
    ):
        assert cli.main(["garment", *words]) == 1
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    assert not list(tmp_path.glob("t.*"))
