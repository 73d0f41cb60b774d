"""Changes that leave a recording right: another sensor, another table, another way to store it.

Where the world is moved, the truth moves with it.
"""

from collections.abc import Callable

import cv2
import numpy as np

from shared.recording_data import RecordingData
from shared.wrong_inputs import COLOR, DEPTH, MASK, PICKER, Change, Kind, cropped, made, true_pixels

HARMLESS: list[Kind] = []


def _harmless(low: float, high: float, unit: str, *needs: str) -> Callable[[Change], Change]:
    def keep(change: Change) -> Change:
        HARMLESS.append(made(change, low, high, unit, needs))
        return change

    return keep


@_harmless(1, 1, "")
def unchanged(_: RecordingData, __: float, ___: np.random.Generator) -> None:
    """Change nothing."""


@_harmless(0.3, 1.2, "mm", DEPTH)
def more_noise(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Add as much noise as another sensor has."""
    unit = data.camera["depth_unit_m"]
    noisy = data.depth + rng.normal(0.0, 1e-3 * strength / unit, data.depth.shape)
    data.depth = np.where(data.depth > 0, np.round(noisy).clip(0, 65535), 0).astype(np.uint16)


@_harmless(2, 12, "percent", DEPTH)
def few_holes(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Leave small holes in the depth."""
    for picture in data.depth:
        picture[rng.random(picture.shape) < strength / 100.0] = 0


@_harmless(-20, 20, "percent", COLOR)
def brightness(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Make the color brighter or darker."""
    bright = data.color * (1.0 + strength / 100.0)
    data.color = np.clip(bright, 0, 255).astype(np.uint8)


@_harmless(2, 8, "percent", COLOR)
def white_balance(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Balance the white in another way."""
    tint = 1.0 + strength / 100.0 * rng.uniform(-1.0, 1.0, 3)
    data.color = np.clip(data.color * tint, 0, 255).astype(np.uint8)


@_harmless(10, 40, "pixels", DEPTH)
def crop(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Crop the pictures, so that the cloth keeps a margin."""
    pixels = np.concatenate([true_pixels(data, moment) for moment in data.moments])
    margin = data.scale * strength
    size = np.array([data.camera["width"], data.camera["height"]])
    low = np.clip(np.floor(pixels.min(axis=0) - margin), 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0) + margin), 0, size).astype(int)
    cropped(data, low.tolist(), high.tolist())


@_harmless(1, 1, "", PICKER)
def lower_rate(data: RecordingData, _: float, __: np.random.Generator) -> None:
    """Keep every second frame, with its true time; the ends of actions stay."""
    ends = [a[end] for a in data.document["actions"] for end in ("first_frame", "last_frame")]
    data.take(np.unique([*range(0, data.count, 2), *ends, *data.carried()]))


@_harmless(5, 15, "percent", PICKER)
def few_dropped(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Drop a few frames; the others keep their true times."""
    ends = [a[end] for a in data.document["actions"] for end in ("first_frame", "last_frame")]
    kept = np.flatnonzero(rng.random(data.count) >= strength / 100.0)
    data.take(np.unique([*kept, *ends, *data.carried()]))


@_harmless(1, 1, "", MASK)
def rough_mask(data: RecordingData, _: float, rng: np.random.Generator) -> None:
    """Draw the rim of the mask a pixel beside."""
    for mask in data.mask:
        grown = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        kept = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        mask[:] = kept | (grown & (rng.random(mask.shape) < 0.5))


@_harmless(0.1, 3, "m")
def other_world(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Put the origin of the world elsewhere, turned about the vertical."""
    turn = np.eye(4)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    turn[:3, 3] = strength * rng.uniform(-1.0, 1.0, 3)

    def moved(points: np.ndarray) -> np.ndarray:
        return points @ turn[:3, :3].T + turn[:3, 3]

    for camera in data.document["cameras"]:
        camera["world_from_camera"] = (turn @ np.array(camera["world_from_camera"])).tolist()
    if data.document.get("table"):
        table = data.document["table"]
        table["point"] = moved(np.array(table["point"], np.float64)).tolist()
    lowest = data.document.get("observed", {}).get("lowest_height_m")
    if lowest is not None:
        data.document["observed"]["lowest_height_m"] = lowest + float(turn[2, 3])
    for samples in data.picker.values():
        samples[:, 1:4] = moved(samples[:, 1:4])
    data.clouds = [moved(cloud) for cloud in data.clouds]
    data.vertices = None if data.vertices is None else moved(data.vertices)
    data.truth = None if data.truth is None else moved(data.truth)


@_harmless(1, 1e5, "s")
def other_clock(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Count time from elsewhere, for frames and pickers alike."""
    data.times = data.times + strength
    for samples in data.picker.values():
        samples[:, 0] += strength


@_harmless(2, 8, "parts of a mm", DEPTH)
def finer_unit(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Store depth in a finer unit."""
    parts = round(strength)
    data.depth = (data.depth.astype(np.int64) * parts).clip(0, 65535).astype(np.uint16)
    data.camera["depth_unit_m"] /= parts


@_harmless(0.5, 2, "mm", PICKER)
def picker_noise(data: RecordingData, strength: float, rng: np.random.Generator) -> None:
    """Measure the picker a little less well."""
    for samples in data.picker.values():
        samples[:, 1:4] += rng.normal(0.0, 1e-3 * strength, (len(samples), 3))


@_harmless(2, 5, "samples per frame", PICKER)
def denser_path(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Sample the picker's path more often than the frames."""
    for name, samples in data.picker.items():
        places = np.arange((len(samples) - 1) * round(strength) + 1) / round(strength)
        columns = [np.interp(places, np.arange(len(samples)), c) for c in samples.T]
        columns[4] = samples[np.floor(places).astype(int), 4]
        data.picker[name] = np.column_stack(columns)


@_harmless(1, 1, "", "template")
def other_order(data: RecordingData, _: float, rng: np.random.Generator) -> None:
    """Number the vertices and triangles of the template in another order."""
    order = rng.permutation(len(data.vertices))
    number = np.argsort(order)
    data.vertices = data.vertices[order]
    data.canonical = None if data.canonical is None else data.canonical[order]
    data.faces = rng.permutation(number[data.faces])
    held = data.document["cloth"].get("held_vertices", {})
    for name, vertices in held.items():
        held[name] = number[vertices].tolist()


@_harmless(2, 5, "frames")
def longer_rest(data: RecordingData, strength: float, _: np.random.Generator) -> None:
    """Film the cloth at rest for longer, after the last action."""
    more, step = round(strength), float(np.diff(data.times).mean())
    count, last = data.count, data.document["actions"][-1]["last_frame"]
    frames, times = np.array([*range(count), *[count - 1] * more]), data.times
    data.take(frames)
    data.times = np.concatenate([times, times[-1] + step * np.arange(1, more + 1)])
    data.document["actions"][-1]["last_frame"] = last


@_harmless(1, 1, "")
def other_remarks(data: RecordingData, _: float, rng: np.random.Generator) -> None:
    """Write the fields of recording.json in another order, with remarks."""
    names = list(data.document)
    data.document = {names[k]: data.document[names[k]] for k in rng.permutation(len(names))}
    data.document["provenance"] = {"remark": "filmed by hand", "lamp": "left"}
