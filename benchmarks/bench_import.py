"""Speed of imports against the minimal work of decoding and encoding the pictures.

A video of smooth surfaces with a sensor's noise, 640 x 480, is written as each kind of source and
imported. The peer only decodes and encodes the same pictures with OpenCV, at its usual PNG settings
and at ours. CPU times are summed over all threads, so that other work on the machine has little
effect. The ratio is how many times faster the import is than the peer. Frames per second are for
two otherwise idle processors. Reading and writing, which only the first thread does, have their own
column; two processors stay busy as long as it is below one half. Memory is the peak above that at
the start, for a quarter of the frames and for all.

    python benchmarks/bench_import.py --json import.json [--quick] [--only NAME ...]
"""

import argparse
import importlib.util
import json
import logging
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
from results import provenance, write_json
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from clothtrack.geometry import quiet_warp
from clothtrack.recordings import encode_png
from clothtrack_capture import ImportOptions
from clothtrack_capture.importing.import_recording import import_recording

logger = logging.getLogger("bench_import")
WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
DIFFERENT = 20  # pictures that are made; a film repeats them
ROS2, ROS1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
MAKERS = Path(__file__).parents[1] / "tests" / "importing" / "makers.py"
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


def header(time_ns: int, store: Typestore) -> object:
    """Return a stamped header."""
    stamp = store.types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
    number = (0,) if store is ROS1 else ()
    return store.types["std_msgs/msg/Header"](*number, stamp, "camera")


def info(time_ns: int, focal: float, store: Typestore) -> object:
    """Intrinsics."""
    region = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([focal, 0, 319.5, 0, focal, 239.5, 0, 0, 1.0])
    return store.types["sensor_msgs/msg/CameraInfo"](
        header(time_ns, store), HEIGHT, WIDTH, "plumb_bob", np.zeros(5), k, np.eye(3).ravel(),
        np.insert(k, [3, 6, 9], 0.0), 0, 0, region,
    )  # fmt: skip


def entries(
    frames: int, store: Typestore, *, packed: bool = False, registered: bool = True
) -> Iterator[tuple[str, int, object]]:
    """Yield the messages of a camera."""
    image = store.types["sensor_msgs/msg/Image"]
    compressed = store.types["sensor_msgs/msg/CompressedImage"]
    depths, colors = pictures()
    pngs = [bytes(12) + encode_png(one) for one in depths]
    for k in range(frames):
        now, one = 10**18 + k * 33_333_333, k % DIFFERENT
        head = header(now, store)
        yield (
            "/camera/depth/camera_info",
            now,
            info(now, FOCAL if registered else 0.7 * FOCAL, store),
        )
        yield "/camera/color/camera_info", now, info(now, FOCAL, store)
        if packed:
            data = np.frombuffer(pngs[one], np.uint8)
            depth = compressed(head, "16UC1; compressedDepth png", data)
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


def write_bag(
    path: Path, frames: int, *, storage: str = "mcap", packed: bool = False, registered: bool = True
) -> Path:
    """Write a bag of ROS 2 ("mcap" or "sqlite3") or ROS 1 ("bag")."""
    if storage == "bag":
        store, pack = ROS1, ROS1.serialize_ros1
        writer = rosbag1.Writer(path)
    else:
        store, pack = ROS2, ROS2.serialize_cdr
        plugin = rosbag2.StoragePlugin[storage.upper()]
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with writer:
        known = {}
        for topic, now, message in entries(frames, store, packed=packed, registered=registered):
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], now, pack(message, kind))
    return path


