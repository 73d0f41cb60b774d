"""One sense against the other, on a drawn towel that a hand folds: each wrong input is named.

Drawn here in color and depth with noise; the reduced pictures are then spoilt in memory, and the
right ones are never accused.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.geometry_checks.action_checks import action_findings
from clothtrack.recordings.geometry_checks.all_checks import check_geometry, sense_findings
from clothtrack.recordings.geometry_checks.camera_checks import camera_findings
from clothtrack.recordings.geometry_checks.clock_checks import time_findings
from clothtrack.recordings.geometry_checks.finding import ObservedFrames
from clothtrack.recordings.geometry_checks.lens_checks import lens_findings
from clothtrack.recordings.geometry_checks.small_pictures import small_pictures
from clothtrack.recordings.geometry_checks.template_checks import size_findings, template_findings
from clothtrack.recordings.geometry_checks.tip_checks import hand_findings, motion_findings
from clothtrack.recordings.inspection import inspect
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import ClothDescription, PickAndPlace, PickerPath, Table
from clothtrack.recordings.store import RecordingWriter, read_recording

WIDTH_M, LENGTH_M, RATE, FRAMES = 0.3, 0.22, 10.0, 28
CLOSED, OPEN = 6, 20
COLUMNS, ROWS = 16, 12
SKIN, BLUE, WOOD = (205, 160, 130), (40, 70, 170), (150, 115, 80)


def camera():
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("x", 0.4).as_matrix()
    pose[:3, 3] = -0.75 * pose[:3, 2]
    return Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5, pose)


def towel(progress):
    """One third at the right is folded over by half a turn about the line where it begins."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, COLUMNS), np.linspace(-0.5, 0.5, ROWS))
    along = np.maximum(x * WIDTH_M - 0.05, 0.0)
    angle = np.pi * 0.95 * progress
    place = np.minimum(x * WIDTH_M, 0.05) + along * np.cos(angle)
    height = 0.004 + along * np.sin(angle)
    turn = Rotation.from_euler("z", 25.0, degrees=True).as_matrix()
    vertices = np.stack([place, y * LENGTH_M, height], axis=-1).reshape(-1, 3) @ turn.T
    corner = np.arange(COLUMNS * ROWS).reshape(ROWS, COLUMNS)
    a, b, c, d = (part.ravel() for part in (
        corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))  # fmt: skip
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return ClothMesh(vertices, faces.astype(np.int32))


def progress_at(frame):
    return float(np.clip((frame - CLOSED) / (OPEN - CLOSED), 0.0, 1.0))


def tip_at(frame):
    away = max(CLOSED - frame, frame - OPEN, 0) / 6
    return towel(progress_at(frame)).vertices[COLUMNS - 1] + np.array([0.3, -0.2, 0.2]) * away


def hand(tip):
    """A bar of 5 cm that comes to the tip from the right rim of the picture and above."""
    ends = np.array([tip, tip + (0.9, -0.3, 0.35)])
    side = np.array([0.25, 0.75, 0.0]) * 0.03
    return np.concatenate([ends - side, ends + side]), np.array([[0, 1, 3], [0, 3, 2]], np.int32)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    return read_recording(drawn(tmp_path_factory.mktemp("film") / "fold"))


def drawn(folder):
    eye, rng = camera(), np.random.default_rng(1)
    ground = np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])
    table = Rasterizer(np.array([[0, 1, 2], [0, 2, 3]], np.int32), eye).render(ground).depth
    draw = Rasterizer(towel(0.0).faces, eye)
    tips = np.stack([tip_at(frame) for frame in range(FRAMES)])
    with RecordingWriter(
        folder,
        [eye],
        {"top": 0.0005},
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])),
        cloth=ClothDescription("towel", "blue", (WIDTH_M, LENGTH_M), towel(0.0)),
    ) as writer:
        for frame in range(FRAMES):
            cloth = draw.render(towel(progress_at(frame)).vertices).depth
            vertices, faces = hand(tips[frame])
            arm = Rasterizer(faces, eye).render(vertices).depth
            depth = np.minimum(np.minimum(table, cloth), arm)
            color = np.full((240, 320, 3), WOOD, np.uint8)
            color[cloth < table] = BLUE
            color[(arm < cloth) & (arm < table)] = SKIN
            noisy = np.clip(color + rng.normal(0, 2.0, color.shape), 0, 255)
            writer.add_frame(
                frame / RATE,
                color={"top": noisy.astype(np.uint8)},
                depth={"top": depth + rng.normal(0, 0.001, depth.shape)},
                mask={"top": (cloth < table) & (cloth < arm)},
            )
        number = np.arange(FRAMES)
        writer.set_picker_path(
            "hand", PickerPath(number / RATE, tips, (number >= CLOSED) & (number < OPEN))
        )
        writer.add_action(2, FRAMES - 2, ["hand"])
    return folder


