"""Speed of imports against the minimal work of decoding and encoding the pictures.

A video of smooth surfaces with a sensor's noise, 640 x 480, is written as each kind of source and
imported. The peer only decodes and encodes the same pictures with OpenCV, at its usual PNG settings
and at ours. CPU times are summed over all threads, so that other work on the machine has little
effect. The ratio is how many times faster the import is than the peer. Frames per second are for
two otherwise idle processors. Reading and writing, which only the first thread does, have their own
column; two processors stay busy as long as it is below one half.

    python benchmarks/bench_import.py --json import.json [--quick]
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from harness import run_benchmark, timed
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from clothtrack.recordings.pictures import encode_png
from clothtrack_capture.importing.import_recording import import_recording

WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
DIFFERENT = 20  # pictures that are made; a film repeats them
STORE = get_typestore(Stores.ROS2_HUMBLE)
PEER_FRAMES = 100


def pictures() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the depth [mm] and color of a waving surface."""
    rng = np.random.default_rng(0)
    x, y = np.linspace(0, 1, WIDTH), np.linspace(0, 1, HEIGHT)[:, None]
    depths, colors = [], []
    for k in range(DIFFERENT):
        depth = 700 + 80 * np.sin(5 * x + 0.3 * k) * np.cos(4 * y)
        depth = (depth + rng.normal(0, 1.5, depth.shape)).astype(np.uint16)
        depth[rng.random(depth.shape) < 0.02] = 0
        shade = np.stack([x * 120 + y * 60, x * y * 200, 80 + 40 * np.sin(9 * x + k) + 0 * y], -1)
        color = (shade + rng.normal(0, 3, shade.shape)).clip(0, 255).astype(np.uint8)
        depths.append(depth)
        colors.append(color)
    return depths, colors


def info(head: object, focal: float) -> object:
    """Intrinsics."""
    region = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([focal, 0, 319.5, 0, focal, 239.5, 0, 0, 1.0])
    return STORE.types["sensor_msgs/msg/CameraInfo"](
        head, HEIGHT, WIDTH, "plumb_bob", np.zeros(5), k, np.eye(3).ravel(),
        np.insert(k, [3, 6, 9], 0.0), 0, 0, region,
    )  # fmt: skip


def entries(frames: int, *, packed: bool, registered: bool) -> Iterator[tuple[str, int, object]]:
    """Yield the messages of a camera."""
    image = STORE.types["sensor_msgs/msg/Image"]
    compressed = STORE.types["sensor_msgs/msg/CompressedImage"]
    stamp = STORE.types["builtin_interfaces/msg/Time"]
    depths, colors = pictures()
    pngs = [np.frombuffer(bytes(12) + encode_png(one), np.uint8) for one in depths]
    for k in range(frames):
        now, one = 10**18 + k * 33_333_333, k % DIFFERENT
        head = STORE.types["std_msgs/msg/Header"](stamp(now // 10**9, now % 10**9), "camera")
        focal = FOCAL if registered else 0.7 * FOCAL
        yield "/camera/depth/camera_info", now, info(head, focal)
        yield "/camera/color/camera_info", now, info(head, FOCAL)
        if packed:
            depth = compressed(head, "16UC1; compressedDepth png", pngs[one])
            shown = compressed(head, "rgb8; jpeg compressed bgr8", jpeg(colors[one]))
            yield "/camera/depth/image_raw/compressedDepth", now, depth
            yield "/camera/color/image_raw/compressed", now, shown
        else:
            data = depths[one].view(np.uint8).ravel()
            depth = image(head, HEIGHT, WIDTH, "16UC1", 0, 2 * WIDTH, data)
            shown = image(head, HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, colors[one].ravel())
            yield "/camera/depth/image_raw", now, depth
            yield "/camera/color/image_raw", now, shown


def jpeg(color: np.ndarray) -> np.ndarray:
    """Return a JPEG of usual quality."""
    return cv2.imencode(".jpg", color[..., ::-1])[1].ravel()


def write_bag(path: Path, frames: int, *, packed: bool = False, registered: bool = True) -> Path:
    """Write a bag of ROS 2 (MCAP)."""
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        known = {}
        for topic, now, message in entries(frames, packed=packed, registered=registered):
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], now, STORE.serialize_cdr(message, kind))
    return path


