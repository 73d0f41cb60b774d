"""Whether two checkouts, each in its own environment, compute the same to the last bit.

    python experiments same_bits --base CHECKOUT --after CHECKOUT --out OUT

Compared are positions and parameters (theta) of every mode, and of a search that never stops early,
on the shipped recording and on two simulated ones; a live run that waits for each picture; three
reconstructed pictures, to 1e-5 m; the weights after 30 steps of fine-tuning; and the words of all
verdicts. A refactoring leaves all of it equal; of an intended change the table shows the size.

Each checkout runs its own copy of this file, so that names may change between the two. The base
simulates the recordings once, to OUT/inputs. Results are kept under the digest of the sources: the
same command resumes, and tracks again with what was edited since. Exit code 1: something differs.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from shared.figures import say

SELF = Path("experiments/tables/same_bits.py")
RUNS = {
    "default": ("default", ()),
    "searched": ("default", ("search.stop_score=0",)),
    "paper": ("paper", ()),
    "open_loop": ("open_loop", ()),
}
LARGEST_M = {"reconstruct": 1e-5}
"""Accepted difference by kind of item; 0 for the others."""

Result = dict[str, np.ndarray]


def main(arguments: list[str] | None = None) -> int:
    """Run what is missing in both checkouts and compare; 1 when something differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--base", type=Path, help="checkout before the change")
    parser.add_argument("--after", type=Path, help="checkout after it")
    for side in ("base", "after"):
        text = "its interpreter; by default its .venv, or else the one of this command"
        parser.add_argument(f"--{side}-python", metavar="PYTHON", help=text)
    parser.add_argument("--out", type=Path, required=True, help="folder of inputs and results")
    parser.add_argument("--smoke", action="store_true", help="in some minutes: a part of it")
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.run:
        return compute(given.out, given.run, smoke=given.smoke)
    if not (given.base and given.after):
        parser.error("give --base CHECKOUT and --after CHECKOUT")
    sides = []
    for side in ("base", "after"):
        checkout = getattr(given, side).resolve()
        folder = given.out / f"{side}-{digest(checkout / 'src')}"
        run(checkout, getattr(given, f"{side}_python"), given.out, folder, smoke=given.smoke)
        sides.append(folder)
    return compare(*sides)


def digest(folder: Path) -> str:
    """Return a digest of all sources and weights under a folder."""
    total = hashlib.sha256()
    for file in sorted(one for one in folder.rglob("*") if one.is_file()):
        if "__pycache__" not in file.parts:
            total.update(f"{file.relative_to(folder)}\n".encode() + file.read_bytes())
    return total.hexdigest()[:12]


def run(checkout: Path, python: str | None, out: Path, folder: Path, *, smoke: bool) -> None:
    """Compute the items that a folder of results lacks, with the code of a checkout."""
    own = checkout / ".venv/bin/python"
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout / "src"),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    words = ["--out", str(out.resolve()), "--run", str(folder.resolve())]
    command = [python or (own if own.exists() else sys.executable), checkout / SELF, *words]
    if subprocess.run([*command, *["--smoke"] * smoke], env=environment, check=False).returncode:
        sys.exit(f"{checkout} failed; the same command goes on from what is done")


