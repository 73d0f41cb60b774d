"""What people get wrong in a recording: one small function for each kind, its strength drawn.

Lengths in pixels are those of a picture that is 640 pixels wide. Where masks are given they were
made of the color picture: what is wrong with the color is wrong with the mask, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from shared.recording_data import CLOSED, RecordingData

Change = Callable[[RecordingData, float, np.random.Generator], None]
"""Changes a copy in place, by a strength."""

COLOR, DEPTH, MASK, TABLE, SIZE, TEMPLATE, PICKER, TWO = (
    "color", "depth", "mask", "table", "size", "template", "picker", "two actions",
)  # fmt: skip
"""What a recording may have, and a kind may need."""


@dataclass(frozen=True)
class Kind:
    """One way to change a recording.

    Attributes:
        name: in rows and tables.
        text: what is changed, for a person.
        low: weakest, in `unit`.
        high: strongest.
        unit: of the strength; empty where nothing is drawn.
        needs: what the recording must have.
        change: does it.
    """

    name: str
    text: str
    low: float
    high: float
    unit: str
    needs: frozenset[str]
    change: Change

    def __call__(
        self, data: RecordingData, rng: np.random.Generator
    ) -> tuple[RecordingData, float]:
        """The changed copy, and how strong the change is."""
        strength = float(rng.uniform(self.low, self.high))
        changed = data.copied()
        self.change(changed, strength, rng)
        return changed, strength


KINDS: list[Kind] = []


def _kind(low: float, high: float, unit: str, *needs: str) -> Callable[[Change], Change]:
    def keep(change: Change) -> Change:
        KINDS.append(made(change, low, high, unit, needs))
        return change

    return keep


def made(change: Change, low: float, high: float, unit: str, needs: Sequence[str]) -> Kind:
    """Return the kind that a function is; its docstring is the kind's sentence."""
    sentence = (change.__doc__ or "").strip().rstrip(".")
    return Kind(change.__name__, sentence, low, high, unit, frozenset(needs), change)


def sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def warped(data: RecordingData, names: tuple[str, ...], moved: np.ndarray) -> None:
    """Send the pixels of pictures elsewhere; from outside comes black, unmeasured, no cloth.

    Args:
        data: to change.
        names: of the pictures.
        moved: 2 x 3, from old pixels to new ones.
    """
    size = (data.camera["width"], data.camera["height"])
    for name in names:
        pictures = getattr(data, name)
        if pictures is None:
            continue
        for number, picture in enumerate(pictures):
            how = cv2.INTER_LINEAR if name == COLOR else cv2.INTER_NEAREST
            source = picture.astype(np.uint8) if name == MASK else picture
            pictures[number] = cv2.warpAffine(source, moved, size, flags=how)


def _shift(columns: float, rows: float) -> np.ndarray:
    return np.array([[1.0, 0.0, columns], [0.0, 1.0, rows]])


def _at(data: RecordingData, share: float) -> int:
    """The frame at a share of what is carried."""
    first, last = data.carried()
    return round(first + share * (last - first))


SEEN = (COLOR, MASK)


# Color


