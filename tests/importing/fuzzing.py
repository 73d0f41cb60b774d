"""Damages files of each format in many ways and imports each: run by `test_fuzz.py`, alone.

    python fuzzing.py FIRST COUNT FOLDER

A process of its own, so that its memory can be limited and a crash of a library is seen. Ends with
1 and says which case did what it must not.
"""

import importlib.util
import resource
import shutil
import signal
import sys
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

_spec = importlib.util.spec_from_file_location(
    "import_makers", Path(__file__).with_name("makers.py")
)
makers = importlib.util.module_from_spec(_spec)
sys.modules["import_makers"] = makers
_spec.loader.exec_module(makers)
sys.path.append(str(Path(__file__).parents[2] / "experiments"))


from shared.damage import damaged  # noqa: E402

from clothtrack.errors import ClothTrackError  # noqa: E402
from clothtrack.geometry.devices import quiet_warp  # noqa: E402
from clothtrack_capture.importing.import_options import ImportOptions  # noqa: E402
from clothtrack_capture.importing.import_recording import import_recording  # noqa: E402

LONGEST_S = 10
MOST_MEMORY = 2**30
FORMATS = (
    "ros1", "ros1-lz4", "mcap", "mcap-zstd", "sqlite", "realsense-bag", "realsense-db3", "kinect",
    "tum", "open3d", "bop",
)  # fmt: skip


def seed_file(kind, folder):
    """A small valid recording of a format."""
    film = makers.Film(frames=3, width=16, height=12)
    ros1, ros2 = makers.Messages(cdr=False), makers.Messages(cdr=True)
    if kind.startswith("ros1"):
        compression = "lz4" if kind.endswith("lz4") else None
        entries = makers.stream(film, ros1)
        return makers.write_ros1(folder / "seed.bag", entries, ros1, compression=compression)
    if kind.startswith("mcap") or kind == "sqlite":
        how = {"storage": "sqlite3"} if kind == "sqlite" else {}
        how |= {"compression": "storage"} if kind.endswith("zstd") else {}
        bag = makers.write_ros2(folder / "seed", makers.stream(film, ros2), ros2, **how)
        return next(one for one in bag.iterdir() if one.suffix in (".db3", ".mcap"))
    if kind == "realsense-bag":
        return makers.write_realsense_bag(folder / "seed.bag", film)
    if kind == "realsense-db3":
        return makers.write_realsense_db3(folder / "seed.db3", film, 0.01)
    if kind == "kinect":
        depth = np.random.default_rng(0).integers(500, 900, (2, 288, 320)).astype(np.uint16)
        return makers.write_kinect(folder / "seed.mkv", depth, None, film.times - makers.START_NS)
    return makers.write_folder(folder / "seed", film, kind)


def damage_folder(folder, rng):
    """Damage one file of a folder, or take it away."""
    files = sorted(one for one in folder.rglob("*") if one.is_file())
    text = [one for one in files if one.suffix in (".txt", ".json")]
    chosen = text if text and rng.random() < 0.5 else files
    file = chosen[int(rng.integers(len(chosen)))]
    if rng.random() < 0.1:
        file.unlink()
    else:
        file.write_bytes(damaged(file.read_bytes(), rng))


def one_case(kind, number, seed, box):
    """Damage and import once: "imported", "refused" or what went wrong."""
    rng = np.random.default_rng([number, FORMATS.index(kind)])
    box.mkdir()
    source = box / seed.name
    if seed.is_dir():
        shutil.copytree(seed, source)
        damage_folder(source, rng)
    else:
        source.write_bytes(damaged(seed.read_bytes(), rng))
    lens = makers.lens_file(box / "lens.json", makers.Film(width=16, height=12))
    chosen = ImportOptions(
        intrinsics=lens if kind == "tum" or rng.random() < 0.1 else None,
        depth_unit_m=0.001 if kind == "tum" else None,
        fps=30.0 if kind == "bop" else None,
        picker_topic="/picker" if rng.random() < 0.1 else None,
        workers=1,
    )
    before = sizes(box)
    outcome = "imported"
    signal.alarm(LONGEST_S)
    try:
        import_recording(source, box / "out", chosen)
    except ClothTrackError as error:
        outcome = "refused"
        if len(str(error)) > 4000:
            return f"a message of {len(str(error))} characters"
    except BaseException:  # noqa: BLE001
        return traceback.format_exc()
    finally:
        signal.alarm(0)
    shutil.rmtree(box / "out", ignore_errors=True)
    after = sizes(box)
    shutil.rmtree(box)
    return outcome if after == before else f"files changed: {after.keys() ^ before.keys()}"


def sizes(folder):
    return {one: one.stat().st_size for one in folder.rglob("*")}


class HangError(BaseException):
    """A case takes too long."""


def on_alarm(*_):
    raise HangError


def main(first, count, folder):
    quiet_warp()
    signal.signal(signal.SIGALRM, on_alarm)
    for kind in FORMATS:
        damage_and_import(kind, int(first), int(count), Path(folder) / kind)


def damage_and_import(kind, first, count, place):
    """Import damaged files of one format; exit with the case that did what it must not."""
    place.mkdir(parents=True)
    seed = seed_file(kind, place)
    # The first import compiles and loads; what it takes is not the file's doing.
    one_case(kind, 2**31, seed, place / "case")
    shutil.rmtree(place / "case", ignore_errors=True)
    used = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, hard))
    outcomes = Counter()
    for number in range(first, first + count):
        outcome = one_case(kind, number, seed, place / "case")
        outcomes[outcome] += 1
        if outcome not in ("imported", "refused"):
            sys.exit(f"{kind}, case {number}: {outcome}")
    # Damage that always or never stops the import would test nothing.
    if min(outcomes["imported"], outcomes["refused"]) < count // 20:
        sys.exit(f"{kind}: {dict(outcomes)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
