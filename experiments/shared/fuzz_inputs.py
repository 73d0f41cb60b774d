"""Damaged inputs of every kind, and a command line that reads each.

Each function makes one case in a folder, from the small world of `proof_stage`, and gives the words
after `clothtrack`. They run in the child, so the parent computes nothing.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from shared.damage import (
    chosen,
    damage_file,
    spoilt_arrays,
    spoilt_document,
    spoilt_text,
)
from shared.proof_stage import FAST, STATES, TOWEL, settings

Words = list[object]
Make = Callable[[np.random.Generator, Path, Path], Words]


def recording(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """A recording, read by the verbs that take one."""
    folder = box / "in" / "towel_0001"
    shutil.copytree(stage / "world" / "recordings" / "towel_0001", folder)
    kind = rng.random()
    if kind < 0.45:
        _spoil_json(folder / "recording.json", rng)
    elif kind < 0.75:
        path = folder / chosen(("picker.csv", "template.obj", "template_canonical.csv"), rng)
        _spoil_text(path, rng)
    else:
        damage_file(_any_file(folder, rng), rng)
    out = box / "out"
    tracked = stage / "tracked" / "towel_0001.zarr"
    return chosen(
        (
            *[["inspect", folder]] * 4,
            *[["track", folder, "--output", out, *settings(*FAST)]] * 3,
            ["calibrate-camera", folder, "--keep-world", "--output", out / "c.json"],
            ["calibrate-camera", folder, "--output", out / "c.json"],
            ["evaluate", tracked, "--recordings", folder],
            ["label", tracked, "--recordings", folder, "--output", out],
            ["export", tracked, "--recordings", folder, "--output", out / "s.png"],
            ["garment", folder, "--kind", "towel", "--output", out / "t.npz"],
            ["inspect", folder, tracked],
        ),
        rng,
    )


def trajectory(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """A tracked trajectory: damaged, or altered and sealed again."""
    folder = box / "in" / "towel_0001.zarr"
    shutil.copytree(stage / "tracked" / "towel_0001.zarr", folder)
    if rng.random() < 0.5:
        damage_file(_any_file(folder, rng), rng)
    else:
        _resealed_zarr(folder, rng)
    out, at = box / "out", ["--recordings", stage / "world" / "recordings"]
    return chosen(
        (
            ["inspect", folder],
            ["evaluate", folder, *at],
            ["evaluate", folder, *at, "--truth", stage / "world" / "truth"],
            ["label", folder, *at, "--output", out],
            ["export", folder, "--output", out / chosen(("m.npz", "meshes"), rng)],
        ),
        rng,
    )


def labels(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """Pseudo-labels, truth and saved worlds: arrays altered and sealed again, or bytes."""
    source = stage / chosen(
        (*["labels/towel_0001.labels.npz"] * 3, "world/truth/towel_0001.npz",
         "episodes/worlds/towel_0003/00.npz"), rng)  # fmt: skip
    path = box / "in" / source.name
    shutil.copy(source, path)
    if rng.random() < 0.3:
        damage_file(path, rng)
    else:
        _resealed_npz(path, rng)
    if source.parent.name == "truth":
        tracked = stage / "tracked" / "towel_0001.zarr"
        at = ["--recordings", stage / "world" / "recordings", "--truth", path.parent]
        return chosen((["inspect", path], ["evaluate", tracked, *at]), rng)
    if source.parent.name == "labels" and rng.random() < 0.3:
        # A start that is none: labels are read first, and nothing is trained.
        return ["finetune", stage / "bags" / "lens.json", path, "--output", box / "out"]
    return ["inspect", path]


def weights(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """A network's weights, in bytes and in the header that says what they are."""
    path = box / "in" / "model.safetensors"
    data = (stage / "network" / "model.safetensors").read_bytes()
    size = 8 + int.from_bytes(data[:8], "little")
    if rng.random() < 0.6:
        try:
            header = spoilt_document(json.loads(data[8:size]), rng)
            text = json.dumps(header).encode("utf-8", errors="surrogatepass")
        except RecursionError:
            text = b"{}"
        path.write_bytes(len(text).to_bytes(8, "little") + text + data[size:])
    else:
        path.write_bytes(data)
        damage_file(path, rng)
    picture = stage / "world" / "recordings" / "towel_0001"
    out = box / "out"
    return chosen(
        (
            *[["inspect", path]] * 3,
            ["track", picture, "--weights", path, "--output", out,
             *settings("initial_state.source=network", *FAST)],
            ["flatten", out, "--weights", path, "--actions", 1],
            ["finetune", path, stage / "labels", "--output", out, "--set", "tokens.epochs=0"],
        ),
        rng,
    )  # fmt: skip