@pytest.fixture(scope="module")
def small(film):
    return small_pictures(film)


def findings_of(film, small):
    return [*sense_findings(film, small), *action_findings(film), *motion_findings(film, small)]


def test_a_right_recording_is_not_accused(film):
    assert check_geometry(film) == ()


def shifted(small, columns, rows):
    matrix = np.array([[1.0, 0.0, columns], [0.0, 1.0, rows]])
    moved = [
        cv2.warpAffine(each, matrix, each.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        for each in small.color
    ]
    return replace(small, color=np.stack(moved), mask=None)


def scaled(small, factor, degrees=0.0):
    rows, columns = small.color.shape[1:3]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), degrees, factor)
    moved = [
        cv2.warpAffine(each, matrix, (columns, rows), borderMode=cv2.BORDER_REPLICATE)
        for each in small.color
    ]
    return replace(small, color=np.stack(moved), mask=None)


def pushed(small, columns, since):
    """Another part of the scene is in the picture from a frame on."""
    color, height_m = small.color.copy(), small.height_m.copy()
    color[since:] = np.roll(color[since:], columns, axis=2)
    height_m[since:] = np.roll(height_m[since:], columns, axis=2)
    return replace(small, color=color, height_m=height_m, mask=None)


def turned_camera(small, since):
    """The table rises to the right by 5 mm to the rim from a frame on."""
    height_m = small.height_m.copy()
    height_m[since:] += np.linspace(-0.005, 0.005, height_m.shape[2], dtype=np.float32)
    return replace(small, height_m=height_m)


def with_depth_of(small, frames):
    frames = np.clip(frames, 0, FRAMES - 1)
    same = np.concatenate([[False], np.diff(frames) == 0])
    return replace(small, height_m=small.height_m[frames], same_depth=same)


def with_mask(small, change):
    changed = np.stack([change(place, each) for place, each in enumerate(small.mask)])
    return replace(small, mask=changed.astype(np.float32))


def grown(mask, pixels):
    kernel = np.ones((2 * abs(pixels) + 1,) * 2, np.uint8)
    return (cv2.dilate if pixels > 0 else cv2.erode)((mask > 0.5).astype(np.uint8), kernel)


def skin(small, place):
    return np.abs(small.color[place].astype(float) - SKIN).max(axis=-1) < 30


def in_order(small, frames):
    return replace(small, color=small.color[frames], height_m=small.height_m[frames])


