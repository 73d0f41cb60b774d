"""Reduced pictures and recordings with one input corrupted in memory by a random strength.

The pictures on disk stay unchanged.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from clothtrack.geometry import ClothMesh
from clothtrack.recordings import Recording
from clothtrack.recordings.colors import CORE, named_set, votes_of
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.segmentation import main_components

SKIN = (205, 160, 130)

Spoilt = tuple[Recording, SmallPictures]
Spoil = Callable[[Recording, SmallPictures, np.random.Generator], Spoilt]


@dataclass(frozen=True)
class SenseKind:
    """One way in which a sense is wrong.

    Attributes:
        text: for a person.
        kinds: of the findings that name it.
        spoil: makes it wrong, by a random strength.
    """

    text: str
    kinds: tuple[str, ...]
    spoil: Spoil


def _warped(small: SmallPictures, matrix: np.ndarray) -> SmallPictures:
    assert small.color is not None
    size = small.color.shape[2], small.color.shape[1]
    moved = [
        cv2.warpAffine(each, matrix, size, borderMode=cv2.BORDER_REPLICATE) for each in small.color
    ]
    return replace(small, color=np.stack(moved), mask=None)


def _flipped(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    rows, columns = [(1, -1), (-1, 1), (-1, -1)][int(rng.integers(3))]
    assert small.color is not None
    color = np.ascontiguousarray(small.color[:, ::rows, ::columns])
    return recording, replace(small, color=color, mask=None)


def _shifted(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    angle, pixels = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(3.5, 12.0)
    matrix = np.array([[1.0, 0, pixels * np.cos(angle)], [0, 1.0, pixels * np.sin(angle)]])
    return recording, _warped(small, matrix)


def _scaled(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    factor = float(rng.choice([0.5, 2 / 3, 0.75, 4 / 3, 1.5]))
    assert small.color is not None
    middle = ((small.color.shape[2] - 1) / 2, (small.color.shape[1] - 1) / 2)
    return recording, _warped(small, cv2.getRotationMatrix2D(middle, 0.0, factor))


def _delayed(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    count, late = len(small.frames), int(rng.integers(2, 9)) * int(rng.choice([-1, 1]))
    frames = np.clip(np.arange(count) - late, 0, count - 1)
    return recording, replace(small, height_m=small.height_m[frames])


def _stuck(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    count = len(small.frames)
    begin = int(rng.integers(count // 4, count // 2))
    end = begin + int(rng.integers(4, count // 2))
    frames = np.arange(count)
    frames[begin:end] = begin
    same = np.diff(frames, prepend=-1) == 0
    if small.color is not None and rng.random() < 0.5:
        return recording, replace(small, color=small.color[frames], same_color=same)
    return recording, replace(small, height_m=small.height_m[frames], same_depth=same)


def _shuffled(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    count = len(small.frames)
    window = float(rng.choice([3.0, 5.0, count]))
    frames = np.argsort(np.arange(count) + rng.uniform(0.0, window, count))
    assert small.color is not None
    mask = None if small.mask is None else small.mask[frames]
    spoilt = replace(small, color=small.color[frames], height_m=small.height_m[frames], mask=mask)
    return recording, spoilt


def _masked(recording: Recording, small: SmallPictures) -> np.ndarray:
    """The right masks: those of the recording, or those of the cloth's color name."""
    if small.mask is not None or recording.cloth.color is None or small.color is None:
        return small.mask > 0.5 if small.mask is not None else np.zeros(small.height_m.shape, bool)
    members = named_set(recording.cloth.color)
    return np.stack([main_components(votes_of(each, members) == CORE) for each in small.color])