def makers() -> ModuleType:
    """Return the module of the tests that writes recordings."""
    spec = importlib.util.spec_from_file_location("import_makers", MAKERS)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["import_makers"] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def write_kinect(path: Path, frames: int) -> Path:
    """Write a Matroska file: the header from the tests' writer, followed by blocks."""
    make = makers()
    depths, colors = pictures()
    none = slice(0, 0)
    make.write_kinect(path, np.stack(depths)[none], np.stack(colors)[none], [])
    raw = [one.astype(">u2").tobytes() for one in depths]
    shown = [jpeg(one).tobytes() for one in colors]
    with path.open("ab") as file:
        for k in range(frames):
            blocks = make.number(0xE7, k * 33_333)
            blocks += make.element(0xA3, b"\x81\x00\x00\x80" + shown[k % DIFFERENT])
            depth = make.element(0xA1, b"\x82\x00\x00\x80" + raw[k % DIFFERENT])
            file.write(make.element(0x1F43B675, blocks + make.element(0xA0, depth)))
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


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Return the CPU time of all threads and of the first one [s]."""
    start, own = time.process_time(), time.thread_time()
    work()
    return time.process_time() - start, time.thread_time() - own


def resident_bytes() -> int:
    """Return memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def peak_bytes(work: Callable[[], object]) -> int:
    """Return the peak memory above that at the start, sampled."""
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


@dataclass(frozen=True)
class Kind:
    """A kind of source: how it is written, and what in it is packed."""

    write: Callable[[Path, int], Path]
    depth_form: str = "raw"
    color_form: str = "raw"


KINDS = {
    "raw topics, ROS 2 MCAP": Kind(write_bag),
    "raw topics, ROS 2 SQLite": Kind(partial(write_bag, storage="sqlite3")),
    "raw topics, ROS 1 bag": Kind(partial(write_bag, storage="bag")),
    "raw, depth to be registered": Kind(partial(write_bag, registered=False)),
    "compressed topics": Kind(partial(write_bag, packed=True), "png", "jpeg"),
    "PNG folder": Kind(write_pngs, "png", "png"),
    "Matroska, JPEG color": Kind(write_kinect, "raw", "jpeg"),
}


def measure(name: str, frames: int, folder: Path) -> dict[str, object]:
    """Return one row: the import against the peer."""
    kind, out = KINDS[name], folder / "out"
    lens = folder / "lens.json"
    values = {"width": WIDTH, "height": HEIGHT, "fx": FOCAL, "fy": FOCAL, "cx": 319.5, "cy": 239.5}
    lens.write_text(json.dumps(values), encoding="utf-8")
    # No mode of a Kinect has 640 x 480 pixels of depth.
    given = lens if kind.write is write_kinect else None
    config = ImportOptions(intrinsics=given)
    peaks, times = [], (0.0, 0.0)
    for count in (frames // 4, frames):
        source = kind.write(folder / "source", count)
        start, own = time.process_time(), time.thread_time()
        peaks.append(peak_bytes(lambda: import_recording(folder / "source", out, config)))
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
        "peak_mb_quarter": peaks[0] / 2**20,
        "peak_mb": peaks[1] / 2**20,
    }


def main() -> None:
    """Measure every kind of source and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="where to write the results")
    parser.add_argument("--quick", action="store_true", help="40 frames")
    parser.add_argument("--only", nargs="*", choices=tuple(KINDS), default=tuple(KINDS))
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    quiet_warp()
    cv2.setNumThreads(1)
    frames = 40 if arguments.quick else 1000
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        # The first import compiles the kernel.
        warm = write_bag(folder / "warm", 2, registered=False)
        import_recording(warm, folder / "warmed")
        for name in arguments.only:
            row = measure(name, frames, folder)
            logger.info(
                "%(source)-28s %(cpu_ms_per_frame).1f ms, %(frames_per_s).0f frames/s, first "
                "thread %(first_thread_share).2f; x%(ratio_to_coding).2f of coding alone, "
                "x%(ratio_to_usual_coding).2f of coding as usual; %(peak_mb_quarter).0f and "
                "%(peak_mb).0f MB",
                row,
            )
            rows.append(row)
            content = {"benchmark": "import", "rows": rows, "provenance": provenance()}
            write_json(arguments.json, content)


if __name__ == "__main__":
    main()
