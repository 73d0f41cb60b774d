"""What people get wrong in a recording, and what changes it without harm, by a drawn strength.

Lengths in pixels are those of a picture that is 640 pixels wide. Where masks are given they were
made of the color picture: what is wrong with the color is wrong with the mask, too.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from shared.recording_data import CLOSED, PICTURES, RecordingData

Rng = np.random.Generator
Change = Callable[[RecordingData, float, Rng], object]
MASK, TEMPLATE, SEEN = "mask", "template", ("color", "mask")


@dataclass(frozen=True)
class Kind:
    """One way to change a recording; it is done in place, by a strength drawn in a unit.

    Attributes:
        text: what is changed, for a person.
        needs: what a recording may lack.
    """

    name: str
    text: str
    change: Change
    low: float = 1.0
    high: float = 1.0
    unit: str = ""
    needs: str = ""

    def __call__(self, data: RecordingData, rng: Rng) -> tuple[RecordingData, float]:
        """Return the changed copy, and how strong the change is."""
        strength = float(rng.uniform(self.low, self.high))
        changed = data.copied()
        self.change(changed, strength, rng)
        return changed, strength


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _aside(length: float, rng: Rng) -> np.ndarray:
    """A horizontal vector (3,) of this length in a random direction."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return length * np.array([np.cos(angle), np.sin(angle), 0.0])


def _turned(axis: np.ndarray, degrees: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.asarray(axis, np.float64))[0]
    return turn


def _pictures(change: Callable[[np.ndarray], np.ndarray], *names: str) -> Change:
    def changed(data: RecordingData, _: float, __: Rng) -> None:
        for name in names:
            if getattr(data, name) is not None:
                setattr(data, name, change(getattr(data, name)).copy())

    return changed


def _stuck(*names: str) -> Change:
    return lambda data, percent, _: data.reordered(
        np.minimum(np.arange(data.count), _at(data, percent)), names
    )


def _at(data: RecordingData, percent: float) -> int:
    """Frame at a percentage of what is carried."""
    first, last = data.carried()
    return round(first + 0.01 * percent * (last - first))


def _intrinsics(*names: str) -> Change:
    def scaled(data: RecordingData, percent: float, rng: Rng) -> None:
        factor = (1.0 + percent / 100.0) ** _sign(rng)
        for name in names:
            data.camera[name] *= factor
        # A center outside the picture is refused at once; people keep the middle then.
        for name, size in (("cx", "width"), ("cy", "height")):
            data.camera[name] = min(data.camera[name], data.camera[size] - 1.0)

    return scaled


def _center(data: RecordingData, pixels: float, rng: Rng) -> None:
    data.camera[rng.choice(["cx", "cy"])] += _sign(rng) * data.scale * pixels


def _unit(data: RecordingData, _: float, rng: Rng) -> None:
    data.camera["depth_unit_m"] *= float(rng.choice([4.0, 10.0, 1000.0])) ** _sign(rng)


def _offset(data: RecordingData, mm: float, rng: Rng) -> None:
    changed = data.depth + 1e-3 * mm * _sign(rng) / data.camera["depth_unit_m"]
    data.depth = np.where(data.depth > 0, changed.round().clip(0, 65535), 0).astype(np.uint16)


def _tilted(data: RecordingData, degrees: float, rng: Rng) -> None:
    data.pose = data.pose @ _turned(_aside(1.0, rng), degrees)


def _moved(data: RecordingData, mm: float, rng: Rng) -> None:
    away = _aside(mm, rng) if rng.integers(2) else np.array([0.0, 0.0, _sign(rng) * mm])
    pose = data.pose
    pose[:3, 3] += 1e-3 * away
    data.pose = pose


def _inverted(data: RecordingData, _: float, __: Rng) -> None:
    data.pose = np.linalg.inv(data.pose)


def _pushed(data: RecordingData, pixels: float, rng: Rng) -> None:
    columns, rows, _ = _aside(data.scale * pixels, rng)
    moved = np.array([[1.0, 0.0, columns], [0.0, 1.0, rows]])
    for name in PICTURES:
        pictures = getattr(data, name)
        for number in range(_at(data, 50.0), data.count if pictures is not None else 0):
            picture = pictures[number].astype(np.uint8) if name == MASK else pictures[number]
            size = picture.shape[1::-1]
            pictures[number] = cv2.warpAffine(picture, moved, size, flags=cv2.INTER_NEAREST)


def _paths(change: Callable[[np.ndarray, RecordingData, float, Rng], np.ndarray]) -> Change:
    def changed(data: RecordingData, strength: float, rng: Rng) -> None:
        seed = int(rng.integers(2**32))
        for samples in data.picker.values():
            own = np.random.default_rng(seed)
            samples[:, 1:4] = change(samples[:, 1:4], data, strength, own)

    return changed


def _clock(data: RecordingData, seconds: float, rng: Rng) -> None:
    late = _sign(rng) * seconds
    for name, samples in data.picker.items():
        first, last = samples[:1].copy(), samples[-1:].copy()
        samples[:, 0] += late
        # The path goes on at rest, so that it covers the actions.
        data.picker[name] = np.concatenate([first, samples] if late > 0 else [samples, last])


