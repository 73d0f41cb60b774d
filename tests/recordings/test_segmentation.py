"""Synthetic scenes whose true mask is known."""

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.colors import NAMED_COLORS, NO, named_set, votes_of
from clothtrack.recordings.pictures import encode_png
from clothtrack.recordings.recording import Frame, Table
from clothtrack.recordings.segmentation import (
    ColorSegmenter,
    HeightSegmenter,
    MaskFolder,
    default_segmenter,
    height_picture,
    main_components,
)

HEIGHT, WIDTH = 120, 160
POSE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]])
CAMERA = Camera("top", WIDTH, HEIGHT, 150.0, 150.0, 79.5, 59.5, POSE)
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
WOOD = (170, 130, 90)
TRUE = np.zeros((HEIGHT, WIDTH), dtype=bool)
TRUE[30:95, 40:120] = True


def scene(cloth=(30, 60, 190), ground=WOOD, height_m=0.01, noise=6.0):
    rng = np.random.default_rng(0)
    color = np.empty((HEIGHT, WIDTH, 3))
    color[:] = ground
    color[TRUE] = cloth
    color *= np.linspace(0.85, 1.1, WIDTH)[None, :, None]  # light from the right
    color = np.clip(color + rng.normal(scale=noise, size=color.shape), 0, 255)
    depth = np.where(TRUE, 0.6 - height_m, 0.6)
    return color.astype(np.uint8), depth


def overlap(mask, truth=TRUE):
    return (mask & truth).sum() / (mask | truth).sum()


@pytest.mark.parametrize(
    ("name", "cloth", "ground"),
    [
        ("blue", (30, 60, 190), WOOD),
        ("red", (200, 40, 40), WOOD),
        ("green", (60, 170, 80), WOOD),
        ("pink", (230, 120, 170), WOOD),
        ("yellow", (220, 200, 60), (60, 60, 70)),
        ("white", (225, 225, 220), WOOD),
        ("black", (25, 25, 28), WOOD),
        ("grey", (120, 122, 125), WOOD),
    ],
)
def test_a_named_color_is_found(name, cloth, ground):
    color, depth = scene(cloth, ground)
    segmenter = ColorSegmenter.from_name(name)
    assert overlap(segmenter(color, depth, CAMERA, TABLE)) > 0.97
    assert overlap(segmenter(color, depth, CAMERA, None)) > 0.97


@pytest.mark.parametrize("cloth", [(30, 60, 190), (225, 225, 220), (90, 80, 60)])
def test_box_and_click_learn_the_cloth(cloth):
    color, depth = scene(cloth)
    for segmenter in (
        ColorSegmenter.from_box(color, (32, 22, 128, 103)),
        ColorSegmenter.from_click(color, 80, 60),
    ):
        assert overlap(segmenter(color, depth, CAMERA, None)) > 0.97


def test_a_learned_cloth_is_found_elsewhere():
    color, depth = scene()
    segmenter = ColorSegmenter.from_click(color, 80, 60)
    moved = np.roll(color, 25, axis=1)
    mask = segmenter(moved, np.roll(depth, 25, axis=1), CAMERA, None)
    assert overlap(mask, np.roll(TRUE, 25, axis=1)) > 0.97


def test_height_decides_where_cloth_and_table_have_one_color():
    color, depth = scene((225, 225, 220), (235, 235, 235), height_m=0.012)
    segmenter = ColorSegmenter.from_name("white")
    assert overlap(segmenter(color, depth, CAMERA, TABLE)) > 0.97
    with pytest.raises(InvalidRecordingError, match=r"cover 100 % of the picture.*give mask/"):
        segmenter(color, depth, CAMERA, None)


def test_a_tool_across_the_cloth_is_cut_out_and_both_halves_stay():
    color, depth = scene()
    color[:, 70:76] = (90, 90, 90)
    depth[:, 70:76] = 0.5
    tool = np.zeros_like(TRUE)
    tool[:, 70:76] = True
    mask = ColorSegmenter.from_name("blue")(color, depth, CAMERA, TABLE)
    assert overlap(mask, TRUE & ~tool) > 0.95
    assert (mask & tool).sum() < 0.02 * (TRUE & tool).sum()


def test_a_print_on_the_cloth_is_kept():
    color, depth = scene()
    color[50:56, 60:66] = (240, 240, 240)
    mask = ColorSegmenter.from_name("blue")(color, depth, CAMERA, TABLE)
    assert mask[50:56, 60:66].all()


@pytest.mark.parametrize(
    ("column", "side", "stays"), [(80, 14, True), (180, 14, False), (80, 5, False)]
)
def test_a_corner_that_a_tool_cuts_off_stays_and_a_spot_elsewhere_does_not(column, side, stays):
    mask = np.zeros((120, 200), dtype=bool)
    mask[10:110, 10:70] = True
    part = slice(40, 40 + side), slice(column, column + side)
    mask[part] = True
    kept = main_components(mask)
    assert kept[10:110, 10:70].all()
    assert kept[part].all() == kept[part].any() == stays


