"""Judge the verdict: are wrong recordings refused or doubted, and right ones trusted?

A case spoils one recording (`wrong`), or changes it without harm (`harmless`), tracks it as a user
does and compares the verdict with the true error: the worst of the meshes at the end of every
action and at the last frame. The truth is in the real world, so a wrong camera pose moves the mesh
away from it. Recordings: drawn films with a motion in closed form, and simulated ones (MuJoCo).

    python experiments reliability --out OUT --cases 1000 --only wrong harmless

A false trust is a trusted mesh with a mean error above 8 mm or a 95th percentile above 30. A false
alarm is a refusal, or a doubt of a mesh with a mean below 5 mm and a 95th percentile below 15.
Finished cases are kept in OUT/SORT.jsonl, and a second call resumes. A case depends only on its
number and on `--seed`. Exit code 1: a false trust, a false alarm or a crash. `--smoke` takes a few.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row
from shared.bench_runs import read_rows, write_rows
from shared.drawn_films import SCENES, draw
from shared.figures import say
from shared.recording_data import RecordingData, read_simulated
from shared.table_column import table
from shared.wrong_inputs import HARMLESS, MASK, TEMPLATE, WRONG, Kind

import clothtrack as ct
from clothtrack.errors import ClothTrackError
from clothtrack.evaluation.truth import material_map, material_points
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.geometry.devices import quiet_warp
from clothtrack_lab.world.episodes import (
    SMALL_WORLD,
    ActionConfig,
    TemplateConfig,
    simulate_trajectory,
)

VERTICES = 500
"""About how many vertices the tracked meshes have."""

WRONG_MM, RIGHT_MM = (8.0, 30.0), (5.0, 15.0)
"""Mean and 95th percentile: above either a trusted mesh is a false trust, below both a doubt is a
false alarm."""

SORTS = {"wrong": WRONG, "harmless": HARMLESS}
BASES: dict[str, tuple[frozenset[str], Callable[[Path], RecordingData]]] = {
    "stiff_loop": (frozenset({MASK}), lambda _: draw(SCENES["stiff_loop"])),
    "soft_drape": (
        frozenset({MASK, TEMPLATE}),
        lambda _: draw(SCENES["soft_drape"], template_vertices=VERTICES),
    ),
    "half_fold": (frozenset({MASK}), lambda _: draw(SCENES["half_fold"])),
    "napkin": (frozenset({TEMPLATE}), lambda out: _simulated(out, "towel", 21, (0.26, 0.2))),
    "towel": (frozenset(), lambda out: _simulated(out, "towel", 12, (0.34, 0.24), template=False)),
    "tshirt": (frozenset({TEMPLATE}), lambda out: _simulated(out, "tshirt", 13)),
}
"""What is changed: what it has that some lack, and how it is made."""


Case = tuple[str, int, int, Path]
"""Sort, number, seed, and the folder for what is made."""


def _simulated(
    out: Path,
    kind: str,
    seed: int,
    size_m: tuple[float, float] | None = None,
    *,
    template: bool = True,
) -> RecordingData:
    config = replace(
        SMALL_WORLD, size_m=size_m, vertex_count=600, settle_limit_s=0.6,
        template=TemplateConfig(vertex_count=VERTICES) if template else None,
        action=ActionConfig(frame_rate=10.0, distance_m=(0.1, 0.2)),
    )  # fmt: skip
    folder = out / "simulated" / "recordings" / f"{kind}_{seed:04d}"
    if not folder.exists():
        simulate_trajectory(kind, seed, out / "simulated", config=config)
    return read_simulated(folder, out / "simulated" / "truth" / f"{folder.name}.npz")


@cache
def _base(name: str, out: Path) -> RecordingData:
    return BASES[name][1](out)


def _kind(case: Case) -> Kind:
    """Return the kind of a case; they take turns."""
    return SORTS[case[0]][case[1] % len(SORTS[case[0]])]


def judged(case: Case) -> Row:
    """Change one recording, track it, and compare; a row with what became of it."""
    quiet_warp()
    sort, number, seed, out = case
    kind, rng = _kind(case), np.random.default_rng([seed, number, sort == "wrong"])
    able = [name for name, (has, _) in BASES.items() if not kind.needs or kind.needs in has]
    base = str(rng.choice(able))
    data, strength = kind(_base(base, out), rng)
    row: Row = {"case": number, "seed": seed, "kind": kind.name, "base": base}
    row |= {"strength": round(strength, 3), "unit": kind.unit}
    with tempfile.TemporaryDirectory(dir=out) as folder:
        try:
            return row | compared(data.write(Path(folder) / "recording"), data)
        except ClothTrackError as error:
            return {**row, "word": "refused", "error": str(error).replace(folder, "")}
        except Exception as error:  # noqa: BLE001
            # A defect of the package, or of the kind: it is shown, and the other cases go on.
            return {**row, "word": "crashed", "error": f"{type(error).__name__}: {error}"}


def compared(folder: Path, data: RecordingData) -> Row:
    """Track a recording; return the word and the true error [mm]."""
    run = ct.track(folder, settings=(f"initial_state.vertex_count={VERTICES}",))
    truth = data.truth[data.moments]
    where = material_map(data.truth_canonical, data.truth_faces, np.asarray(run.mesh.canonical))
    # The mesh after the last action goes on to the end of the film, and people use it.
    ends = [(label.frame, label.positions) for label in run.labels]
    ends.append((int(run.frames[-1]), run.positions[-1]))
    errors_mm = [
        1e3 * np.linalg.norm(at - material_points(truth[n], data.truth_faces, where), axis=1)
        for n, at in ends
    ]
    return {
        "word": run.verdict.word,
        "reason": run.verdict.reason,
        "mean_mm": max(float(each.mean()) for each in errors_mm),
        "p95_mm": max(float(np.percentile(each, 95)) for each in errors_mm),
    }


def false_trust(row: Row) -> bool:
    """Return whether a mesh is trusted, and wrong."""
    errors = row.get("mean_mm", 0.0), row.get("p95_mm", 0.0)
    return row["word"] == "trust" and any(a > b for a, b in zip(errors, WRONG_MM, strict=True))


def false_alarm(row: Row) -> bool:
    """Return whether a right recording is refused, or its mesh is right and not trusted."""
    errors = row.get("mean_mm", 0.0), row.get("p95_mm", 0.0)
    right = all(a < b for a, b in zip(errors, RIGHT_MM, strict=True))
    return row["word"] != "trust" and right


FOUND = {"wrong": ("false trust", false_trust), "harmless": ("false alarm", false_alarm)}


def markdown(sort: str, rows: Sequence[Row]) -> str:
    """Return one line for each kind and base, and the totals."""
    counted, is_found = FOUND[sort]
    words = ("crashed", "refused", "reject", "look", "trust")
    lines = []
    groups = {f"{kind.text} (`{kind.name}`)": ("kind", kind.name) for kind in SORTS[sort]}
    groups |= {f"all on `{name}`": ("base", name) for name in BASES}
    for name, (column, value) in (groups | {"all": ("", "")}).items():
        own = [row for row in rows if not column or row[column] == value]
        if own:
            told = Counter(row["word"] for row in own)
            trusted = [row["mean_mm"] for row in own if row["word"] == "trust"]
            cells = [len(own), *(told[word] for word in words), sum(map(is_found, own))]
            worst = f"{max(trusted):.1f}" if trusted else "-"
            lines.append([name, *map(str, cells), worst])
    return table(["kind", "cases", *words, counted, "worst trusted, mm"], lines) + "\n"


def rows_of(sort: str, options: argparse.Namespace, out: Path) -> list[Row]:
    """Return the rows of the first cases; those that are missing are done."""
    file = out / f"{sort}.jsonl"
    kept = read_rows(file) if file.exists() else []
    done = {row["case"]: row for row in kept if row["seed"] == options.seed}
    wanted = [(sort, number, options.seed, out) for number in range(options.cases)]
    for name in BASES:
        # Once, and not in every worker at the same time.
        _base(name, out)
    missing = [one for one in wanted if one[1] not in done]
    for row in finished_in_workers(judged, missing, options.workers):
        done[row["case"]] = row
        kept.append(row)
        write_rows(kept, file)
        sys.stderr.write(f"{sort}: {len(done)} of {len(wanted)}\n")
    return [done[one[1]] for one in wanted]


def main(arguments: Sequence[str] | None = None) -> int:
    """Do the cases that are missing, print the tables; 1 where a case shows a defect."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder of the rows and recordings")
    parser.add_argument("--only", nargs="+", choices=SORTS, default=list(SORTS))
    parser.add_argument("--cases", type=int, default=1000, help="of each sort")
    parser.add_argument("--seed", type=int, default=0, help="of all cases")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--smoke", action="store_true", help="a few cases of each sort")
    options = parser.parse_args(arguments)
    if options.out is None and not options.smoke:
        parser.error("give --out FOLDER, or --smoke")
    quiet_warp()
    if options.smoke:
        options.cases = 2
        for name in ("half_fold", "napkin", "towel", "tshirt"):
            BASES.pop(name, None)
    failed = False
    with tempfile.TemporaryDirectory(prefix="reliability-") as temporary:
        out = options.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        for sort in options.only:
            rows = rows_of(sort, options, out)
            say(f"\n{sort}\n\n{markdown(sort, rows)}")
            failed |= any(FOUND[sort][1](row) or row["word"] == "crashed" for row in rows)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
