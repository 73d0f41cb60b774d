"""Test case by case whether wrong recordings are refused or doubted, and right ones trusted.

A case corrupts one recording (`wrong`), or changes it without harm (`harmless`), tracks it as a
user does and compares the verdict with the true error. This is the worst error of the mesh at the
end of every action and at the last frame. The truth is in the real world, so a wrong camera pose
moves the mesh away from it.
"""

import logging
import resource
import shutil
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from shared.bench_measures import without_slip
from shared.harmless_inputs import HARMLESS
from shared.proof_bases import BASES, VERTICES, Base, MissingBaseError, load
from shared.recording_data import RecordingData
from shared.trial import child_result
from shared.wrong_inputs import KINDS, Kind

WRONG_MEAN_MM, WRONG_P95_MM = 8.0, 30.0
"""A trusted mesh with a true error above either is a false trust."""

RIGHT_MEAN_MM, RIGHT_P95_MM = 5.0, 15.0
"""A mesh that is not trusted, with a true error below both, is a false alarm."""

CPU_S = 120
"""A case that computes for longer is stopped [s]; one takes some ten."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Proof:
    """The cases of one sort, as `experiments/tables/reliability.py` runs them.

    Attributes:
        kinds: of change; they take turns.
        bases: what is changed.
        wrong: whether trust is the defect, and not alarm.
    """

    kinds: Sequence[Kind]
    bases: Sequence[Base]
    wrong: bool

    def case(self, number: int, seed: int, stage: Path, box: Path) -> Row:
        """Change one recording, track it, and compare; a row with what became of it."""
        rng = np.random.default_rng([seed, number, int(self.wrong)])
        kind = self.kinds[number % len(self.kinds)]
        able = [base for base in self.bases if kind.needs <= base.has]
        base = able[int(rng.integers(len(able)))]
        row: Row = {"kind": kind.name, "base": base.name}
        try:
            return row | child_result(lambda: _judged(kind, base, rng, stage, box), box)
        except RuntimeError as error:
            return {**row, "outcome": "did not end", "error": f"{error} ({CPU_S} CPU s at most)"}

    def violates(self, row: Row) -> bool:
        """Return whether a case shows a defect: a crash, a false trust or a false alarm."""
        if row["outcome"] in ("crashed", "did not end"):
            return True
        return false_trust(row) if self.wrong else false_alarm(row)

    def markdown(self, rows: Sequence[Row]) -> str:
        """Return one line for each kind, and the totals."""
        counted = "false trust" if self.wrong else "false alarm"
        lines = [
            f"| kind | cases | refused | reject | look | trust | {counted} | worst trusted, mm |",
            "|---|---:|---:|---:|---:|---:|---:|---:|",
        ]
        done = [row for row in rows if row["outcome"] != "skipped"]
        of_kind = {f"{kind.text} (`{kind.name}`)": ("kind", kind.name) for kind in self.kinds}
        of_base = {f"all on `{base.name}`": ("base", base.name) for base in self.bases}
        groups = {
            name: [row for row in done if row[column] == value]
            for name, (column, value) in (of_kind | of_base).items()
        }
        groups["all"] = done
        lines += [self._line(name, own) for name, own in groups.items() if own]
        ended = Counter(row["outcome"] for row in rows)
        cpu_s = sum(row.get("track_cpu_s", 0.0) + row.get("judge_cpu_s", 0.0) for row in rows)
        unknown = sum("word" in row and row["mean_mm"] is None for row in rows)
        told = ", ".join(f"{name} {count}" for name, count in ended.most_common())
        lines += ["", f"{told}; without a truth {unknown}; {cpu_s:.0f} CPU s."]
        if not self.wrong:
            # Right input, and yet a mesh that is far off and trusted: nothing else counts these.
            lines.append(f"Trusted and far off: {sum(map(false_trust, rows))}.")
        if reasons := Counter(row["error"] for row in rows if row["outcome"] == "skipped"):
            lines += [f"- skipped: {reason} ({count})" for reason, count in reasons.items()]
        return "\n".join(lines) + "\n"

    def _line(self, name: str, rows: Sequence[Row]) -> str:
        words = Counter(row.get("word", row["outcome"]) for row in rows)
        trusted = [row["mean_mm"] for row in rows if row.get("word") == "trust"]
        worst = max((error for error in trusted if error is not None), default=None)
        found = sum((false_trust if self.wrong else false_alarm)(row) for row in rows)
        share = f"{found} ({100 * found / max(1, len(rows)):.0f} %)" if found else "0"
        cells = [words[word] for word in ("refused", "reject", "look", "trust")]
        shown = " | ".join(map(str, [len(rows), *cells, share, _or_dash(worst)]))
        return f"| {name} | {shown} |"


def false_trust(row: Row) -> bool:
    """Return whether a mesh is trusted, and wrong."""
    if row.get("word") != "trust" or row["mean_mm"] is None:
        return False
    return row["mean_mm"] > WRONG_MEAN_MM or row["p95_mm"] > WRONG_P95_MM


def false_alarm(row: Row) -> bool:
    """Return whether a right recording is refused, or its mesh is right and not trusted."""
    if row["outcome"] == "refused":
        return True
    if row.get("word") not in ("look", "reject") or row["mean_mm"] is None:
        return False
    return row["mean_mm"] < RIGHT_MEAN_MM and row["p95_mm"] < RIGHT_P95_MM


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _judged(kind: Kind, base: Base, rng: np.random.Generator, stage: Path, box: Path) -> Row:
    """In a child: everything of a case; what the package refuses is a result like another."""
    from clothtrack.errors import ClothTrackError

    try:
        source = load(base, stage)
    except MissingBaseError as error:
        return {"outcome": "skipped", "error": str(error)}
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
    data, strength = kind(source, rng)
    row: Row = {"strength": round(strength, 3), "unit": kind.unit}
    folder = box / "recording"
    shutil.rmtree(folder, ignore_errors=True)
    heard = _Heard()
    logging.getLogger("clothtrack").addHandler(heard)
    clock = time.process_time()
    try:
        row |= _tracked(data.write(folder), data)
    except ClothTrackError as error:
        line = str(error).replace(str(folder), folder.name)
        row |= {"outcome": "refused", "error": f"{type(error).__name__}: {line}"}
        row["track_cpu_s"] = round(time.process_time() - clock, 2)
    except Exception as error:  # noqa: BLE001
        # A defect of the package, or of the kind: it is shown, and the other cases go on.
        row |= {"outcome": "crashed", "error": f"{type(error).__name__}: {error}"}
    return {**row, "warnings": heard.lines}


def _tracked(folder: Path, data: RecordingData) -> Row:
    import clothtrack as ct

    clock = time.process_time()
    run = ct.track(folder, settings=(f"initial_state.vertex_count={VERTICES}",))
    tracked_s, clock = time.process_time() - clock, time.process_time()
    verdict = run.verdict
    labels = run.labels
    judged_s = time.process_time() - clock
    expected = verdict.expected_error_m
    row: Row = {
        "outcome": "judged",
        "word": verdict.word,
        "reason": verdict.reason,
        "expected_mm": round(1e3 * expected, 3) if np.isfinite(expected) else None,
        "track_cpu_s": round(tracked_s, 2),
        "judge_cpu_s": round(judged_s, 2),
        "mean_mm": None,
        "p95_mm": None,
    }
    if data.truth is None:
        return row
    errors = _Errors(run, data)
    # The mesh after the last action goes on to the end of the film, and people use it.
    meshes = [(label.frame, label.positions) for label in labels]
    meshes.append((int(run.frames[-1]), run.positions[-1]))
    ends = [{"frame": int(frame), **errors.of(frame, positions)} for frame, positions in meshes]
    near = [
        int((errors.each(label.frame, label.positions) <= label.vertex_bounds_m).sum())
        for label in labels
    ]
    return row | {
        "mean_mm": max(end["mean_mm"] for end in ends),
        "p95_mm": max(end["p95_mm"] for end in ends),
        "vertices": len(run.mesh.vertices),
        "vertices_within": min(near, default=None),
        "ends": ends,
    }


class _Errors:
    """True errors of meshes of one run."""

    def __init__(self, run: Any, data: RecordingData) -> None:
        from clothtrack.evaluation import Truth
        from clothtrack.evaluation.naming import true_places

        self._truth, self._where = data.truth[data.moments], None
        if data.truth_faces is None:
            return
        self._faces = data.truth_faces
        truth = Truth(self._truth, self._faces, np.arange(len(self._truth)), data.truth_canonical)
        self._where = true_places(run, truth)

    def points(self, frame: int) -> np.ndarray | None:
        """Return where the tracked vertices really are [m]; None where a surface alone is known."""
        from clothtrack.evaluation import material_points

        if self._where is None:
            return None
        return material_points(self._truth[frame], self._faces, self._where)

    def each(self, frame: int, positions: np.ndarray) -> np.ndarray:
        """Return the error of every vertex [m]; against a surface alone, its distance."""
        points = self.points(frame)
        if points is None:
            return cKDTree(self._truth[frame]).query(positions)[0]
        return np.linalg.norm(positions - points, axis=1)

    def of(self, frame: int, positions: np.ndarray) -> Row:
        """Mean, 95th percentile, and the mean after the best rigid motion [mm]."""
        errors = 1e3 * self.each(frame, np.asarray(positions, np.float64))
        row = {"mean_mm": errors.mean(), "p95_mm": np.percentile(errors, 95)}
        points = self.points(frame)
        if points is not None:
            row["rigid_mm"] = 1e3 * without_slip(np.asarray(positions, np.float64), points)
        return {name: round(float(value), 3) for name, value in row.items()}


class _Heard(logging.Handler):
    """Keeps the warnings of the package, each once."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one line."""
        line = record.getMessage()[:300]
        if line not in self.lines:
            self.lines.append(line)


WRONG = Proof(KINDS, [base for base in BASES if base.wrong], wrong=True)
HARMLESS_PROOF = Proof(HARMLESS, BASES, wrong=False)