def test_only_the_largest_part_and_its_equals_stay():
    mask = np.zeros((50, 50), dtype=bool)
    mask[0:20, 0:20] = True
    mask[30:40, 30:45] = True
    mask[45:48, 3:6] = True
    kept = main_components(mask)
    assert kept[10, 10]
    assert kept[35, 35]
    assert not kept[46, 4]
    assert main_components(mask, 0.9).sum() == 400
    assert not main_components(np.zeros((5, 5), dtype=bool)).any()


def test_height_alone_finds_a_raised_cloth():
    rng = np.random.default_rng(0)
    _, depth = scene(height_m=0.012)
    depth += rng.normal(scale=0.001, size=depth.shape)
    assert overlap(HeightSegmenter()(None, depth, CAMERA, TABLE)) > 0.97
    with pytest.raises(InvalidRecordingError, match="no height without a table"):
        HeightSegmenter()(None, depth, CAMERA, None)


def test_heights_are_those_of_the_back_projected_points():
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = turn * np.linalg.det(turn)
    pose[:3, 3] = rng.normal(size=3)
    camera = Camera("c", WIDTH, HEIGHT, 150.0, 140.0, 70.0, 60.0, pose)
    normal = rng.normal(size=3)
    table = Table(rng.normal(size=3), normal / np.linalg.norm(normal))
    depth = rng.uniform(0.3, 1.0, (HEIGHT, WIDTH))
    expected = table.heights(camera.back_project(depth)).reshape(HEIGHT, WIDTH)
    np.testing.assert_allclose(height_picture(depth, camera, table), expected, atol=1e-5)
    part = (slice(7, 50), slice(20, 33))
    inside = height_picture(depth, camera, table, window=part)
    np.testing.assert_allclose(inside, expected[part], atol=1e-5)


def test_votes_are_looked_up_by_the_five_highest_bits():
    rng = np.random.default_rng(4)
    members = rng.integers(0, 3, (32, 32, 32)).astype(np.uint8)
    color = rng.integers(0, 256, (130, 40, 3)).astype(np.uint8)
    red, green, blue = np.moveaxis(color // 8, 2, 0)
    np.testing.assert_array_equal(votes_of(color, members), members[red, green, blue])


def test_every_named_color_has_a_core_and_no_hue_is_in_all():
    sets = {name: named_set(name) for name in NAMED_COLORS}
    assert all((members != NO).any() for members in sets.values())
    assert sets["red"][31, 2, 2]
    assert not sets["blue"][31, 2, 2]
    assert sets["blue"][2, 6, 28]
    assert (sets["grey"] == sets["gray"]).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda color: ColorSegmenter.from_name("bleu"), "known names: red"),
        (lambda color: ColorSegmenter.from_box(color, (10, 10, 10, 20)), "not inside the picture"),
        (lambda color: ColorSegmenter.from_box(color, (0, 0, 999, 20)), "not inside the picture"),
        (lambda color: ColorSegmenter.from_click(color, 160, 5), "outside the picture"),
        (
            lambda color: ColorSegmenter.from_box(np.full_like(color, 90), (10, 10, 60, 60)),
            "no color of the cloth differs",
        ),
    ],
)
def test_what_cannot_be_learned_says_why(make, words):
    with pytest.raises(InvalidConfigError, match=words):
        make(scene()[0])


def test_color_needs_a_color_picture():
    with pytest.raises(InvalidRecordingError, match="no color picture"):
        ColorSegmenter.from_name("blue")(None, scene()[1], CAMERA, None)


def test_masks_come_from_their_files(tmp_path):
    path = tmp_path / "a.png"
    depth = np.ones((HEIGHT, WIDTH))
    path.write_bytes(encode_png(TRUE.astype(np.uint8)))
    folder = MaskFolder({"top": path})
    np.testing.assert_array_equal(folder(None, depth, CAMERA, None), TRUE)
    with pytest.raises(InvalidRecordingError, match="160 x 120 pixels and the depth 120 x 160"):
        folder(None, depth.T, CAMERA, None)
    path.write_bytes(encode_png(np.zeros((HEIGHT, WIDTH), np.uint8)))
    with pytest.raises(InvalidRecordingError, match="mask is empty"):
        folder(None, depth, CAMERA, None)
    with pytest.raises(InvalidRecordingError, match="no mask"):
        MaskFolder({})(None, depth, CAMERA, None)


def test_the_default_is_masks_then_color_then_height(write, tmp_path):
    recording = write(tmp_path / "r")
    full = recording.frames[0]
    camera = recording.cameras[0]
    bare = Frame(0, 0.0, depth=full.depth)
    colored = Frame(0, 0.0, depth=full.depth, color=full.color)
    assert isinstance(default_segmenter(recording, full, camera), MaskFolder)
    assert isinstance(default_segmenter(recording, colored, camera), ColorSegmenter)
    assert isinstance(default_segmenter(recording, bare, camera), HeightSegmenter)


def test_without_any_hint_the_message_says_what_to_give(write, tmp_path, edit):
    recording = write(tmp_path / "r")
    object.__setattr__(recording, "table", None)
    bare = Frame(3, 0.0, depth=recording.frames[0].depth)
    with pytest.raises(InvalidRecordingError, match=r"frame 3, camera 'top'; add mask/.*table"):
        default_segmenter(recording, bare, recording.cameras[0])
