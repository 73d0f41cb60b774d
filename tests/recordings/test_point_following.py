"""Points that are followed in pictures move as the cloth does; plain cloth has none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import camera_views
from clothtrack.recordings.point_following import PointFollower
from clothtrack.recordings.recording import PickerPath
from clothtrack.recordings.store import RecordingWriter, read_recording

WIDTH, HEIGHT, HIGH_M = 160, 120, 0.8
CAMERA = Camera(
    "top", WIDTH, HEIGHT, 150.0, 150.0, 79.5, 59.5,
    np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, HIGH_M], [0, 0, 0, 1]]),
)  # fmt: skip
PIXEL_M = HIGH_M / CAMERA.fx


def printed(seed=0, contrast=60.0):
    """A brightness picture larger than the camera's, of blots a few pixels wide."""
    blots = np.random.default_rng(seed).normal(size=(2 * HEIGHT, 2 * WIDTH)).astype(np.float32)
    blots = cv2.GaussianBlur(blots, (0, 0), 2.0)
    return 120.0 + contrast * blots / blots.std()


def cut(picture, shift_px):
    """The camera's part of a picture that has moved."""
    move = np.array([[1, 0, shift_px[0] - WIDTH // 2], [0, 1, shift_px[1] - HEIGHT // 2]], float)
    return cv2.warpAffine(picture, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)


def as_color(gray):
    """A gray color picture of a brightness."""
    return np.clip(np.rint(gray), 0, 255).astype(np.uint8)[..., None].repeat(3, 2)


def recorded(folder, grays, depths=None, masks=None, actions=((0, None),)):
    """A recording of these brightnesses [0 to 255], on a plane 0.8 m away where nothing is said."""
    count = len(grays)
    with RecordingWriter(folder, (CAMERA,), {"top": 1e-4}) as writer:
        for index, gray in enumerate(grays):
            depth = np.full((HEIGHT, WIDTH), HIGH_M) if depths is None else depths[index]
            mask = np.ones((HEIGHT, WIDTH), bool) if masks is None else masks[index]
            writer.add_frame(
                0.1 * index,
                color={"top": as_color(gray)}, depth={"top": depth}, mask={"top": mask},
            )  # fmt: skip
        times = 0.1 * np.arange(count)
        writer.set_picker_path("hand", PickerPath(times, np.zeros((count, 3)), times < 0))
        for first, last in actions:
            writer.add_action(first, count - 1 if last is None else last, ("hand",))
    return read_recording(folder)


def followed(recording):
    """The followed points of every frame."""
    follower = PointFollower(recording)
    return [
        follower(frame, camera_views(recording, frame, color=True)) for frame in recording.frames
    ]


def test_followed_points_move_with_the_print(tmp_path):
    steps = [np.array([1.3, -0.7]) * index for index in range(5)]
    found = followed(recorded(tmp_path / "r", [cut(printed(), step) for step in steps]))
    first, last = found[0], found[4]
    assert len(first.numbers) > 60
    assert len(last.numbers) > 0.8 * len(first.numbers)
    assert (np.diff(last.numbers) > 0).all()
    before = first.positions[np.searchsorted(first.numbers, last.numbers)]
    moved = (last.positions - before) / PIXEL_M
    # The camera looks down: its rows run against y.
    off = np.linalg.norm(moved - [steps[4][0], -steps[4][1], 0.0], axis=1)
    assert np.median(off) < 0.1
    assert (off < 0.25).mean() > 0.95
    assert off.max() < 1.0


@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_plain_cloth_has_nothing_to_follow(tmp_path, noise):
    rng = np.random.default_rng(1)
    grays = [120.0 + noise * rng.normal(size=(HEIGHT, WIDTH)) for _ in range(3)]
    # What the noise is, the second picture tells.
    found = followed(recorded(tmp_path / "r", grays, actions=((1, None),)))
    assert [len(found[index].numbers) for index in range(3)] == [0, 0, 0]


def test_lost_points_are_looked_for_five_frames_later(tmp_path):
    masks = np.ones((9, HEIGHT, WIDTH), bool)
    masks[1:6, :, :60] = False
    masks[2:6, :, 100:] = False
    found = followed(recorded(tmp_path / "r", [cut(printed(), (0.0, 0.0))] * 9, masks=masks))
    across = [found[index].positions[:, 0] / PIXEL_M + CAMERA.cx for index in range(9)]
    left, right = ([part.sum() for part in parts] for parts in (
        [each < 45 for each in across], [each > 115 for each in across],
    ))  # fmt: skip
    assert left[6] > 0.8 * left[0]
    assert right[6] == 0  # though nothing covers it any more
    assert right[7] > 0.8 * right[0]


def test_what_is_covered_is_lost_and_numbers_are_never_used_twice(tmp_path):
    masks = np.ones((5, HEIGHT, WIDTH), bool)
    masks[1:3, :, : WIDTH // 2] = False
    grays = [cut(printed(), (0.0, 0.0))] * 5
    found = followed(recorded(tmp_path / "r", grays, masks=masks, actions=((0, 2), (3, None))))
    left = [found[index].positions[:, 0] < -PIXEL_M for index in range(4)]
    assert left[0].sum() > 20
    assert [found[1].positions[left[1]].size, found[2].positions[left[2]].size] == [0, 0]
    assert left[3].sum() > 20
    # Old numbers come back where they were, and no other takes them.
    old = found[3].numbers <= found[0].numbers.max()
    assert old[left[3]].mean() > 0.5  # those that have others beside them
    before = found[0].positions[np.searchsorted(found[0].numbers, found[3].numbers[old])]
    assert np.linalg.norm(found[3].positions[old] - before, axis=1).max() < PIXEL_M
    assert len(np.unique(found[3].numbers)) == len(found[3].numbers)
    assert np.isin(found[2].numbers, found[3].numbers).all()


def test_a_print_that_is_covered_twice_comes_back_once(tmp_path):
    """Found again in frame 7 and lost again in frame 8, it is looked for in frame 13."""
    masks = np.ones((15, HEIGHT, WIDTH), bool)
    masks[[2, 3, 4, *range(8, 13)], :, : WIDTH // 2] = False
    found = followed(recorded(tmp_path / "r", [cut(printed(), (0.0, 0.0))] * 15, masks=masks))
    assert all((np.diff(one.numbers) > 0).all() for one in found)
    covered = np.setdiff1d(found[7].numbers, found[8].numbers)
    assert np.isin(covered, found[1].numbers).mean() > 0.9
    # Those that have others beside them.
    assert np.isin(covered, found[13].numbers).mean() > 0.6


def weave(shift_px=(0.0, 0.0)):
    """A brightness picture that repeats every 11 pixels, moved by so many."""
    across, down = np.meshgrid(np.arange(WIDTH) - shift_px[0], np.arange(HEIGHT) - shift_px[1])
    return 120.0 + 20.0 * (np.cos(across * 2.0 * np.pi / 11) + np.cos(down * 2.0 * np.pi / 11))


def test_what_was_lost_altogether_comes_back_under_new_numbers(tmp_path):
    masks = np.ones((4, HEIGHT, WIDTH), bool)
    masks[1] = False
    masks[1, :9, :9] = True
    grays = [weave()] * 4
    found = followed(recorded(tmp_path / "r", grays, masks=masks, actions=((0, 1), (2, None))))
    assert len(found[0].numbers) > 50
    assert len(found[2].numbers) > 50
    assert found[2].numbers.min() > found[0].numbers.max()


def test_a_weave_that_a_tool_covered_comes_back_under_its_numbers(tmp_path):
    """Where it went, those beside it tell."""
    masks = np.ones((7, HEIGHT, WIDTH), bool)
    masks[2:5, :, 40:70] = False
    shifts = [np.array([1.5, 0.5]) * index for index in range(7)]
    found = followed(recorded(tmp_path / "r", [weave(s) for s in shifts], masks=masks))
    before = found[1].numbers
    gone, back = ~np.isin(before, found[3].numbers), np.isin(before, found[6].numbers)
    assert gone.sum() > 10
    # Where the tool's rim was beside them when they were last seen, they look different.
    assert (gone & back).sum() > 0.6 * gone.sum()
    first, last = found[0].positions, found[6].positions
    first = first[np.searchsorted(found[0].numbers, found[6].numbers)]
    moved = (last - first)[:, :2] / PIXEL_M
    assert np.abs(moved - (shifts[6][0], -shifts[6][1])).max() < 0.5


def test_cloth_that_speeds_up_and_turns_dark_is_followed(tmp_path):
    """Up to 8 pixels a picture: the weave beside it would be nearer."""
    shifts = np.cumsum([[0.0, 0.0], *([step, 0.0] for step in range(1, 9))], axis=0)
    dark = np.linspace(1.0, 0.4, len(shifts))
    shadow = np.linspace(1.0, 0.7, WIDTH)
    grays = [
        weave(shift) * light * shadow**index
        for index, (shift, light) in enumerate(zip(shifts, dark, strict=True))
    ]
    found = followed(recorded(tmp_path / "r", grays))
    first, last = found[0], found[8]
    # 36 of the 160 columns have left the picture.
    assert len(last.numbers) > 0.6 * len(first.numbers)
    before = first.positions[np.searchsorted(first.numbers, last.numbers)]
    moved = (last.positions - before)[:, 0] / PIXEL_M
    assert np.abs(moved - 36.0).max() < 1.0


def test_a_faint_weave_is_followed_in_a_noisy_picture(tmp_path):
    """Nearly as much noise as contrast."""
    rng = np.random.default_rng(3)
    shifts = [np.array([2.0, 1.0]) * max(0, index - 1) for index in range(5)]
    grays = [
        120.0 + 0.25 * (weave(shift) - 120.0) + 4.0 * rng.normal(size=(HEIGHT, WIDTH))
        for shift in shifts
    ]
    # What the noise is, the second picture tells.
    found = followed(recorded(tmp_path / "r", grays, actions=((1, None),)))
    first, last = found[1], found[4]
    assert len(first.numbers) > 40
    assert len(last.numbers) > 0.6 * len(first.numbers)
    before = first.positions[np.searchsorted(first.numbers, last.numbers)]
    moved = (last.positions - before)[:, :2] / PIXEL_M
    assert np.abs(moved - (6.0, -3.0)).max() < 1.0


def test_a_point_that_runs_away_from_its_neighbors_is_lost(tmp_path):
    """A patch of the print slides by 6 cm: another thing, not this cloth."""
    still = cut(printed(), (0.0, 0.0))
    grays = []
    for jump in (0, 3, 6, 9, 12):
        gray = still.copy()
        gray[50:66, 40 + jump : 56 + jump] = cut(printed(7), (0.0, 0.0))[50:66, 40:56]
        grays.append(gray)
    found = followed(recorded(tmp_path / "r", grays))
    first, last = found[0], found[4]
    before = first.positions[np.searchsorted(first.numbers, last.numbers)]
    assert len(last.numbers) > 60
    # At its front rim those beside a point are nearer than they were: a few are kept.
    assert (np.linalg.norm(last.positions - before, axis=1) < 0.03).mean() > 0.99


def test_no_point_is_chosen_or_kept_where_two_layers_meet(tmp_path):
    step = np.full((HEIGHT, WIDTH), HIGH_M)
    step[:, WIDTH // 2 :] -= 0.3
    grays = [cut(printed(), (0.0, 0.0))] * 2
    found = followed(recorded(tmp_path / "r", grays, depths=[step, step]))
    near_step = np.abs(found[1].positions[:, 0] / PIXEL_M) < 2
    assert len(found[1].numbers) > 50
    assert not near_step.any()


def test_a_picture_without_color_is_passed_over(tmp_path):
    recording = recorded(tmp_path / "r", [weave((2.0 * index, 0.0)) for index in range(4)])
    recording.frames[2].color.clear()
    found = followed(recording)
    assert len(found[2].numbers) == 0
    last, first = found[3], found[0]
    assert len(last.numbers) > 0.8 * len(first.numbers)
    before = first.positions[np.searchsorted(first.numbers, last.numbers)]
    np.testing.assert_allclose((last.positions - before)[:, 0] / PIXEL_M, 6.0, atol=0.5)


def test_frames_that_nobody_asks_for_are_followed_all_the_same(tmp_path):
    recording = recorded(tmp_path / "r", [cut(printed(), (step, 0.0)) for step in range(4)])
    frame = recording.frames[3]
    follower = PointFollower(recording)
    assert not follower.knows(recording.frames[0])
    last = follower(frame, camera_views(recording, frame, color=True))
    assert follower.knows(frame)
    expected = followed(recording)
    np.testing.assert_array_equal(last.numbers, expected[3].numbers)
    np.testing.assert_array_equal(last.positions, expected[3].positions)
    # What was followed before needs no pictures.
    again = follower(recording.frames[1], ())
    np.testing.assert_array_equal(again.positions, expected[1].positions)


def test_points_of_two_cameras_have_numbers_of_their_own(tmp_path):
    cameras = CAMERA, replace(CAMERA, name="beside")
    with RecordingWriter(tmp_path / "r", cameras, {"top": 1e-4, "beside": 1e-4}) as writer:
        for index in range(4):
            grays = [cut(printed(seed), (float(index), 0.0)) for seed in (0, 1)]
            named = dict(zip(("top", "beside"), grays, strict=True))
            writer.add_frame(
                0.1 * index,
                color={name: as_color(gray) for name, gray in named.items()},
                depth={name: np.full((HEIGHT, WIDTH), HIGH_M) for name in named},
                mask={name: np.ones((HEIGHT, WIDTH), bool) for name in named},
            )
        times = 0.1 * np.arange(4)
        writer.set_picker_path("hand", PickerPath(times, np.zeros((4, 3)), times < 0))
        writer.add_action(0, 1, ("hand",))
        writer.add_action(2, 3, ("hand",))
    for points in followed(read_recording(tmp_path / "r")):
        assert len(points.numbers) > 120
        assert (np.diff(points.numbers) > 0).all()
