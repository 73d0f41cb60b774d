"""How fast recordings are imported, against the least that anybody must do: code the pictures.

A film of smooth surfaces with a sensor's noise, 640 x 480, is written as each kind of source and
imported. The peer decodes and encodes the same pictures with OpenCV and does nothing else: at its
usual PNG settings, and at ours. CPU times of all threads together, so that other work on the
machine counts little; minima. A ratio above 1 says how many times faster the import is than the
peer. Frames per second are for two processors. Memory is the peak above that at the start.

    python benchmarks/bench_import.py --json import.json [--quick]
"""

import argparse
import json
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from results import provenance, write_json
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from clothtrack.geometry.devices import quiet_warp
from clothtrack.recordings.importing.importing import import_recording
from clothtrack.recordings.pictures import encode_png

logger = logging.getLogger("bench_import")
WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
DIFFERENT = 20  # pictures that are made; a film repeats them
STORE = get_typestore(Stores.ROS2_HUMBLE)


def pictures() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Depth [mm] and colour of a waving surface."""
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


def header(time_ns: int) -> object:
    """A stamped header."""
    stamp = STORE.types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](stamp, "camera")


def info(time_ns: int, focal: float) -> object:
    """Intrinsics."""
    region = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([focal, 0, 319.5, 0, focal, 239.5, 0, 0, 1.0])
    return STORE.types["sensor_msgs/msg/CameraInfo"](
        header(time_ns), HEIGHT, WIDTH, "plumb_bob", np.zeros(5), k, np.eye(3).ravel(),
        np.insert(k, [3, 6, 9], 0.0), 0, 0, region,
    )  # fmt: skip


def entries(frames: int, *, packed: bool, registered: bool) -> Iterator[tuple[str, int, object]]:
    """The messages of a camera."""
    image = STORE.types["sensor_msgs/msg/Image"]
    compressed = STORE.types["sensor_msgs/msg/CompressedImage"]
    depths, colors = pictures()
    pngs = [bytes(12) + encode_png(one) for one in depths]
    jpegs = [cv2.imencode(".jpg", one[..., ::-1])[1] for one in colors]
    for k in range(frames):
        now = 10**18 + k * 33_333_333
        yield "/camera/depth/camera_info", now, info(now, FOCAL if registered else 0.7 * FOCAL)
        yield "/camera/color/camera_info", now, info(now, FOCAL)
        one = k % DIFFERENT
        if packed:
            data = np.frombuffer(pngs[one], np.uint8)
            depth = compressed(header(now), "16UC1; compressedDepth png", data)
            color = compressed(header(now), "rgb8; jpeg compressed bgr8", jpegs[one].ravel())
            yield "/camera/depth/image_raw/compressedDepth", now, depth
            yield "/camera/color/image_raw/compressed", now, color
        else:
            data = depths[one].view(np.uint8).ravel()
            shown = colors[one].ravel()
            yield (
                "/camera/depth/image_raw",
                now,
                image(header(now), HEIGHT, WIDTH, "16UC1", 0, 2 * WIDTH, data),
            )
            yield (
                "/camera/color/image_raw",
                now,
                image(header(now), HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, shown),
            )


def write_bag(path: Path, frames: int, *, packed: bool, registered: bool) -> Path:
    """An MCAP bag."""
    storage = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        known = {}
        for topic, now, message in entries(frames, packed=packed, registered=registered):
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], now, STORE.serialize_cdr(message, kind))
    return path


def write_pngs(path: Path, frames: int) -> Path:
    """A folder in Open3D's style."""
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


def coder(frames: int, *, decode: bool, usual: bool) -> Callable[[], None]:
    """The peer: decode (when the source is packed) and encode every picture, nothing else."""
    depths, colors = pictures()
    packed = [(encode_png(d), encode_png(c)) for d, c in zip(depths, colors, strict=True)]

    def one(k: int) -> None:
        shown = (depths[k % DIFFERENT], colors[k % DIFFERENT])
        if decode:
            shown = tuple(
                cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
                for data in packed[k % DIFFERENT]
            )
        for picture in shown:
            if usual:
                cv2.imencode(".png", picture)
            else:
                encode_png(picture)

    def run() -> None:
        with ThreadPoolExecutor(min(os.cpu_count() or 1, 4)) as pool:
            list(pool.map(one, range(frames)))

    return run


def timed(work: Callable[[], object], repeats: int) -> float:
    """Least CPU time of all threads [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def resident_bytes() -> int:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def peak_bytes(work: Callable[[], object]) -> int:
    """Peak memory above that at the start, sampled."""
    start, peak, done = resident_bytes(), [0], threading.Event()

    def watch() -> None:
        while not done.wait(0.02):
            peak[0] = max(peak[0], resident_bytes() - start)

    watcher = threading.Thread(target=watch)
    watcher.start()
    work()
    done.set()
    watcher.join()
    return peak[0]


def measure(name: str, source: Path, frames: int, folder: Path, repeats: int) -> dict[str, object]:
    """One row: the import against the peer."""
    out = folder / "out"

    def run() -> None:
        shutil.rmtree(out, ignore_errors=True)
        import_recording(source, out)

    memory = peak_bytes(run)
    seconds = timed(run, repeats)
    packed = name != "raw" and not name.startswith("raw,")
    ours = timed(coder(frames, decode=packed, usual=False), repeats)
    usual = timed(coder(frames, decode=packed, usual=True), repeats)
    return {
        "source": name,
        "frames": frames,
        "cpu_ms_per_frame": 1e3 * seconds / frames,
        "frames_per_s": 2 * frames / seconds,
        "ratio_to_coding": ours / seconds,
        "ratio_to_usual_coding": usual / seconds,
        "peak_mb": memory / 2**20,
    }


def main() -> None:
    """Measure every kind of source and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="where to write the results")
    parser.add_argument("--quick", action="store_true", help="40 frames, once")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    quiet_warp()
    cv2.setNumThreads(1)
    frames, repeats = (40, 1) if arguments.quick else (1000, 2)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        makers: dict[str, Callable[[Path, int], Path]] = {
            "raw": lambda path, n: write_bag(path, n, packed=False, registered=True),
            "raw, depth to be registered": lambda path, n: write_bag(
                path, n, packed=False, registered=False
            ),
            "compressed topics": lambda path, n: write_bag(path, n, packed=True, registered=True),
            "PNG folder": write_pngs,
        }
        # The first import compiles the kernel.
        import_recording(makers["raw, depth to be registered"](folder / "w", 2), folder / "warm")
        for name, make in makers.items():
            source = make(folder / "source", frames)
            row = measure(name, source, frames, folder, repeats)
            shutil.rmtree(source)
            logger.info(
                "%(source)-28s %(cpu_ms_per_frame).1f ms, %(frames_per_s).0f frames/s; "
                "x%(ratio_to_coding).2f of coding "
                "alone, x%(ratio_to_usual_coding).2f of coding as usual; %(peak_mb).0f MB",
                row,
            )
            rows.append(row)
    write_json(arguments.json, {"benchmark": "import", "rows": rows, "provenance": provenance()})


if __name__ == "__main__":
    main()