def _clicked(*, place: bool) -> Change:
    """Move one end of each grip aside, the rest in proportion."""

    def moved(data: RecordingData, mm: float, rng: Rng) -> None:
        for samples in data.picker.values():
            closed = np.flatnonzero(samples[:, CLOSED] > 0)
            for grip in np.split(closed, np.flatnonzero(np.diff(closed) > 1) + 1):
                share = np.linspace(0.0, 1.0, len(grip))[:: 1 if place else -1, None]
                samples[grip, 1:4] += 1e-3 * share * _aside(mm, rng)

    return moved


def _cut(data: RecordingData, percent: float, rng: Rng) -> None:
    rows, columns = np.nonzero(data.mask[0])
    grid, way = np.mgrid[: data.camera["height"], : data.camera["width"]], _aside(1.0, rng)
    along = way[0] * grid[0] + way[1] * grid[1]
    data.mask &= along > np.percentile(along[rows, columns], percent)


def _size(data: RecordingData, percent: float, rng: Rng) -> None:
    cloth, factor = data.document["cloth"], 1.0 + _sign(rng) * percent / 100.0
    if data.vertices is None:
        cloth["size_m"] = [factor * side for side in cloth["size_m"]]
    else:
        middle = data.vertices.mean(axis=0) * (1.0, 1.0, 0.0)
        data.vertices = middle + (data.vertices - middle) * factor


def _garment(data: RecordingData, _: float, __: Rng) -> None:
    cloth = data.document["cloth"]
    cloth["kind"] = "tshirt" if cloth["kind"] == "towel" else "towel"


def _cross(data: RecordingData, _: float, __: Rng) -> None:
    # A cross in the cloth's bounding box is as little a towel as a shirt's outline is.
    low, high = data.vertices[:, :2].min(axis=0), data.vertices[:, :2].max(axis=0)
    kept = np.abs(2.0 * (data.vertices[:, :2] - low) / (high - low) - 1.0).min(axis=1) < 0.4
    faces = data.faces[kept[data.faces].all(axis=1)]
    used, numbers = np.unique(faces, return_inverse=True)
    data.vertices, data.canonical = data.vertices[used], data.canonical[used]
    data.faces = numbers.reshape(-1, 3)


def _shuffled(data: RecordingData, percent: float, rng: Rng) -> None:
    first, last = data.carried()
    inside, order = np.arange(first, last + 1), np.arange(data.count)
    many = max(3, int(len(inside) * percent / 100))
    chosen = np.sort(rng.choice(inside, many, replace=False))
    order[chosen] = np.roll(rng.permutation(chosen), 1)
    data.reordered(order)


def _dropped(data: RecordingData, percent: float, rng: Rng) -> None:
    times, kept = data.times, max(6, round(data.count * (1.0 - percent / 100.0)))
    chosen = np.sort(rng.choice(np.arange(1, data.count - 1), kept - 2, replace=False))
    data.take(np.array([0, *chosen, data.count - 1]))
    data.times = times[: data.count]


def _paused(data: RecordingData, seconds: float, _: Rng) -> None:
    late = np.arange(data.count) >= _at(data, 50.0)
    data.times = data.times + seconds * late
    for name, samples in data.picker.items():
        rest = samples[-1:].copy()
        rest[0, 0] = data.times[-1] + 0.01
        data.picker[name] = np.concatenate([samples, rest])


WRONG = (
    Kind("color_mirrored", "Mirror the color left to right",
         _pictures(lambda one: one[:, :, ::-1], *SEEN)),
    Kind("color_flipped", "Turn the color upside down", _pictures(lambda one: one[:, ::-1], *SEEN)),
    Kind("color_stuck", "Repeat one color picture", _stuck(*SEEN), 20, 70, "% of the carrying"),
    Kind("depth_unit", "State depth in another unit, 4, 10 or 1000 times", _unit),
    Kind("depth_offset", "Add a constant to the depth", _offset, 12, 50, "mm"),
    Kind("focal", "State a wrong focal length", _intrinsics("fx", "fy"), 8, 30, "%"),
    Kind("focal_doubled", "Halve or double the focal length", _intrinsics("fx", "fy"), 100, 100),
    Kind("center", "State a wrong principal point", _center, 15, 60, "pixels"),
    Kind("other_stream", "State the intrinsics of a stream of another size",
         _intrinsics("fx", "fy", "cx", "cy"), 20, 120, "%"),
    Kind("pose_tilted", "Tilt the camera's pose", _tilted, 2.5, 12, "degrees"),
    Kind("pose_moved", "Move the camera's pose", _moved, 15, 80, "mm"),
    Kind("pose_inverted", "Invert the camera's pose", _inverted),
    Kind("camera_pushed", "Push the camera during the film", _pushed, 10, 40, "pixels"),
    Kind("picker_unit", "State the path in feet, centimeters or millimeters",
         _paths(lambda tips, _, __, rng: tips * rng.choice([3.28, 100.0, 1000.0]))),
    Kind("picker_beside", "Move the picker's path sideways",
         _paths(lambda tips, _, mm, rng: tips + _aside(1e-3 * mm, rng)), 30, 120, "mm"),
    Kind("picker_clock", "Shift the picker's clock", _clock, 0.3, 0.8, "s"),
    Kind("place_wrong", "Click the place at a wrong spot", _clicked(place=True), 60, 200, "mm"),
    Kind("pick_wrong", "Click the pick at a wrong spot", _clicked(place=False), 60, 200, "mm"),
    Kind("mask_cut", "Leave one side of the cloth out of the mask", _cut, 15, 50, "%", MASK),
    Kind("mask_stuck", "Repeat the first mask", _stuck(MASK), 0, 0, "", MASK),
    Kind("mask_inverted", "Invert the mask", _pictures(np.logical_not, MASK), needs=MASK),
    Kind("size_wrong", "State a wrong size, or scale the template", _size, 10, 35, "%"),
    Kind("kind_wrong", "Declare a towel as a T-shirt, or a T-shirt as a towel", _garment),
    Kind("template_of_another", "Give the template of another garment", _cross, needs=TEMPLATE),
    Kind("frames_shuffled", "Take frames out of order", _shuffled, 40, 100, "%"),
    Kind("frames_dropped", "Drop frames, and time the rest as if none were missing",
         _dropped, 25, 60, "%"),
    Kind("clock_paused", "Pause the clock of the frames", _paused, 0.4, 1.5, "s"),
)  # fmt: skip


