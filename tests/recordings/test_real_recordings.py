"""Segmentation and points of real recordings, against the masks that came with them."""

import json

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.segmentation import ColorSegmenter, main_components
from clothtrack.recordings.store import RecordingWriter, read_recording

pytestmark = pytest.mark.data


def camera_of(folder):
    lens = json.loads((folder / "intrinsics.json").read_text())
    size = (lens["width"], lens["height"])
    return Camera("real", *size, *(lens[name] for name in ("fx", "fy", "cx", "cy")))


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


def test_a_printed_cloth_is_followed_by_the_colors_of_its_first_frame(data):
    folder = data / "hanging-cloth-rgbd"
    camera = camera_of(folder)
    first = read_color(folder / "color/000.png")
    segmenter = ColorSegmenter.from_box(first, (130, 140, 295, 298))
    for frame in range(0, 50, 7):
        color = read_color(folder / f"color/{frame:03d}.png")
        depth = read_depth(folder / f"depth/{frame:03d}.png", 0.001)
        truth = main_components(read_mask(folder / f"mask/{frame:03d}.png"), 0.9)
        assert overlap(segmenter(color, depth, camera, None), truth) > 0.95


@pytest.mark.parametrize("way", ["box", "click"])
def test_a_shirt_in_a_cluttered_picture_is_found(data, way):
    folder = data / "tshirt-pair-rgbd"
    color = read_color(folder / "color_000.png")
    depth = read_depth(folder / "depth_000.png", 0.001)
    segmenter = (
        ColorSegmenter.from_box(color, (145, 85, 435, 385))
        if way == "box"
        else ColorSegmenter.from_click(color, 290, 250)
    )
    mask = segmenter(color, depth, camera_of(folder), None)
    assert overlap(mask, read_mask(folder / "mask_000.png")) > 0.96


def test_points_of_the_hanging_cloth_lie_on_the_measured_surface(data, tmp_path):
    folder = data / "hanging-cloth-rgbd"
    with RecordingWriter(tmp_path / "r", [camera_of(folder)], {"real": 0.001}) as writer:
        writer.add_frame(
            0.0,
            color={"real": read_color(folder / "color/000.png")},
            depth={"real": read_depth(folder / "depth/000.png", 0.001)},
            mask={"real": read_mask(folder / "mask/000.png")},
        )
    recording = read_recording(tmp_path / "r")
    seen = observe(recording, recording.frames[0])
    with np.load(folder / "points.npz") as file:
        measured = file["points_mm"][: file["offsets"][1]] / 1000.0
    cells = {tuple(cell) for cell in np.floor(measured / 0.008).astype(int).tolist()}
    near = [
        any((x + i, y + j, z + k) in cells for i in (-1, 0, 1) for j in (-1, 0, 1)
            for k in (-1, 0, 1))
        for x, y, z in np.floor(seen.points / 0.008).astype(int).tolist()
    ]  # fmt: skip
    assert np.mean(near) > 0.99
    assert len(seen.points) > 0.5 * 0.555**2 / 0.004**2
    # Holes of a pixel or two in real depth must not silence the cloth around them.
    mask = main_components(read_mask(folder / "mask/000.png"))
    assert seen.hidden["real"][mask].mean() < 0.15
