"""Color, depth, clock, lens and template against each other, on a drawn towel that a hand folds.

Drawn here in color and depth with noise; each wrong input is named, and the right one is not.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import clothtrack as ct
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.geometry_checks.checks import CHECKS, check_geometry
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import ClothDescription, PickerPath, Table
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


def found(film):
    return ct.inspect_recording(film).geometry


def kinds(film):
    return [finding.kind for finding in found(film)]


def test_a_right_recording_is_not_accused(film):
    assert found(film) == ()


def rewritten(film, folder, change):
    """A copy whose pictures a function changed: (frame, kind, picture)."""
    with RecordingWriter(
        folder, film.cameras, film.depth_units_m, table=film.table, cloth=film.cloth
    ) as writer:
        for number, each in enumerate(film.frames):
            color = change(number, "color", read_color(each.color["top"]))
            depth = change(number, "depth", read_depth(each.depth["top"], 0.0005))
            mask = change(number, "mask", read_mask(each.mask["top"]).astype(np.uint8)) > 0
            writer.add_frame(
                number / RATE, color={"top": color}, depth={"top": depth}, mask={"top": mask}
            )
        for name, path in film.picker_paths.items():
            writer.set_picker_path(name, path)
        writer.add_action(2, FRAMES - 2, ["hand"])
    return read_recording(folder)


def moved(picture, columns, rows):
    matrix = np.array([[1.0, 0.0, columns], [0.0, 1.0, rows]])
    return cv2.warpAffine(picture, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE)


def turned(picture):
    matrix = cv2.getRotationMatrix2D((159.5, 119.5), 10.0, 1.0)
    return cv2.warpAffine(picture, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE)


LENS = [check for check in CHECKS if check.kind in ("principal_point", "focal_ratio")]
RISING_M = np.linspace(-0.005, 0.005, 320)
WRONG = {
    "shift": (lambda n, kind, p: p if kind == "depth" else moved(p, 12, -8), "color_shift",
        "moved by (-12, 8) pixels"),
    "turn": (lambda n, kind, p: p if kind == "depth" else turned(p), "color_turned",
        "turned by -10 degrees"),
    "push": (lambda n, kind, p: p if n < 23 else np.roll(p, 12, axis=1), "camera_moved",
        "pushed before frame 23"),
    "tilt": (lambda n, kind, p: p + RISING_M if n >= 12 and kind == "depth" else p, "camera_moved",
        "the table in its depth lies up to"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_pictures_that_contradict_each_other_are_found(film, tmp_path, name):
    change, kind, shown = WRONG[name]
    named = {one.kind: one for one in found(rewritten(film, tmp_path / "wrong", change))}
    assert named[kind].severity == "doubt"
    assert named[kind].measured > named[kind].limit
    assert shown in named[kind].text


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_a_few_frames_are_not_accused(film, count):
    assert found(replace(film, frames=film.frames[:count], actions=())) == ()


def with_times(film, factor):
    frames = tuple(replace(each, time_s=factor * each.time_s) for each in film.frames)
    path = film.picker_paths["hand"]
    slower = replace(path, time_s=factor * path.time_s)
    return replace(film, frames=frames, picker_paths={"hand": slower})


def test_clocks_are_in_seconds_and_without_gaps(film):
    (milliseconds,) = found(with_times(film, 1000.0))
    assert milliseconds.kind == "clock_unit"
    assert "all times 0.001 times as large" in milliseconds.text
    # The pick itself lies in the second gap: the picker is open in the frame before.
    for before, gap_s in ((9, 0.9), (3, 1.5)):
        frames = film.frames[:before] + film.frames[17:]
        frames = tuple(replace(each, index=n) for n, each in enumerate(frames))
        (gap,) = found(replace(film, frames=frames, actions=()))
        assert (gap.kind, gap.severity) == ("frame_gap", "doubt")
        assert gap.measured == pytest.approx(gap_s)
    jittered = tuple(
        replace(each, time_s=each.time_s + 0.06 * (each.index % 2)) for each in film.frames
    )
    named = {one.kind: one for one in found(replace(film, frames=jittered, actions=()))}
    assert named["frame_spacing"].severity == "note"


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
    (jump,) = (one for one in found(set_forward) if one.kind == "clock_jump")
    assert (jump.kind, jump.severity) == ("clock_jump", severity)
    assert jump.measured == pytest.approx(day_s + 0.1)
    assert jump.limit == pytest.approx(10.0)
    for words in (
        f"frame {at - 1} to frame {at} ",
        "subtract 86400 from",
        "leave the action out" if severity == "doubt" else "paused, leave it",
    ):
        assert words in jump.text


def test_a_template_is_one_surface(film):
    template = film.cloth.template
    soup = template.vertices[template.faces].reshape(-1, 3)
    soup = soup + np.random.default_rng(0).uniform(-1e-4, 1e-4, soup.shape)
    mesh = ClothMesh(soup, np.arange(len(soup), dtype=np.int32).reshape(-1, 3))
    (surface,) = found(replace(film, cloth=replace(film.cloth, template=mesh)))
    assert surface.kind == "template_surface"
    assert "100 % of its vertices have a double within 0.5 mm" in surface.text


@pytest.mark.parametrize(
    ("lens", "kind"),
    [
        ({"cx": 180.0}, "principal_point"),
        ({"cy": 90.0}, "principal_point"),
        ({"fx": 324.0}, "focal_ratio"),
        # A cut picture may have its principal point anywhere.
        ({"height": 160, "cy": 39.5}, None),
    ],
)
def test_intrinsics_are_those_of_the_picture(film, lens, kind):
    eye = replace(film.cameras[0], **lens)
    named = [one.kind for one in check_geometry(replace(film, cameras=(eye,)), checks=LENS)]
    assert named == ([kind] if kind else [])


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
        assert found(read_recording(folder)) == ()


def test_the_shipped_recording_is_not_accused():
    from clothtrack.recordings.shipped import shipped_recording

    assert found(read_recording(shipped_recording())) == ()