def _noise(data: RecordingData, mm: float, rng: Rng) -> None:
    noisy = data.depth + rng.normal(0.0, 1e-3 * mm / data.camera["depth_unit_m"], data.depth.shape)
    data.depth = np.where(data.depth > 0, noisy.round().clip(0, 65535), 0).astype(np.uint16)


def _bright(data: RecordingData, percent: float, rng: Rng) -> None:
    factor = 1.0 + _sign(rng) * percent / 100.0
    data.color = np.clip(data.color * factor, 0, 255).astype(np.uint8)


def _margin(data: RecordingData, pixels: float, _: Rng) -> None:
    seen = np.concatenate([true_pixels(data, moment) for moment in data.moments])
    margin, size = data.scale * pixels, np.array([data.camera["width"], data.camera["height"]])
    low = np.clip(np.floor(seen.min(axis=0) - margin), 0, size).astype(int)
    high = np.clip(np.ceil(seen.max(axis=0) + margin), 0, size).astype(int)
    cropped(data, low.tolist(), high.tolist())


def _elsewhere(data: RecordingData, meters: float, rng: Rng) -> None:
    turn = _turned(np.array([0.0, 0.0, 1.0]), rng.uniform(0.0, 360.0))
    turn[:3, 3] = meters * rng.uniform(-1.0, 1.0, 3)

    def moved(points: np.ndarray) -> np.ndarray:
        return np.asarray(points, np.float64) @ turn[:3, :3].T + turn[:3, 3]

    data.pose = turn @ data.pose
    data.document["table"]["point"] = moved(data.document["table"]["point"]).tolist()
    for samples in data.picker.values():
        samples[:, 1:4] = moved(samples[:, 1:4])
    data.vertices = None if data.vertices is None else moved(data.vertices)
    # Where the world is moved, the truth moves with it.
    data.truth = moved(data.truth)


HARMLESS = (
    Kind("unchanged", "Change nothing", lambda *_: None),
    Kind("more_noise", "Add as much noise as another sensor has", _noise, 0.3, 1.2, "mm"),
    Kind("brightness", "Make the color brighter or darker", _bright, 5, 20, "%"),
    Kind("crop", "Crop the pictures, so that the cloth keeps a margin", _margin, 10, 40, "pixels"),
    Kind("other_world", "Put the origin of the world elsewhere", _elsewhere, 0.1, 3, "m"),
    Kind("picker_noise", "Measure the picker a little less well",
         _paths(lambda tips, _, mm, rng: tips + rng.normal(0.0, 1e-3 * mm, tips.shape)),
         0.5, 2, "mm"),
)  # fmt: skip


def cropped(data: RecordingData, top_left: list[int], bottom_right: list[int]) -> None:
    """Cut all pictures; the intrinsics go with them."""
    (left, top), (right, bottom) = top_left, bottom_right
    for name in PICTURES:
        if (pictures := getattr(data, name)) is not None:
            setattr(data, name, pictures[:, top:bottom, left:right].copy())
    camera = data.camera
    camera["width"], camera["height"] = right - left, bottom - top
    camera["cx"], camera["cy"] = camera["cx"] - left, camera["cy"] - top


def true_pixels(data: RecordingData, moment: int) -> np.ndarray:
    """Columns and rows (n, 2) of the true vertices."""
    local, camera = (data.truth[moment] - data.pose[:3, 3]) @ data.pose[:3, :3], data.camera
    scaled = local[:, :2] / local[:, 2:] * (camera["fx"], camera["fy"])
    return scaled + (camera["cx"], camera["cy"])