def write_pngs(path: Path, frames: int) -> Path:
    """Write a folder in Open3D's style."""
    depths, colors = pictures()
    encoded = {"depth": list(map(encode_png, depths)), "color": list(map(encode_png, colors))}
    for name, files in encoded.items():
        (path / name).mkdir(parents=True)
        for k in range(frames):
            (path / name / f"{k:06d}.png").write_bytes(files[k % DIFFERENT])
    matrix = [FOCAL, 0, 0, 0, FOCAL, 0, 319.5, 239.5, 1]
    content = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": matrix, "fps": 30,
               "depth_scale": 1000.0}  # fmt: skip
    (path / "intrinsic.json").write_text(json.dumps(content), encoding="utf-8")
    return path


def coder(depth_form: str, color_form: str, *, usual: bool) -> Callable[[], None]:
    """Return the peer, which only decodes (what the source has packed) and encodes pictures."""
    depths, colors = pictures()
    pack: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "raw": lambda one: one,
        "png": lambda one: np.frombuffer(encode_png(one), np.uint8),
        "jpeg": jpeg,
    }
    packed = [
        [(form, pack[form](one)) for form, one in ((depth_form, depth), (color_form, color))]
        for depth, color in zip(depths, colors, strict=True)
    ]

    def one(k: int) -> None:
        for form, data in packed[k % DIFFERENT]:
            shown = data if form == "raw" else cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
            if usual:
                cv2.imencode(".png", shown)
            else:
                encode_png(shown, by_rows=True)

    def run() -> None:
        with ThreadPoolExecutor(min(os.cpu_count() or 1, 4)) as pool:
            list(pool.map(one, range(PEER_FRAMES)))

    return run


@dataclass(frozen=True)
class Kind:
    """A kind of source: how it is written, and what in it is packed."""

    write: Callable[[Path, int], Path]
    depth_form: str = "raw"
    color_form: str = "raw"


KINDS = {
    "raw topics, ROS 2 MCAP": Kind(write_bag),
    "raw, depth to be registered": Kind(partial(write_bag, registered=False)),
    "compressed topics": Kind(partial(write_bag, packed=True), "png", "jpeg"),
    "PNG folder": Kind(write_pngs, "png", "png"),
}


def compared(name: str, frames: int, folder: Path) -> dict[str, object]:
    """Return one row: the import against the peer."""
    kind, out = KINDS[name], folder / "out"
    source = kind.write(folder / "source", frames)
    start, own = time.process_time(), time.thread_time()
    import_recording(source, out)
    times = time.process_time() - start, time.thread_time() - own
    shutil.rmtree(out)
    shutil.rmtree(source) if source.is_dir() else source.unlink()
    ours, _ = timed(coder(kind.depth_form, kind.color_form, usual=False))
    usual, _ = timed(coder(kind.depth_form, kind.color_form, usual=True))
    each = times[0] / frames
    return {
        "source": name,
        "frames": frames,
        "cpu_ms_per_frame": 1e3 * each,
        "frames_per_s": 2 / each,
        "first_thread_share": times[1] / times[0],
        "ratio_to_coding": ours / PEER_FRAMES / each,
        "ratio_to_usual_coding": usual / PEER_FRAMES / each,
    }


def measure(folder: Path, quick: bool) -> dict[str, object]:
    """Measure every kind of source."""
    cv2.setNumThreads(1)
    # The first import compiles the kernel.
    import_recording(write_bag(folder / "warm", 2, registered=False), folder / "warmed")
    return {"rows": [compared(name, 40 if quick else 1000, folder) for name in KINDS]}


if __name__ == "__main__":
    run_benchmark("import", __doc__, measure)