NUMBERS = np.arange(FRAMES)
EXCHANGED = np.argsort(NUMBERS + np.random.default_rng(5).uniform(0.0, 3.0, FRAMES))
WRONG = {
    "left to right": (lambda s: replace(s, color=s.color[:, :, ::-1].copy(), mask=None),
        "color_mirrored", "turned left to right"),
    "upside down": (lambda s: replace(s, color=s.color[:, ::-1].copy(), mask=None),
        "color_mirrored", "turned upside down"),
    "shift": (lambda s: shifted(s, 6, -4), "color_shift", "moved by (-12, 8) pixels"),
    "scale": (lambda s: scaled(s, 0.5), "color_scale", "2.00 times as large"),
    "turn": (lambda s: scaled(s, 1.0, 10.0), "color_turned", "turned by -10 degrees"),
    "push": (lambda s: pushed(s, 6, 23), "camera_moved", ""),
    "tilt": (lambda s: turned_camera(s, 12), "camera_moved", ""),
    "late": (lambda s: with_depth_of(s, NUMBERS - 4), "stream_delay",
        "the depth shows the same motion 4 frames later"),
    "early": (lambda s: with_depth_of(s, NUMBERS + 3), "stream_delay",
        "the color shows the same motion 3 frames later"),
    "stuck": (lambda s: with_depth_of(s, np.minimum(NUMBERS, 10)), "depth_stuck", ""),
    "stuck mask": (lambda s: with_mask(s, lambda _, m: s.mask[0]), "mask_stuck", ""),
    "order": (lambda s: in_order(s, EXCHANGED), "frame_order", ""),
    "small": (lambda s: with_mask(s, lambda _, m: grown(m, -4)), "mask_small", ""),
    "large": (lambda s: with_mask(s, lambda _, m: grown(m, 4)), "mask_large", ""),
    "hand": (lambda s: with_mask(s, lambda n, m: (m > 0.5) | skin(s, n)), "mask_with_hand", ""),
    "rim": (lambda s: replace(s, mask=np.roll(s.mask, 60, axis=2), color=None),
        "cloth_leaves_picture", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_pictures_that_contradict_each_other_are_found(film, small, name):
    change, kind, shown = WRONG[name]
    found = {finding.kind: finding for finding in sense_findings(film, change(small))}
    assert kind in found
    assert found[kind].severity == "doubt"
    assert found[kind].measured != found[kind].limit
    assert shown in found[kind].text


def test_pictures_without_color_or_motion_are_not_accused(film, small):
    still = in_order(small, np.zeros(FRAMES, dtype=int))
    assert sense_findings(film, replace(small, color=None, mask=None)) == []
    assert [each.kind for each in sense_findings(film, replace(still, mask=None))] == []


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_a_few_frames_are_not_accused(film, count):
    actions = (PickAndPlace(0, count - 1, ("hand",)),) if count > 1 else ()
    assert check_geometry(replace(film, frames=film.frames[:count], actions=())) == ()
    few = replace(film, frames=film.frames[CLOSED : CLOSED + count], actions=actions)
    few = replace(few, frames=tuple(replace(f, index=n) for n, f in enumerate(few.frames)))
    seen = small_pictures(few)
    assert "picker_moves_nothing" not in [each.kind for each in motion_findings(few, seen)]


def test_another_thing_in_the_first_mask_is_found(film, small):
    def beside(place, mask):
        marked = mask > 0.5
        marked[4:30, 4:40] = True
        return marked

    kinds = [each.kind for each in sense_findings(film, with_mask(small, beside))]
    assert "mask_two_parts" in kinds


def with_times(film, factor):
    frames = tuple(replace(each, time_s=factor * each.time_s) for each in film.frames)
    path = film.picker_paths["hand"]
    slower = replace(path, time_s=factor * path.time_s)
    return replace(film, frames=frames, picker_paths={"hand": slower})


def test_clocks_are_in_seconds_and_without_gaps(film):
    assert time_findings(film) == []
    (milliseconds,) = time_findings(with_times(film, 1000.0))
    assert milliseconds.kind == "clock_unit"
    assert "all times 0.001 times as large" in milliseconds.text
    missing = replace(film, frames=film.frames[:9] + film.frames[17:])
    (gap,) = time_findings(missing)
    assert gap.kind == "frame_gap"
    assert gap.measured == pytest.approx(0.9)
    # The pick itself lies in the gap: the picker is open in the frame before.
    assert not film.picker_paths["hand"].closed_at(film.frames[2].time_s)
    (gap,) = time_findings(replace(film, frames=film.frames[:3] + film.frames[17:]))
    assert gap.kind == "frame_gap"
    jittered = replace(
        film,
        frames=tuple(
            replace(each, time_s=each.time_s + 0.06 * (each.index % 2)) for each in film.frames
        ),
    )
    (spacing,) = time_findings(jittered)
    assert (spacing.kind, spacing.severity) == ("frame_spacing", "note")


@pytest.mark.parametrize(("at", "severity"), [(1, "note"), (9, "doubt"), (FRAMES - 1, "note")])
def test_a_clock_that_jumps_is_named_whatever_the_tip_does(film, at, severity):
    """Frames and path jump together, so that the tip stands still in the jump."""
    start_s, day_s = film.frames[at].time_s, 86400.0
    path = film.picker_paths["hand"]
    frames = [*film.frames[:at], *(replace(f, time_s=f.time_s + day_s) for f in film.frames[at:])]
    later = path.time_s + day_s * (path.time_s > start_s - 1e-9)
    set_forward = replace(
        film, frames=tuple(frames), picker_paths={"hand": replace(path, time_s=later)}
    )
    (jump,) = time_findings(set_forward)
    assert (jump.kind, jump.severity) == ("clock_jump", severity)
    assert jump.measured == pytest.approx(day_s + 0.1)
    assert jump.limit == pytest.approx(10.0)
    for words in (
        f"frame {at - 1} to frame {at} ",
        "subtract 86400 from",
        "leave the action out" if severity == "doubt" else "paused, leave it",
    ):
        assert words in jump.text


@pytest.mark.parametrize(("step_m", "found"), [(0.0005, False), (0.003, False), (0.012, True)])
def test_depth_in_large_steps_is_doubted(film, tmp_path, step_m, found):
    def change(kind, picture):
        return step_m * np.round(picture / step_m) if kind == "depth" else picture

    coarse = rewritten(film, tmp_path / "coarse", change)
    kinds = [finding.kind for finding in camera_findings(coarse)]
    assert ("depth_steps" in kinds) == found


def test_an_action_holds_its_pick_and_its_release(film, small):
    for first, last, kind in ((12, 26, "action_begins_late"), (2, 13, "action_ends_early")):
        wrong = replace(film, actions=(PickAndPlace(first, last, ("hand",)),))
        assert kind in [each.kind for each in action_findings(wrong)]
    # One long carry in two actions loses nothing.
    halves = (PickAndPlace(2, 13, ("hand",)), PickAndPlace(13, 26, ("hand",)))
    assert action_findings(replace(film, actions=halves)) == []


def test_a_tip_that_moves_where_nothing_does_is_found(film, small):
    path = film.picker_paths["hand"]
    elsewhere = replace(path, positions=path.positions * (-1.0, 1.0, 1.0))
    found = motion_findings(replace(film, picker_paths={"hand": elsewhere}), small)
    assert [each.kind for each in found] == ["picker_moves_nothing"]


def carried(film, change):
    """The film with its closed tips at other places: the share of the carry goes from 0 to 1."""
    path = film.picker_paths["hand"]
    positions = path.positions.copy()
    frames = np.flatnonzero(path.closed)
    positions[frames] = change(positions[frames], np.linspace(0.0, 1.0, len(frames))[:, None])
    positions[frames[-1] + 1 :] = positions[frames[-1]]
    return replace(film, picker_paths={"hand": replace(path, positions=positions)})


def test_a_tip_that_stands_while_its_cloth_goes_on_is_found(film, small):
    for since in (5, 7, 9):
        stuck = carried(film, lambda tips, _, at=since: tips[np.minimum(np.arange(len(tips)), at)])
        (found,) = motion_findings(stuck, small)
        assert found.kind == "picker_stuck"
        assert f"from {(CLOSED + since) / RATE:g} s on" in found.text
    # A tip that waits before it carries, or keeps what it holds where it is, is right.
    late = carried(film, lambda tips, _: tips[np.maximum(np.arange(len(tips)) - 3, 0)])
    assert "picker_stuck" not in [each.kind for each in motion_findings(late, small)]
    waits = in_order(small, np.minimum(np.arange(FRAMES), CLOSED + 9))
    stuck = carried(film, lambda tips, _: tips[np.minimum(np.arange(len(tips)), 9)])
    assert motion_findings(stuck, waits) == []


def test_a_place_beside_the_hand_is_found(film):
    """Cloth is there, but the fingers are elsewhere."""
    frames = ObservedFrames(film)
    assert hand_findings(film, frames) == []
    aside = 0.15 * np.array([-0.9, 0.3, 0.0])
    for share in (lambda part: part**2, lambda part: (1.0 - part) ** 2):
        wrong = carried(film, lambda tips, part, way=share: tips + way(part) * aside)
        (found,) = hand_findings(wrong, frames)
        assert found.kind == "picker_beside_hand"
        assert 0.035 < found.measured < 0.15
    # A constant error may be that of a tool whose tip is not measured.
    assert hand_findings(carried(film, lambda tips, _: tips + aside), frames) == []


def test_a_template_is_one_surface(film):
    template = film.cloth.template

    def with_template(vertices, faces):
        cloth = replace(film.cloth, template=ClothMesh(vertices, faces.astype(np.int32)))
        return [each.text for each in template_findings(replace(film, cloth=cloth))]

    assert template_findings(film) == []
    rng = np.random.default_rng(0)
    soup = template.vertices[template.faces].reshape(-1, 3) + rng.normal(0, 1e-4, (1, 3))
    soup = soup + rng.uniform(-1e-4, 1e-4, soup.shape)
    assert "not joined" in with_template(soup, np.arange(len(soup)).reshape(-1, 3))[0]
    apart = np.concatenate([template.vertices, template.vertices + (0, 0, 0.1)])
    both = np.concatenate([template.faces, template.faces + len(template.vertices)])
    assert "2 separate pieces" in with_template(apart, both)[0]
    flattened = template.vertices.copy()
    flattened[:, 1] = np.round(flattened[:, 1], 8) * 1e-6
    assert "hardly any area" in with_template(flattened, template.faces)[0]


def test_a_size_is_one_that_the_garment_has(film):
    assert size_findings(film) == []
    for size in ((30.0, 22.0), (0.03, 0.022), (0.9, 0.05)):
        cloth = replace(film.cloth, size_m=size)
        assert [e.kind for e in size_findings(replace(film, cloth=cloth))] == ["size_implausible"]


def test_intrinsics_are_those_of_the_picture(film):
    def with_lens(**changes):
        eye = replace(film.cameras[0], **changes)
        return [each.kind for each in lens_findings(replace(film, cameras=(eye,)))]

    assert with_lens() == []
    assert with_lens(cx=180.0) == ["principal_point"]
    assert with_lens(cy=90.0) == ["principal_point"]
    assert with_lens(fx=324.0) == ["focal_ratio"]
    # A cut picture may have its principal point anywhere.
    assert with_lens(height=160, cy=39.5) == []


def bent(picture, k1):
    """What a lens with k1 would have drawn of this picture of 640 x 480 pixels."""
    matrix = np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]])
    rows, columns = np.mgrid[:480, :640].astype(np.float32)
    places = np.stack([columns, rows], -1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(places, matrix, np.array([k1, 0, 0, 0]), P=matrix)
    x, y = straight.reshape(480, 640, 2).transpose(2, 0, 1)
    return cv2.remap(picture, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)


def lying(folder, k1):
    """One picture of a flat towel, seen from straight above through a lens with k1."""
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = np.diag([1.0, -1.0, -1.0]), 0.8
    eye = Camera("top", 640, 480, 600.0, 600.0, 319.5, 239.5, pose)
    mask = np.zeros((480, 640), np.uint8)
    cv2.fillConvexPoly(mask, np.array([[110, 60], [520, 90], [500, 400], [95, 370]]), 1)
    mask = bent(mask, k1)
    color = np.where(mask[..., None] > 0, BLUE, WOOD).astype(np.uint8)
    depth = np.full((480, 640), 0.8) - 0.003 * mask
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    cloth = ClothDescription("towel", "blue")
    with RecordingWriter(folder, [eye], {"top": 0.0005}, table=table, cloth=cloth) as writer:
        writer.add_frame(0.0, color={"top": color}, depth={"top": depth}, mask={"top": mask > 0})
    return read_recording(folder)


def rewritten(film, folder, change):
    """A copy whose pictures a function changed: (frame number, kind, picture)."""
    with RecordingWriter(
        folder, film.cameras, film.depth_units_m, table=film.table, cloth=film.cloth
    ) as writer:
        for number, each in enumerate(film.frames):
            color = change("color", read_color(each.color["top"]))
            depth = change("depth", read_depth(each.depth["top"], 0.0005))
            mask = change("mask", read_mask(each.mask["top"]).astype(np.uint8)) > 0
            writer.add_frame(
                number / RATE, color={"top": color}, depth={"top": depth}, mask={"top": mask}
            )
        for name, path in film.picker_paths.items():
            writer.set_picker_path(name, path)
        writer.add_action(2, FRAMES - 2, ["hand"])
    return read_recording(folder)


def test_a_lens_that_bends_a_towel_is_found(tmp_path):
    assert lens_findings(lying(tmp_path / "straight", 0.0)) == []
    for k1 in (-0.3, 0.25):
        wrong = lying(tmp_path / f"bent{k1}", k1)
        (found,) = lens_findings(wrong)
        assert found.kind == "lens_distortion"
        stated = float(found.text.split("k1 = ")[1].split()[0])
        assert stated == pytest.approx(k1, abs=0.06)


def test_a_shift_is_told_to_a_program(film, tmp_path):
    def change(kind, picture):
        return picture if kind == "depth" else np.roll(picture, (6, 16), axis=(0, 1))

    wrong = rewritten(film, tmp_path / "wrong", change)
    content = json.loads(json.dumps(inspect(wrong.folder).as_dict()))["geometry"]
    (shift,) = (each for each in content if each["kind"] == "color_shift")
    assert shift["measured"] == pytest.approx(np.hypot(6, 16), abs=3.0)


def test_real_recordings_are_not_accused(data, tmp_path):
    import sys
    from pathlib import Path

    sys.path.insert(0, str(Path(__file__).parents[2] / "experiments"))
    from real import hanging_cloth, robot_clouds, tshirt_pair

    made = [
        hanging_cloth.convert(data / "hanging-cloth-rgbd", tmp_path / "hanging"),
        tshirt_pair.convert(data / "tshirt-pair-rgbd", tmp_path / "pair"),
        *(
            robot_clouds.convert(each, tmp_path / each.stem)
            for each in robot_clouds.sequences(data / "robot-lift-fold-clouds")
        ),
    ]
    assert len(made) >= 12
    for folder in made:
        assert check_geometry(read_recording(folder)) == ()


def test_the_shipped_recording_is_not_accused():
    from clothtrack.recordings.shipped import shipped_recording

    assert check_geometry(read_recording(shipped_recording())) == ()