def mesh(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """A garment's template, as OBJ, CSV beside it, or NPZ."""
    source = stage / "world" / "recordings" / "towel_0001"
    folder = box / "in"
    for name in ("template.obj", "template_canonical.csv"):
        shutil.copy(source / name, folder / name)
    if rng.random() < 0.75:
        _spoil_text(folder / chosen(("template.obj", "template_canonical.csv"), rng), rng)
    else:
        damage_file(folder / "template.obj", rng)
    path, out = folder / "template.obj", box / "out"
    return chosen(
        (
            ["view", path, "--html", out / "v.html"],
            ["track", source, "--template", path, "--output", out, *settings(*FAST)],
            ["simulate", out, "--template", path, "--actions", 1, *settings(*TOWEL[2:])],
            ["flatten", out, "--policy", "random", "--template", path, "--actions", 1],
        ),
        rng,
    )


def other_files(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """Documents beside the results: reviews, lists, episodes, states, memory of the work."""
    folder, out = box / "in", box / "out"
    kind = chosen(("review", "states", "shard", "episode", "lens", "poses"), rng)
    at = ["--recordings", stage / "world" / "recordings"]
    if kind == "review":
        shutil.copytree(stage / "tracked" / "towel_0001.zarr", folder / "towel_0001.zarr")
        path = folder / "towel_0001.review.json"
        path.write_text('{"actions": {"0": {"verdict": "rejected", "note": "x"}}, "version": 1}')
        _spoil_json(path, rng)
        return ["label", folder / "towel_0001.zarr", *at, "--output", out]
    if kind in ("states", "shard"):
        shutil.copytree(stage / "states", folder / "states")
        if kind == "states":
            _spoil_json(folder / "states" / "states.json", rng)
        else:
            damage_file(_any_file(folder / "states" / "shards", rng), rng)
        more = ["simulate", folder / "states", "--states", 8, *settings(*STATES)]
        return chosen((["inspect", folder / "states"], more), rng)
    if kind == "episode":
        shutil.copytree(stage / "episodes", folder / "episodes")
        path = folder / "episodes" / "episodes" / "towel_0003" / "episode.json"
        _spoil_json(path, rng)
        return ["flatten", folder / "episodes", "--policy", "heuristic", "--actions", 1, "--seed",
                3]  # fmt: skip
    if kind == "lens":
        path = folder / "lens.json"
        shutil.copy(stage / "bags" / "lens.json", path)
        _spoil_json(path, rng)
        return ["import", stage / "bags" / "tum", out / "r", "--intrinsics", path,
                "--depth-unit", "0.001"]  # fmt: skip
    path = folder / "poses.csv"
    path.write_text("frame,x,y,z,qx,qy,qz,qw\n" + "".join(
        f"{n},0.{n},0.1,0.5,0,0,0,1\n" for n in range(6)))  # fmt: skip
    _spoil_text(path, rng)
    return ["calibrate-camera", stage / "world" / "recordings" / "towel_0001", "--robot-poses",
            path, "--charuco", 7, 5, 0.03, 0.02]  # fmt: skip


def imported(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """A recording of another program."""
    source = stage / "bags" / chosen(
        ("ros1.bag", "mcap", "sqlite", "realsense.bag", "tum", "open3d"), rng)  # fmt: skip
    path = box / "in" / source.name
    if source.is_dir():
        shutil.copytree(source, path)
        damage_file(_any_file(path, rng), rng)
    else:
        shutil.copy(source, path)
        damage_file(path, rng)
    words: Words = ["import", path, box / "out" / "recording"]
    if source.name == "tum":
        words += ["--intrinsics", stage / "bags" / "lens.json", "--depth-unit", "0.001"]
    return words


def _any_file(folder: Path, rng: np.random.Generator) -> Path:
    return chosen(sorted(path for path in folder.rglob("*") if path.is_file()), rng)


def _spoil_json(path: Path, rng: np.random.Generator) -> None:
    if rng.random() < 0.1:
        damage_file(path, rng)
        return
    document = spoilt_document(json.loads(path.read_text("utf-8")), rng)
    path.write_text(json.dumps(document), encoding="utf-8", errors="surrogatepass")


def _spoil_text(path: Path, rng: np.random.Generator) -> None:
    text = spoilt_text(path.read_text("utf-8"), rng)
    path.write_text(text, encoding="utf-8", errors="surrogatepass")


def _resealed_npz(path: Path, rng: np.random.Generator) -> None:
    """Other arrays, with the CRC that belong to them."""
    from clothtrack.files.arrays import read_npz, write_npz

    arrays = read_npz(path)
    texts = [name for name, values in arrays.items() if str(values).startswith("{")]
    if texts and rng.random() < 0.4:
        name = chosen(texts, rng)
        document = spoilt_document(json.loads(str(arrays[name])), rng)
        arrays[name] = np.array(json.dumps(document))
    else:
        arrays = spoilt_arrays(arrays, rng)
    write_npz(path, arrays)


def _resealed_zarr(folder: Path, rng: np.random.Generator) -> None:
    """Another array or attribute, with the CRC that belong to it."""
    import zarr

    from clothtrack.files.arrays import put_array

    group = zarr.open_group(folder, mode="r+")
    attributes = group.attrs.asdict()
    if rng.random() < 0.4:
        attributes = spoilt_document(attributes, rng)
        attributes = attributes if isinstance(attributes, dict) else {}
        group.attrs.clear()
    else:
        arrays = {name: np.asarray(one[...]) for name, one in group.members(max_depth=None)
                  if isinstance(one, zarr.Array)}  # fmt: skip
        changed = spoilt_arrays(arrays, rng)
        (name,) = [one for one in arrays if changed.get(one) is not arrays[one]][:1] or [None]
        if name is not None:
            old = group[name].attrs.asdict()
            del group[name]
            if name in changed:
                put_array(group, name, changed[name], unit=old.get("unit", ""))
    group.attrs.update(attributes)