def _eroded(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    kernel = np.ones((2 * int(rng.integers(3, 6)) + 1,) * 2, np.uint8)
    masks = [cv2.erode(each.astype(np.uint8), kernel) for each in _masked(recording, small)]
    return recording, replace(small, mask=np.stack(masks).astype(np.float32))


def _with_hand(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    """Everything that stands high in the picture beside the cloth is in the mask, too."""
    high = np.nan_to_num(small.height_m, nan=0.0) > rng.uniform(0.02, 0.04)
    masks = _masked(recording, small) | high
    return recording, replace(small, mask=masks.astype(np.float32))


def _with_neighbor(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    """A square of some size in the first corner that is free."""
    masks = _masked(recording, small)
    rows, columns = masks.shape[1:]
    masks = masks.copy()
    near = cv2.dilate(masks[0].astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    for share in np.linspace(rng.uniform(0.3, 0.9), 0.26, 8):
        side = int(np.sqrt(share * masks[0].sum())) + 1
        free = [
            (top, left)
            for top in range(2, rows - side - 2, 3)
            for left in range(2, columns - side - 2, 3)
            if not near[top : top + side, left : left + side].any()
        ]
        if free:
            top, left = free[int(rng.integers(len(free)))]
            masks[:, top : top + side, left : left + side] = True
            break
    return recording, replace(small, mask=masks.astype(np.float32))


def _leaves(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    """The camera looks beside the cloth: the picture begins in its middle."""
    masks = _masked(recording, small)
    columns = np.flatnonzero(masks[0].any(axis=0))
    cut = int(np.quantile(columns, rng.uniform(0.1, 0.6)))
    shifted = np.zeros_like(masks)
    shifted[:, :, : masks.shape[2] - cut] = masks[:, :, cut:]
    return recording, replace(small, mask=shifted.astype(np.float32), color=None)


def _clocked(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    factor = float(rng.choice([1e3, 1e6, 1e9]))
    frames = tuple(replace(each, time_s=factor * each.time_s) for each in recording.frames)
    paths = {
        name: replace(path, time_s=factor * path.time_s)
        for name, path in recording.picker_paths.items()
    }
    return replace(recording, frames=frames, picker_paths=paths), small


def without_pictures(small: SmallPictures) -> SmallPictures:
    """Reduced pictures of the first frame alone, which say nothing of motion."""
    color, mask = small.color, small.mask
    return replace(
        small,
        frames=small.frames[:1],
        color=None if color is None else color[:1],
        height_m=small.height_m[:1],
        mask=None if mask is None else mask[:1],
        same_color=small.same_color[:1],
        same_depth=small.same_depth[:1],
    )


def _gap(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    """Frames in the middle of the first carry are missing."""
    action = recording.actions[0]
    (name, *_) = action.pickers
    path = recording.picker_paths[name]
    held = [
        n for n in range(action.first_frame, action.last_frame)
        if path.closed_at(recording.frames[n].time_s)
    ]  # fmt: skip
    count = min(int(rng.integers(6, 10)), len(held) - 3)
    begin = held[1] + int(rng.integers(0, max(len(held) - count - 2, 1)))
    kept = recording.frames[:begin] + recording.frames[begin + count :]
    frames = tuple(replace(each, index=number) for number, each in enumerate(kept))
    # An action may end with the recording, which is shorter now.
    cut = replace(action, last_frame=min(action.last_frame, len(frames) - 1))
    return replace(recording, frames=frames, actions=(cut,)), without_pictures(small)


def _cut_action(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    """The first action begins after its pick, or ends before its release."""
    action, *others = recording.actions
    path = recording.picker_paths[action.pickers[0]]
    held = [
        n for n in range(action.first_frame, action.last_frame)
        if path.closed_at(recording.frames[n].time_s)
    ]  # fmt: skip
    place = held[int(len(held) * rng.uniform(0.4, 0.6))]
    cut = {"first_frame": place} if rng.random() < 0.5 else {"last_frame": place}
    return replace(recording, actions=(replace(action, **cut), *others)), small


def _other_path(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    """Picks at another spot and goes to another place: turned about the middle of the table."""
    angle = rng.uniform(0.7, 2 * np.pi - 0.7)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    paths = {}
    for name, path in recording.picker_paths.items():
        positions = path.positions.copy()
        positions[:, :2] = positions[:, :2] @ turn.T
        paths[name] = replace(path, positions=positions)
    return replace(recording, picker_paths=paths), small


def _soup(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    template = recording.cloth.template
    assert template is not None
    vertices = template.vertices[template.faces].reshape(-1, 3)
    vertices = vertices + rng.uniform(-1e-4, 1e-4, vertices.shape) * rng.uniform(0.0, 1.5)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    cloth = replace(recording.cloth, template=ClothMesh(vertices, faces), held_vertices={})
    return replace(recording, cloth=cloth), small


def _sized(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    factor = float(rng.choice([0.01, 0.1, 10.0, 39.4, 100.0]))
    width, length = recording.cloth.size_m or (0.3, 0.3)
    cloth = replace(recording.cloth, size_m=(width * factor, length * factor))
    return replace(recording, cloth=cloth), small


def _lensed(recording: Recording, small: SmallPictures, rng: np.random.Generator) -> Spoilt:
    camera = recording.cameras[0]
    if rng.random() < 0.5:
        lens = {"cx": camera.cx + rng.uniform(0.06, 0.2) * camera.width * rng.choice([-1, 1])}
    else:
        lens = {"fx": camera.fx * rng.uniform(1.06, 1.3)}
    return replace(recording, cameras=(replace(camera, **lens), *recording.cameras[1:])), small


SENSE_KINDS: tuple[SenseKind, ...] = (
    SenseKind("color turned over", ("color_mirrored",), _flipped),
    SenseKind("color 2 to 8 % of the width beside", ("color_shift",), _shifted),
    SenseKind("color of another size", ("color_scale",), _scaled),
    SenseKind("depth 2 to 8 frames late or early", ("stream_delay",), _delayed),
    SenseKind("depth or color stuck", ("depth_stuck", "color_stuck"), _stuck),
    SenseKind("frames exchanged", ("frame_order",), _shuffled),
    SenseKind("masks 2 to 3 % of the width too small", ("mask_small",), _eroded),
    SenseKind("masks with the tool", ("mask_with_hand",), _with_hand),
    SenseKind("masks with another thing", ("mask_two_parts",), _with_neighbor),
    SenseKind("cloth cut off by the picture", ("cloth_leaves_picture",), _leaves),
    SenseKind("times in ms, us, ns", ("clock_unit",), _clocked),
    SenseKind("a gap in a carry", ("frame_gap",), _gap),
    SenseKind(
        "action without its pick or release", ("action_begins_late", "action_ends_early"),
        _cut_action,
    ),
    SenseKind("path turned about the table's middle", ("picker_moves_nothing",), _other_path),
    SenseKind("template: triangles not joined", ("template_surface",), _soup),
    SenseKind("size that no garment has", ("size_implausible",), _sized),
    SenseKind("cx or fx of another picture", ("principal_point", "focal_ratio"), _lensed),
)  # fmt: skip
"""Each contradicts another sense, or itself."""
