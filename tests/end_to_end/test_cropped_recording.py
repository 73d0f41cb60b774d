"""A film whose pictures were cut so that the principal point lies outside tracks as the whole."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

import clothtrack as ct
from clothtrack.geometry.visibility import Rasterizer

LEFT, WIDTH = 320, 200
"""The part of the columns that is kept; the principal point is in column 179.5 of the whole."""


@pytest.fixture(scope="module")
def whole(napkin, tmp_path_factory):
    """The napkin, drawn without noise before a camera that stands aside and has a wide picture."""
    source = ct.read_recording(napkin)
    truth = ct.Truth.load(napkin.parents[1] / "truth" / f"{napkin.name}.npz")
    pose = source.cameras[0].world_from_camera + np.outer([1, 0, 0, 0], [0, 0, 0, -0.45])
    camera = replace(
        source.cameras[0], width=560, height=240, fx=400.0, fy=400.0, cx=179.5, cy=119.5,
        world_from_camera=pose,
    )  # fmt: skip
    ground = np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])
    table = Rasterizer(np.array([[0, 1, 2], [0, 2, 3]]), camera).render(ground).depth
    draw = Rasterizer(truth.faces, camera)
    folder = tmp_path_factory.mktemp("films") / "whole"
    with ct.RecordingWriter(
        folder, [camera], {"top": 0.0001}, table=source.table, cloth=source.cloth
    ) as writer:
        for frame, vertices in zip(source.frames, truth.positions, strict=True):
            cloth = draw.render(vertices).depth
            writer.add_frame(
                frame.time_s,
                depth={"top": np.minimum(table, cloth)},
                mask={"top": cloth < table},
            )
        for action in source.actions:
            writer.add_action(action.first_frame, action.last_frame, action.pickers)
        for name, path in source.picker_paths.items():
            writer.set_picker_path(name, path)
    return ct.read_recording(folder)


@pytest.fixture(scope="module")
def cropped(whole):
    """The same film, cut."""
    folder = whole.folder.with_name("cropped")
    for kind in ("depth", "mask"):
        (folder / kind).mkdir(parents=True)
        for file in (whole.folder / kind).iterdir():
            picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            cut_off = np.delete(picture, np.s_[LEFT : LEFT + WIDTH], axis=1)
            assert kind == "depth" or not cut_off.any(), "the part must hold the cloth"
            cv2.imwrite(str(folder / kind / file.name), picture[:, LEFT : LEFT + WIDTH])
    for file in whole.folder.iterdir():
        if file.is_file():
            (folder / file.name).write_bytes(file.read_bytes())
    document = json.loads((folder / "recording.json").read_text())
    document["cameras"][0]["width"] = WIDTH
    document["cameras"][0]["cx"] -= LEFT
    (folder / "recording.json").write_text(json.dumps(document))
    return ct.read_recording(folder)


def test_every_point_is_where_it_was(whole, cropped):
    assert cropped.cameras[0].cx < 0
    for frame, same in zip(whole.frames, cropped.frames, strict=True):
        np.testing.assert_allclose(
            ct.observe(cropped, same).points, ct.observe(whole, frame).points, atol=1e-9
        )
    assert ct.inspect_recording(cropped.folder).geometry == (
        ct.inspect_recording(whole.folder).geometry
    )


@pytest.mark.slow
def test_it_tracks_as_before(whole, cropped):
    runs = [ct.track(one) for one in (whole, cropped)]
    apart_m = np.linalg.norm(runs[0].positions - runs[1].positions, axis=-1)
    assert apart_m.mean() < 0.002
    assert runs[0].verdict.word == runs[1].verdict.word