@_kind(1, 1, "", COLOR)
def color_mirrored(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Mirror the color left to right."""
    _each(data, SEEN, lambda pictures: pictures[:, :, ::-1].copy())


@_kind(1, 1, "", COLOR)
def color_flipped(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Turn the color upside down."""
    _each(data, SEEN, lambda pictures: pictures[:, ::-1].copy())


@_kind(5, 20, "degrees", COLOR)
def color_turned(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Turn the color against the depth."""
    middle = (0.5 * data.camera["width"], 0.5 * data.camera["height"])
    warped(data, SEEN, cv2.getRotationMatrix2D(middle, sign(rng) * strength, 1.0))


@_kind(15, 50, "pixels", COLOR)
def color_shifted(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Shift the color against the depth."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    pixels = data.scale * strength
    warped(data, SEEN, _shift(pixels * np.cos(angle), pixels * np.sin(angle)))


@_kind(8, 25, "percent", COLOR)
def color_scaled(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Take the color from a lens with another field of view."""
    middle = (0.5 * data.camera["width"], 0.5 * data.camera["height"])
    warped(data, SEEN, cv2.getRotationMatrix2D(middle, 0.0, 1.0 + sign(rng) * strength / 100.0))


@_kind(3, 8, "frames", COLOR)
def color_late(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Delay the color."""
    _each(data, SEEN, lambda pictures: _late(pictures, round(strength)))


@_kind(20, 70, "percent of the carrying", COLOR)
def color_stuck(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Repeat one color picture from here on."""
    _each(data, SEEN, lambda pictures: _stuck(pictures, _at(data, strength / 100.0)))


# Depth


@_kind(3, 8, "frames", DEPTH)
def depth_late(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Delay the depth."""
    _each(data, (DEPTH,), lambda pictures: _late(pictures, round(strength)))


@_kind(20, 70, "percent of the carrying", DEPTH)
def depth_stuck(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Repeat one depth picture from here on."""
    _each(data, (DEPTH,), lambda pictures: _stuck(pictures, _at(data, strength / 100.0)))


@_kind(1, 3, "powers of ten", DEPTH)
def depth_unit(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State another unit of depth, a power of ten away."""
    data.camera["depth_unit_m"] *= 10.0 ** (sign(rng) * round(strength))


@_kind(4, 15, "percent", DEPTH)
def depth_scaled(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Scale the depth."""
    data.camera["depth_unit_m"] *= 1.0 + sign(rng) * strength / 100.0


@_kind(12, 50, "mm", DEPTH)
def depth_offset(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Add a constant to the depth."""
    _measured(data, lambda depth: depth + sign(rng) * 1e-3 * strength)


@_kind(10, 30, "mm", DEPTH)
def depth_steps(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Measure depth in coarse steps."""
    _measured(data, lambda depth: np.round(depth / (1e-3 * strength)) * 1e-3 * strength)


@_kind(20, 60, "m pixels", DEPTH)
def depth_disparity(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Store disparity in place of depth."""
    _measured(data, lambda depth: strength / np.maximum(depth, 0.05) / 100.0)


@_kind(1, 1, "", DEPTH)
def depth_exchanged(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Exchange near and far."""
    seen = data.depth[data.depth > 0]
    ends = float(np.percentile(seen, 1)) + float(np.percentile(seen, 99))
    _measured(data, lambda depth: ends * data.camera["depth_unit_m"] - depth)


@_kind(45, 85, "percent", DEPTH)
def depth_holes(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Leave large holes in the depth."""
    height, width = data.depth.shape[1:]
    for picture in data.depth:
        coarse = rng.random((max(2, height // 24), max(2, width // 24))).astype(np.float32)
        blobs = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        picture[blobs < np.percentile(blobs, strength)] = 0


@_kind(8, 25, "mm", DEPTH)
def depth_noise(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Add noise far beyond that of a sensor."""
    _measured(data, lambda depth: depth + rng.normal(0.0, 1e-3 * strength, depth.shape))


@_kind(60, 92, "percent kept", DEPTH)
def depth_averaged(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Average the depth over time, as a camera's filter does."""
    kept, mean = strength / 100.0, data.depth[0].astype(np.float64)
    for number, picture in enumerate(data.depth):
        seen = picture > 0
        mean = np.where(seen, kept * mean + (1.0 - kept) * picture, mean)
        data.depth[number] = np.round(mean)


@_kind(1, 1, "", DEPTH)
def depth_mirrored(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Mirror the depth left to right."""
    _each(data, (DEPTH,), lambda pictures: pictures[:, :, ::-1].copy())


@_kind(12, 45, "pixels", DEPTH)
def depth_unregistered(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Leave the depth unregistered to the color."""
    warped(data, (DEPTH,), _shift(sign(rng) * data.scale * strength, rng.normal(0.0, 3.0)))


@_kind(1, 1, "", DEPTH)
def depth_along_ray(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Store the distance along the ray in place of depth."""
    camera = data.camera
    rows, columns = np.mgrid[: camera["height"], : camera["width"]]
    x, y = (columns - camera["cx"]) / camera["fx"], (rows - camera["cy"]) / camera["fy"]
    _measured(data, lambda depth: depth * np.sqrt(1.0 + x**2 + y**2))


# Intrinsics


@_kind(8, 30, "percent", DEPTH)
def focal(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a focal length that is too large or too small."""
    factor = (1.0 + strength / 100.0) ** sign(rng)
    data.camera["fx"], data.camera["fy"] = data.camera["fx"] * factor, data.camera["fy"] * factor


@_kind(6, 25, "percent", DEPTH)
def focal_x(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a wrong fx alone."""
    data.camera["fx"] *= (1.0 + strength / 100.0) ** sign(rng)


@_kind(6, 25, "percent", DEPTH)
def focal_y(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a wrong fy alone."""
    data.camera["fy"] *= (1.0 + strength / 100.0) ** sign(rng)


@_kind(15, 60, "pixels", DEPTH)
def center_x(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a wrong cx."""
    data.camera["cx"] += sign(rng) * data.scale * strength


@_kind(15, 60, "pixels", DEPTH)
def center_y(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a wrong cy."""
    data.camera["cy"] += sign(rng) * data.scale * strength


@_kind(1.2, 2.2, "times", DEPTH)
def other_stream(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State the intrinsics of a stream of another size."""
    factor = strength ** sign(rng)
    camera = data.camera
    for name in ("fx", "fy", "cx", "cy"):
        camera[name] *= factor
    # A center outside the picture is refused at once; people keep the middle then.
    if not (camera["cx"] < camera["width"] and camera["cy"] < camera["height"]):
        camera["cx"], camera["cy"] = 0.5 * camera["width"], 0.5 * camera["height"]


@_kind(0.08, 0.3, "k1", DEPTH)
def distortion(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Leave the lens's distortion in the pictures."""
    camera = data.camera
    rows, columns = np.mgrid[: camera["height"], : camera["width"]].astype(np.float32)
    x, y = (columns - camera["cx"]) / camera["fx"], (rows - camera["cy"]) / camera["fy"]
    # Barrel: a pixel shows what lies farther from the middle.
    grown = 1.0 + strength * (x**2 + y**2)
    maps = [(camera["fx"] * x * grown + camera["cx"]).astype(np.float32),
            (camera["fy"] * y * grown + camera["cy"]).astype(np.float32)]  # fmt: skip
    for name in (COLOR, DEPTH, MASK):
        pictures = getattr(data, name)
        for number, picture in enumerate(() if pictures is None else pictures):
            source = picture.astype(np.uint8) if name == MASK else picture
            pictures[number] = cv2.remap(source, *maps, cv2.INTER_NEAREST)


# Camera pose and table


@_kind(2.5, 12, "degrees", DEPTH)
def pose_tilted(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Tilt the camera's pose."""
    axis = rng.normal(size=2)
    data.pose = data.pose @ _turned([*axis / np.linalg.norm(axis), 0.0], strength)


@_kind(4, 25, "degrees", DEPTH)
def pose_turned(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Turn the camera's pose about the vertical."""
    data.pose = _turned([0.0, 0.0, 1.0], sign(rng) * strength) @ data.pose


@_kind(15, 80, "mm", DEPTH)
def pose_beside(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Move the camera's pose sideways."""
    angle, pose = rng.uniform(0.0, 2.0 * np.pi), data.pose
    pose[:2, 3] += 1e-3 * strength * np.array([np.cos(angle), np.sin(angle)])
    data.pose = pose


@_kind(12, 80, "mm", DEPTH)
def pose_raised(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a camera that is too high or too low."""
    pose = data.pose
    pose[2, 3] += sign(rng) * 1e-3 * strength
    data.pose = pose


@_kind(1, 1, "", DEPTH)
def pose_inverted(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Invert the camera's pose."""
    data.pose = np.linalg.inv(data.pose)


@_kind(1, 1, "", DEPTH)
def pose_opengl(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State the camera's pose with y up and z backward (OpenGL)."""
    data.pose = data.pose @ np.diag([1.0, -1.0, -1.0, 1.0])


@_kind(10, 40, "pixels", DEPTH)
def camera_pushed(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Push the camera during the film."""
    angle, since = rng.uniform(0.0, 2.0 * np.pi), _at(data, 0.5)
    moved = _shift(*(data.scale * strength * np.array([np.cos(angle), np.sin(angle)])))
    later = RecordingData(
        data.document,
        *(None if p is None else p[since:] for p in (data.color, data.depth, data.mask)),
    )
    warped(later, (COLOR, DEPTH, MASK), moved)


@_kind(12, 60, "mm", TABLE)
def table_height(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a table that is too high or too low."""
    data.document["table"]["point"][2] += sign(rng) * 1e-3 * strength


@_kind(2.5, 10, "degrees", TABLE)
def table_tilted(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Tilt the stated table."""
    axis = rng.normal(size=2)
    turn = _turned([*axis / np.linalg.norm(axis), 0.0], strength)[:3, :3]
    data.document["table"]["normal"] = (turn @ data.document["table"]["normal"]).tolist()


# Picker


@_kind(1, 1, "", PICKER)
def picker_in_camera(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State the picker's path in the camera's frame."""
    inverse = np.linalg.inv(data.pose)
    _paths(data, lambda tips: tips @ inverse[:3, :3].T + inverse[:3, 3])


@_kind(0, 4, "number of the unit", PICKER)
def picker_unit(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """State the picker's path in inches, feet, centimeters or millimeters."""
    factor = (1.0 / 0.0254, 1.0 / 0.3048, 1e2, 1e3)[min(int(strength), 3)]
    _paths(data, lambda tips: tips * factor)


@_kind(1, 1, "", PICKER)
def picker_mirrored(data: RecordingData, _: float, rng: np.random.Generator) -> None:
    """Mirror the picker's path."""
    axis = int(rng.integers(2))
    _paths(data, lambda tips: tips * np.where(np.arange(3) == axis, -1.0, 1.0))


@_kind(1, 1, "", PICKER)
def picker_axes(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Exchange the picker's x and y."""
    _paths(data, lambda tips: tips[:, [1, 0, 2]])


@_kind(30, 120, "mm", PICKER)
def picker_beside(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Move the picker's path sideways."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    beside = 1e-3 * strength * np.array([np.cos(angle), np.sin(angle), 0.0])
    _paths(data, lambda tips: tips + beside)


@_kind(40, 150, "mm", PICKER)
def picker_high(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Raise the picker's path."""
    _paths(data, lambda tips: tips + (0.0, 0.0, 1e-3 * strength))


@_kind(0.3, 0.8, "s", PICKER)
def picker_clock(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Shift the picker's clock."""
    late = sign(rng) * strength
    for name, samples in data.picker.items():
        first, last = samples[:1].copy(), samples[-1:].copy()
        samples[:, 0] += late
        # The path goes on at rest, so that it covers the actions.
        data.picker[name] = np.concatenate([first, samples] if late > 0 else [samples, last])


@_kind(1, 1, "", PICKER)
def picker_milliseconds(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State the picker's times in milliseconds."""
    for samples in data.picker.values():
        samples[:, 0] *= 1e3


@_kind(10, 60, "percent of the carrying", PICKER)
def picker_stuck(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Repeat one place of the picker from here on."""
    since = data.times[_at(data, strength / 100.0)]
    for samples in data.picker.values():
        late = samples[:, 0] > since
        if late.any() and not late.all():
            samples[late, 1:4] = samples[~late][-1, 1:4]


@_kind(1, 1, "", PICKER)
def picker_inverted(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State the picker open where it is closed."""
    for samples in data.picker.values():
        samples[:, CLOSED] = 1 - samples[:, CLOSED]


@_kind(1, 1, "", PICKER)
def picker_open(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State a picker that never closes."""
    for samples in data.picker.values():
        samples[:, CLOSED] = 0


@_kind(1, 1, "", PICKER)
def pick_for_place(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Exchange pick and place."""
    for samples in data.picker.values():
        for first, last in _grips(samples):
            samples[first : last + 1, 1:4] = samples[first : last + 1, 1:4][::-1].copy()


@_kind(60, 200, "mm", PICKER)
def place_wrong(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Click the place at a wrong spot."""
    _clicked(data, strength, rng, lambda share: share)


@_kind(60, 200, "mm", PICKER)
def pick_wrong(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Click the pick at a wrong spot of the cloth."""
    _clicked(data, strength, rng, lambda share: 1.0 - share)


# Actions


@_kind(15, 60, "percent of the carrying", PICKER)
def action_late(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Begin the action after the pick."""
    data.document["actions"][0]["first_frame"] = _at(data, strength / 100.0)


@_kind(30, 75, "percent of the carrying", PICKER)
def action_short(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """End the action in mid-carry."""
    data.document["actions"][0]["last_frame"] = _at(data, strength / 100.0)
    del data.document["actions"][1:]


@_kind(1, 1, "", TWO)
def actions_joined(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State two actions as one."""
    first, *_rest, last = data.document["actions"]
    data.document["actions"] = [{**first, "last_frame": last["last_frame"]}]


@_kind(1, 1, "", TWO)
def action_missing(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Leave the second action out."""
    del data.document["actions"][1:]


# Masks


@_kind(10, 30, "pixels", MASK)
def mask_small(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Draw the mask too small all round."""
    _morphed(data, cv2.MORPH_ERODE, strength)


@_kind(10, 35, "pixels", MASK)
def mask_large(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Draw the mask too large all round."""
    _morphed(data, cv2.MORPH_DILATE, strength)


@_kind(1, 1, "", MASK, "hand")
def mask_with_hand(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Include the hand in the mask."""
    # Skin, and nothing else in these films, is this much redder than blue and green.
    red, green, blue = (data.color[..., k].astype(int) for k in range(3))
    skin = (red - green > 28) & (red - blue > 40) & (green > 60)
    for number in range(data.count):
        opened = cv2.morphologyEx(skin[number].astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5)))
        data.mask[number] |= opened > 0


@_kind(60, 160, "pixels", MASK)
def mask_with_neighbor(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Include a neighbor of the cloth in the mask."""
    row, column = _rim(data.mask[0], rng)
    size = round(data.scale * strength)
    for mask in data.mask:
        cv2.circle(view := mask.astype(np.uint8), (column, row), size // 2, 1, -1)
        mask[:] = view > 0


@_kind(60, 160, "pixels", MASK)
def mask_of_another(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Mask another object."""
    size = round(data.scale * strength)
    away = cv2.distanceTransform((~data.mask[0]).astype(np.uint8), cv2.DIST_L2, 3)
    away[:size], away[-size:], away[:, :size], away[:, -size:] = 0, 0, 0, 0
    row, column = np.unravel_index(int(away.argmax()), away.shape)
    data.mask[:] = False
    data.mask[:, row - size // 2 : row + size // 2, column - size // 2 : column + size // 2] = True


@_kind(15, 50, "percent", MASK)
def mask_cut(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Leave one side of the cloth out of the mask."""
    rows, columns = np.nonzero(data.mask[0])
    angle = rng.uniform(0.0, 2.0 * np.pi)
    grid = np.mgrid[: data.camera["height"], : data.camera["width"]]
    along = np.cos(angle) * grid[0] + np.sin(angle) * grid[1]
    data.mask &= along > np.percentile(along[rows, columns], strength)


@_kind(1, 1, "", MASK)
def mask_stuck(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Repeat the first mask in all frames."""
    data.mask[:] = data.mask[0]


@_kind(1, 1, "", MASK)
def mask_inverted(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Invert the mask."""
    data.mask[:] = ~data.mask


# Cloth and template


@_kind(10, 35, "percent", SIZE)
def size_wrong(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a wrong size of the cloth."""
    sides, factor = data.document["cloth"]["size_m"], 1.0 + sign(rng) * strength / 100.0
    which = rng.integers(3)
    data.document["cloth"]["size_m"] = [
        side * (factor if which in (k, 2) else 1.0) for k, side in enumerate(sides)
    ]


@_kind(1, 1, "", SIZE)
def kind_wrong(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Name another garment."""
    cloth = data.document["cloth"]
    cloth["kind"] = "tshirt" if cloth["kind"] == "towel" else "towel"


@_kind(6, 35, "percent", TEMPLATE)
def template_scaled(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Scale the template."""
    middle = data.vertices.mean(axis=0) * (1.0, 1.0, 0.0)
    data.vertices = middle + (data.vertices - middle) * (1.0 + sign(rng) * strength / 100.0)


@_kind(12, 50, "mm", TEMPLATE)
def template_beside(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Lay the template beside the cloth."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    data.vertices = data.vertices + 1e-3 * strength * np.array([np.cos(angle), np.sin(angle), 0.0])


@_kind(12, 40, "degrees", TEMPLATE)
def template_turned(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Turn the template."""
    middle = data.vertices.mean(axis=0)
    turn = _turned([0.0, 0.0, 1.0], sign(rng) * strength)[:3, :3]
    data.vertices = middle + (data.vertices - middle) @ turn.T


@_kind(1, 1, "", TEMPLATE, "oblong")
def template_mirrored(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Turn the template over its diagonal."""
    middle = data.vertices.mean(axis=0)
    data.vertices = middle + (data.vertices - middle)[:, [1, 0, 2]]


@_kind(0.1, 1.0, "mm", TEMPLATE)
def template_soup(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Give each triangle of the template its own corners, with jitter."""
    corners = data.faces.ravel()
    jitter = rng.normal(0.0, 1e-3 * strength, (len(corners), 3))
    data.vertices = data.vertices[corners] + jitter
    data.canonical = None if data.canonical is None else data.canonical[corners]
    data.faces = np.arange(len(corners)).reshape(-1, 3)


@_kind(12, 45, "percent", TEMPLATE)
def template_cut(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Cut one side off the template."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    along = data.vertices[:, :2] @ np.array([np.cos(angle), np.sin(angle)])
    _keep_vertices(data, along > np.percentile(along, strength))


@_kind(1, 1, "", TEMPLATE)
def template_of_another(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Give the template of another garment, a cross."""
    # A cross in the cloth's bounding box is as little a towel as a shirt's outline is.
    low, high = data.vertices[:, :2].min(axis=0), data.vertices[:, :2].max(axis=0)
    share = np.abs(2.0 * (data.vertices[:, :2] - low) / (high - low) - 1.0)
    _keep_vertices(data, share.min(axis=1) < 0.4)


# Time


@_kind(40, 100, "percent", PICKER)
def frames_shuffled(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Shuffle frames in the middle."""
    first, last = data.carried()
    inside = np.arange(first, last + 1)
    chosen = np.sort(rng.choice(inside, max(3, int(len(inside) * strength / 100)), replace=False))
    order = np.arange(data.count)
    order[chosen] = np.roll(rng.permutation(chosen), 1)
    _each(data, (COLOR, DEPTH, MASK), lambda pictures: pictures[order])
    data.clouds = [data.clouds[k] for k in order] if data.clouds else []


@_kind(1, 1, "", PICKER)
def frames_reversed(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Run the film backwards."""
    _each(data, (COLOR, DEPTH, MASK), lambda pictures: pictures[::-1].copy())
    data.clouds = data.clouds[::-1]
    data.moments = data.moments[::-1].copy()


@_kind(25, 60, "percent", PICKER)
def frames_dropped(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Drop frames, and time the rest as if none were missing."""
    times = data.times
    kept = max(6, round(data.count * (1.0 - strength / 100.0)))
    chosen = np.sort(rng.choice(np.arange(1, data.count - 1), kept - 2, replace=False))
    data.take(np.array([0, *chosen, data.count - 1]))
    data.times = times[: data.count]


@_kind(50, 100, "percent of the carrying", PICKER)
def frames_gap(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Leave a gap in the film."""
    first, last = data.carried()
    missing = round((last - first + 1) * strength / 100.0)
    begun = first + (last - first + 1 - missing) // 2
    frames = np.arange(data.count)
    data.take(frames[(frames < begun) | (frames >= begun + missing)])


@_kind(30, 100, "percent", PICKER)
def frames_repeated(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Repeat pictures, so that they fall behind the clock."""
    steps = np.where(rng.random(data.count) < strength / 200.0, 0, 1)
    order = np.minimum(np.cumsum(steps), data.count - 1)
    _each(data, (COLOR, DEPTH, MASK), lambda pictures: pictures[order])
    data.clouds = [data.clouds[k] for k in order] if data.clouds else []


@_kind(1, 1, "", PICKER)
def all_milliseconds(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """State all times in milliseconds."""
    data.times = 1e3 * data.times
    picker_milliseconds(data, 1.0, np.random.default_rng(0))


@_kind(1.3, 2.5, "times", PICKER)
def rate_wrong(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """State a wrong frame rate beside a right clock of the picker."""
    data.times = data.times * strength ** sign(rng)
    last = data.times[-1]
    for name, samples in data.picker.items():
        if samples[-1, 0] < last:
            rest = samples[-1:].copy()
            rest[0, 0] = last + 0.01
            data.picker[name] = np.concatenate([samples, rest])


# Scene


@_kind(15, 45, "percent", DEPTH)
def cloth_outside(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Let the cloth leave the picture."""
    low, high = _box(data)
    axis, far = int(rng.integers(2)), bool(rng.integers(2))
    at = round(low[axis] + (high[axis] - low[axis]) * strength / 100.0)
    if far:
        at = round(high[axis] - (high[axis] - low[axis]) * strength / 100.0)
    top_left, bottom_right = [0, 0], [data.camera["width"], data.camera["height"]]
    (bottom_right if far else top_left)[axis] = at
    cropped(data, top_left, bottom_right)


@_kind(90, 200, "pixels", DEPTH, COLOR)
def second_cloth(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Lay a second cloth of the same color beside the first."""
    low, high = _box(data)
    size = round(data.scale * strength)
    column = int(high[0] - 0.2 * size) if rng.integers(2) else int(low[0] - 0.8 * size)
    row = int(rng.uniform(low[1], max(low[1] + 1, high[1] - size)))
    area = np.s_[:, max(row, 0) : row + size, max(column, 0) : max(column + size, 1)]
    middle = np.mean([low, high], axis=0).astype(int)
    own = data.color[0, middle[1], middle[0]]
    grain = rng.normal(0.0, 4.0, data.color[area].shape)
    # It lies over the first one, half a centimeter high.
    data.color[area] = np.clip(own + grain, 0, 255)
    data.depth[area] = np.where(data.depth[area] > 0, _lifted(data)[area[1:]], 0)
    if data.mask is not None:
        data.mask[area] = True


@_kind(60, 140, "pixels", DEPTH, COLOR)
def another_arm(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Hold another arm over the cloth."""
    low, high = _box(data)
    middle = rng.uniform(0.7 * low + 0.3 * high, 0.3 * low + 0.7 * high)
    angle, width = rng.uniform(0.0, 2.0 * np.pi), round(data.scale * strength)
    since = _at(data, float(rng.uniform(0.0, 0.8)))
    end = middle + 2.0 * data.camera["width"] * np.array([np.cos(angle), np.sin(angle)])
    canvas = np.zeros(data.depth.shape[1:], np.uint8)
    cv2.line(canvas, tuple(middle.astype(int).tolist()), tuple(end.astype(int).tolist()), 1, width)
    arm = canvas > 0
    data.color[since:, arm] = (120, 118, 122)
    data.depth[since:, arm] = round(0.85 * float(np.median(data.depth[0][data.depth[0] > 0])))
    if data.mask is not None:
        data.mask[since:, arm] = False


# What several kinds use


def cropped(data: RecordingData, top_left: list[int], bottom_right: list[int]) -> None:
    """Cut all pictures; the intrinsics go with them."""
    (left, top), (right, bottom) = top_left, bottom_right
    _each(data, (COLOR, DEPTH, MASK), lambda p: p[:, top:bottom, left:right].copy())
    camera = data.camera
    camera["width"], camera["height"] = right - left, bottom - top
    camera["cx"], camera["cy"] = camera["cx"] - left, camera["cy"] - top


def true_pixels(data: RecordingData, moment: int) -> np.ndarray:
    """Columns and rows (n, 2) of the true vertices."""
    local = (data.truth[moment] - data.pose[:3, 3]) @ data.pose[:3, :3]
    camera = data.camera
    scaled = local[:, :2] / local[:, 2:] * (camera["fx"], camera["fy"])
    return scaled + (camera["cx"], camera["cy"])


def _box(data: RecordingData) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest column and row of the true cloth in the first frame."""
    pixels = true_pixels(data, int(data.moments[0]))
    return pixels.min(axis=0), pixels.max(axis=0)


def _lifted(data: RecordingData) -> np.ndarray:
    """Depth of what lies 5 mm over the highest of the first frame's table, in units."""
    smooth = cv2.medianBlur(data.depth[0], 5)
    return (smooth - 0.005 / data.camera["depth_unit_m"]).astype(np.uint16)


def _each(
    data: RecordingData, names: tuple[str, ...], change: Callable[[np.ndarray], np.ndarray]
) -> None:
    for name in names:
        if getattr(data, name) is not None:
            setattr(data, name, change(getattr(data, name)))


def _late(pictures: np.ndarray, frames: int) -> np.ndarray:
    return pictures[np.maximum(np.arange(len(pictures)) - frames, 0)]


def _stuck(pictures: np.ndarray, since: int) -> np.ndarray:
    return pictures[np.minimum(np.arange(len(pictures)), since)]


def _measured(data: RecordingData, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change measured depth, in meters; what has none keeps none."""
    unit = data.camera["depth_unit_m"]
    changed = np.round(change(data.depth * unit) / unit)
    data.depth = np.where(data.depth > 0, np.clip(changed, 0, 65535), 0).astype(np.uint16)


def _turned(axis: list[float], degrees: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.array(axis))[0]
    return turn


def _paths(data: RecordingData, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for samples in data.picker.values():
        samples[:, 1:4] = change(samples[:, 1:4])


def _grips(samples: np.ndarray) -> list[tuple[int, int]]:
    """First sample of each grip, and the one at which it opens."""
    closed = samples[:, CLOSED] > 0
    first = np.flatnonzero(closed & ~np.concatenate([[False], closed[:-1]]))
    last = np.flatnonzero(closed & ~np.concatenate([closed[1:], [False]]))
    return [(int(a), min(int(b) + 1, len(samples) - 1)) for a, b in zip(first, last, strict=True)]


def _clicked(
    data: RecordingData,
    strength: float,
    rng: np.random.Generator,
    share_of: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Move one end of a grip towards the middle of the cloth and aside, the rest in proportion."""
    middle = data.truth[data.moments[0]].mean(axis=0)
    for samples in data.picker.values():
        for first, last in _grips(samples):
            rows = slice(first, last + 1)
            share = share_of(np.linspace(0.0, 1.0, last + 1 - first))
            end = samples[rows][int(share.argmax()), 1:3]
            inwards = (middle[:2] - end) / max(float(np.linalg.norm(middle[:2] - end)), 1e-3)
            angle = rng.uniform(-1.0, 1.0)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            samples[rows, 1:3] += 1e-3 * strength * share[:, None] * (turn @ inwards)


def _morphed(data: RecordingData, how: int, pixels: float) -> None:
    size = 2 * round(data.scale * pixels) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    for number, mask in enumerate(data.mask):
        data.mask[number] = cv2.morphologyEx(mask.astype(np.uint8), how, disc) > 0


def _rim(mask: np.ndarray, rng: np.random.Generator) -> tuple[int, int]:
    """A random pixel of the mask's rim."""
    inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    rows, columns = np.nonzero(mask & ~inside)
    chosen = int(rng.integers(len(rows)))
    return int(rows[chosen]), int(columns[chosen])


def _keep_vertices(data: RecordingData, kept: np.ndarray) -> None:
    faces = data.faces[kept[data.faces].all(axis=1)]
    used = np.unique(faces)
    number = np.full(len(data.vertices), -1)
    number[used] = np.arange(len(used))
    data.vertices, data.faces = data.vertices[used], number[faces]
    data.canonical = None if data.canonical is None else data.canonical[used]