def compute(out: Path, folder: Path, *, smoke: bool) -> int:
    """Compute and keep the items that a folder lacks, with the clothtrack of this process."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, item in items(recordings(out / "inputs"), folder, smoke=smoke).items():
        file = folder / f"{name}.npz"
        if file.exists():
            continue
        before = os.times()
        result = item()
        spent = sum(os.times()[:4]) - sum(before[:4])
        part = folder / "part.npz"
        np.savez(part, cpu_s=spent, **result)
        part.replace(file)
        say(f"{folder.name}  {name}  {spent:.1f} s CPU\n")
    wanted = sorted(items(recordings(out / "inputs"), folder, smoke=smoke))
    (folder / "items.json").write_text(json.dumps(wanted), encoding="utf-8")
    return 0


def compare(base: Path, after: Path) -> int:
    """Print a row for each item, and every word that changed; 1 when something differs."""
    names = [set(json.loads((one / "items.json").read_text("utf-8"))) for one in (base, after)]
    different = len(names[0] ^ names[1])
    for name in sorted(names[0] ^ names[1]):
        say(f"{name:<32}DIFFERENT  only one checkout computes it\n")
    for name in sorted(names[0] & names[1]):
        first, second = (dict(np.load(one / f"{name}.npz")) for one in (base, after))
        spent = float(second.pop("cpu_s")) / float(first.pop("cpu_s"))
        limit = LARGEST_M.get(name.split("-")[0], 0.0)
        rows = [f"{what} {gap}" for what, gap in gaps(first, second, limit)]
        different += bool(rows)
        say(f"{name:<32}{'DIFFERENT' if rows else 'equal':<10} CPU {spent:.2f} of the base\n")
        for row in rows:
            say(f"    {row}\n")
    say(f"{different} of {len(names[0] | names[1])} differ\n")
    return 1 if different else 0


def gaps(first: Result, second: Result, limit: float) -> list[tuple[str, str]]:
    """Return what differs by more than the limit, and by how much; every changed word."""
    found = []
    for what in sorted(first.keys() | second.keys()):
        if what not in first or what not in second:
            found.append((what, "is only in one"))
            continue
        one, other = first[what], second[what]
        if one.dtype.kind == "U":
            found += [(what, f"- {word}") for word in sorted({*one} - {*other})]
            found += [(what, f"+ {word}") for word in sorted({*other} - {*one})]
        elif one.shape != other.shape:
            found.append((what, f"shape {one.shape} became {other.shape}"))
        elif not np.array_equal(one, other, equal_nan=True):
            away = np.abs(one.astype(float) - other)
            gap = float(away[~(np.isnan(one) & np.isnan(other))].max())
            if not gap <= limit:
                found.append((what, f"largest difference {gap:.1e}"))
    return found


def recordings(inputs: Path) -> dict[str, Path]:
    """Return the recordings; the simulated ones are made where there are none."""
    import clothtrack as ct
    from clothtrack_lab import simulate

    made = {"shipped": ct.shipped_recording()}
    for garment, actions in (("towel", 2), ("tshirt", 1)):
        # What was simulated before is kept.
        (made[garment],) = simulate(inputs, garment, 1, actions=actions, small=True)
    return made


def items(films: dict[str, Path], folder: Path, *, smoke: bool) -> dict[str, Callable[[], Result]]:
    """Return what is computed, by name; each item is independent of the others."""
    todo: dict[str, Callable[[], Result]] = {}
    for film, path in films.items():
        for name in RUNS:
            if not smoke or film == "towel" or (film, name) == ("shipped", "default"):
                todo[f"track-{film}-{name}"] = partial(tracked, path, name)
    todo["live-towel"] = partial(live, films["towel"])
    for frame in (0,) if smoke else (0, 20, 42):
        todo[f"reconstruct-{frame:02d}"] = partial(reconstructed, films["shipped"], frame)
    small = [path for film, path in films.items() if film != "shipped"]
    steps = 2 if smoke else 30
    training = f"finetune-{steps}"
    todo[training] = partial(finetuned, small, folder / training, steps)
    return todo


def tracked(path: Path, name: str) -> Result:
    """Return what tracking a recording gives."""
    return run_of(track(path, name))


@cache
def track(path: Path, name: str) -> Any:
    """Return the run of a recording; it is tracked once a process."""
    import clothtrack as ct

    mode, settings = RUNS[name]
    return ct.track(path, mode=mode, settings=settings)


def run_of(run: Any) -> Result:
    """Return positions, parameters of the actions, and the words of a run."""
    return {
        "positions": run.positions,
        "theta": np.array(
            [[one.parameters[key] for key in sorted(one.parameters)] for one in run.actions]
        ),
        "words": words_of(run.verdict),
    }


def words_of(verdict: Any) -> np.ndarray:
    """Return the word of a verdict, and those of its evidence that are not to trust."""
    against = {f"{one.name}: {one.word}" for one in verdict.evidence if one.word != "trust"}
    return np.array([f"verdict: {verdict.word}", *sorted(against)])


def live(path: Path) -> Result:
    """Return what a live tracker gives that gets every picture."""
    import clothtrack as ct
    from clothtrack.live.playback import pickers_at

    film = ct.read_recording(path)
    tracker = ct.LiveTracker(film.cloth, film.cameras[0], table=film.table, name=film.name)
    camera = film.cameras[0].name
    for frame in film.frames:
        if any(action.last_frame == frame.index for action in film.actions):
            tracker.end_action()
        if any(action.first_frame == frame.index for action in film.actions):
            tracker.begin_action()
        tracker.update(
            frame.time_s,
            ct.read_depth(frame.depth[camera], film.depth_units_m[camera]),
            ct.read_color(frame.color[camera]),
            picker=pickers_at(film, frame),
        )
    return run_of(tracker.close())


def reconstructed(path: Path, frame: int) -> Result:
    """Return the mesh of a picture of a recording."""
    import clothtrack as ct

    mesh = ct.reconstruct(path, frame=frame)
    return {"vertices": mesh.vertices, "words": words_of(mesh.verdict)}


def finetuned(paths: list[Path], folder: Path, steps: int) -> Result:
    """Return the weights after some steps on the labels of the default mode."""
    import clothtrack as ct
    from clothtrack.reconstruction.training.checkpoint import load_weights

    folder.mkdir(exist_ok=True)
    labels = []
    for path in paths:
        run = track(path, "default")
        labels.append(ct.label(run, folder / f"{path.name}.labels.npz"))
    shipped = Path(ct.__file__).parent / "reconstruction/weights/tokens.safetensors"
    # All labels fit in one batch: a step is an epoch.
    settings = (f"tokens.epochs={steps}", f"tokens.evaluate_epochs={steps}")
    training = ct.finetune(shipped, labels, output=folder, settings=settings)
    assert training is not None
    tensors = load_weights(training.outcome.model).tensors
    flat = [tensor.float().numpy().ravel() for _, tensor in sorted(tensors.items())]
    return {"weights": np.concatenate(flat)}


if __name__ == "__main__":
    sys.exit(main())
