"""Score label quality from observables against the true error; fitted on dev, scored on test.

    python experiments label_quality --bench OUT --rows OUT/experiments
    python experiments label_quality --bench OUT --rows DEV_ROWS TEST_ROWS --fit

The rows are those of table1.py; the meshes of its runs are evaluated together with their
recordings. `--fit` fits the model on the labels of the split `dev`, and on no other, and writes the
file that the package reads (or the one that `--model` names). The values for `dev` are
cross-validated: each trajectory is judged by a model that was not fitted on it. Every other split
is scored by the unchanged model. All judged labels are written to label_quality.jsonl in the first
folder of rows.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from scipy.stats import spearmanr
from shared.bench_measures import Row
from shared.bench_runs import kept_labels, read_rows, write_rows
from shared.figures import say
from shared.held_out import require_apart
from shared.tables import table

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_evidence import EVIDENCE_NAMES, LabelEvidence, label_evidence
from clothtrack.evaluation.label_quality import SHIPPED, SHRINKAGE, QualityModel, fit_quality
from clothtrack.geometry.devices import quiet_warp
from clothtrack.recordings.store import read_recording

FITTED_ON = "dev"
TARGET = 0.8
LEAST_LABELS = 4
LEAST_TRAJECTORIES = 3


@dataclass(frozen=True)
class Judged:
    """One label of the benchmark, with evidence and truth."""

    row: Row
    evidence: LabelEvidence

    @property
    def error_m(self) -> float:
        """Its true mean vertex error [m]."""
        return 1e-3 * float(self.row["error_all_mm"])

    @property
    def recording(self) -> str:
        """The trajectory that it belongs to."""
        return str(self.row["recording"])


def judged_labels(bench: Path, folders: Sequence[Path], variant: str) -> list[Judged]:
    """Return the labels of a variant's runs in folders of rows, with their evidence."""
    runs: dict[tuple[Path, str], list[Row]] = {}
    for folder in folders:
        file = folder / "table1.jsonl"
        if not file.exists():
            raise InvalidResultError(
                f"{folder} has no table1.jsonl; give the --out folder of table1.py"
            )
        for row in read_rows(file):
            wanted = "error" not in row and row["variant"] == variant and row["stage"] == "after"
            if wanted and row["error_all_mm"] is not None:
                runs.setdefault((folder, str(row["run"])), []).append(row)
    found = []
    for (folder, run), rows in runs.items():
        recording = read_recording(bench / "recordings" / str(rows[0]["recording"]))
        mesh, labels = kept_labels((folder / run).with_suffix(".npz"))
        evidence = label_evidence(mesh, labels, recording)
        found += [Judged(row, evidence[int(row["action"]) - 1]) for row in rows]
    require_fitted_apart(bench, found)
    return found


def fitted(labels: Sequence[Judged], variant: str) -> QualityModel:
    """Return the model of the labels of `dev`, with the data to reproduce it."""
    own = [one for one in labels if one.row["split"] == FITTED_ON]
    if len({one.recording for one in own}) < LEAST_TRAJECTORIES:
        raise InvalidConfigError(
            f"the rows hold labels of fewer than {LEAST_TRAJECTORIES} trajectories of the split "
            f"{FITTED_ON!r}; run table1.py --split {FITTED_ON} --only {variant} first"
        )
    stamps = [one.row["provenance"] for one in own]
    errors, evidence = np.array([one.error_m for one in own]), [one.evidence for one in own]
    expected = cross_validated(evidence, errors, [one.recording for one in own])
    provenance = {
        "command": "experiments label_quality --fit",
        "split": FITTED_ON,
        "variant": variant,
        "labels": len(own),
        "trajectories": len({one.recording for one in own}),
        "commits": sorted({str(stamp["commit"]) for stamp in stamps}),
        "config_hashes": sorted({str(stamp["config_hash"]) for stamp in stamps}),
        "errors_mm": [round(1e3 * float(end), 2) for end in (errors.min(), errors.max())],
        "rank_correlation_cross_validated": round(rank_correlation(expected, errors), 3),
    }
    return fit_quality(evidence, errors, provenance=provenance)


def require_fitted_apart(bench: Path, labels: Sequence[Judged]) -> None:
    """Refuse labels of recordings that the model is fitted on, under another name or split."""
    folders: dict[bool, dict[str, Path]] = {True: {}, False: {}}
    for one in labels:
        fitted_on = one.row["split"] == FITTED_ON
        folders[fitted_on][one.recording] = bench / "recordings" / one.recording
    require_apart(folders[True].values(), folders[False].values())


def cross_validated(
    evidence: Sequence[LabelEvidence],
    errors_m: Float[np.ndarray, " labels"],
    groups: Sequence[str],
    *,
    shrinkage: float = SHRINKAGE,
) -> Float[np.ndarray, " labels"]:
    """Return expected error [m] of each label by a model that saw no label of its group.

    Args:
        errors_m: their true mean vertex errors [m].
    """
    expected = np.empty(len(errors_m))
    member = np.array(groups)
    for name in dict.fromkeys(groups):
        others = np.flatnonzero(member != name)
        chosen = [evidence[index] for index in others]
        model = fit_quality(chosen, np.asarray(errors_m)[others], shrinkage=shrinkage)
        for index in np.flatnonzero(member == name):
            expected[index] = model.expected_error_m(evidence[index])
    return expected


def rank_correlation(a: Iterable[float], b: Iterable[float]) -> float:
    """Spearman's rank correlation of the pairs that are known; NaN without spread."""
    pairs = np.array([list(a), list(b)], np.float64)
    pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
    if pairs.shape[1] < LEAST_LABELS or (np.ptp(pairs, axis=1) == 0).any():
        return float("nan")
    return float(spearmanr(*pairs).statistic)


def expectations(
    labels: Sequence[Judged], model: QualityModel
) -> dict[str, tuple[list[Judged], np.ndarray]]:
    """Return, per split, its labels and their expected errors [m]; for `dev`, cross-validated."""
    parts = {}
    for split in sorted({str(one.row["split"]) for one in labels}):
        own = [one for one in labels if one.row["split"] == split]
        names = [one.recording for one in own]
        if split == FITTED_ON and len(set(names)) > 1:
            errors = np.array([one.error_m for one in own])
            expected = cross_validated([one.evidence for one in own], errors, names)
        else:
            expected = np.array([model.expected_error_m(one.evidence) for one in own])
        parts[split] = own, expected
    return parts


def scores(parts: dict[str, tuple[list[Judged], np.ndarray]]) -> str:
    """Return rank correlation by split, garment and action, and the benefit of dropping labels."""
    head = [
        "split", "n", "rank correlation", "towels", "T-shirts", "action 1", "2", "3",
        "off by a factor", "mean error mm", "better half by quality", "better half in truth",
    ]  # fmt: skip
    lines = []
    for split, (own, expected) in parts.items():
        errors = np.array([one.error_m for one in own])
        groups = [
            np.ones(len(own), bool),
            *(np.array([one.row["kind"] == kind for one in own]) for kind in ("towel", "tshirt")),
            *(np.array([one.row["action"] == action for one in own]) for action in (1, 2, 3)),
        ]
        ranks = [rank_correlation(expected[group], errors[group]) for group in groups]
        factor = float(np.exp(np.nanmean(np.abs(np.log(expected / errors)))))
        half = (len(own) + 1) // 2
        means = [errors.mean(), errors[np.argsort(expected)][:half].mean()]
        means.append(np.sort(errors)[:half].mean())
        word = f"{split}, cross-validated" if split == FITTED_ON else split
        lines.append(
            [word, str(len(own)), *(f"{rank:.2f}" for rank in ranks), f"{factor:.2f}"]
            + [f"{1e3 * mean:.1f}" for mean in means]
        )
    return table(head, lines)


def single_evidence(labels: Sequence[Judged], model: QualityModel) -> str:
    """Return rank correlation and weight of each piece of evidence alone on `dev`."""
    own = [one for one in labels if one.row["split"] == FITTED_ON]
    if not own:
        return f"No labels of the split {FITTED_ON}: nothing is said of single evidence."
    errors = [one.error_m for one in own]
    lines = []
    for name in EVIDENCE_NAMES:
        values = [float(one.evidence.as_dict()[name]) for one in own]
        ranks = [rank_correlation(values, errors)]
        for kind in ("towel", "tshirt"):
            chosen = [index for index, one in enumerate(own) if one.row["kind"] == kind]
            ranks.append(rank_correlation([values[i] for i in chosen], [errors[i] for i in chosen]))
        ranked = [f"{rank:+.2f}" for rank in ranks]
        ends = " / ".join(f"{one:.3g}" for one in np.nanpercentile(values, [10, 50, 90]))
        lines.append([name, *ranked, ends, f"{model.weights.get(name, 0.0):.3f}"])
    return table(["evidence", "dev", "towels", "T-shirts", "10 / 50 / 90 %", "weight"], lines)


def kept_rows(parts: dict[str, tuple[list[Judged], np.ndarray]]) -> list[Row]:
    """Return one row per label: evidence, expected and true error."""
    keys = ("variant", "recording", "kind", "split", "run", "action", "frame", "error_all_mm")
    return [
        {
            "experiment": "label_quality",
            **{key: one.row[key] for key in keys},
            "expected_error_mm": 1e3 * error,
            "cross_validated": split == FITTED_ON,
            "evidence": one.evidence.as_dict(),
            "provenance": one.row["provenance"],
        }
        for split, (own, expected) in parts.items()
        for one, error in zip(own, expected, strict=True)
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge the labels, fit if requested, print the tables; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bench", type=Path, required=True, help="folder of the benchmark")
    parser.add_argument("--rows", type=Path, nargs="+", required=True, help="folders of rows")
    parser.add_argument("--variant", default="default", help="whose labels are judged")
    parser.add_argument("--model", type=Path, default=SHIPPED, help="the package's own by default")
    parser.add_argument("--fit", action="store_true", help=f"fit the model on {FITTED_ON} first")
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        labels = judged_labels(options.bench, options.rows, options.variant)
        if options.fit:
            fitted(labels, options.variant).save(options.model)
        model = QualityModel.load(options.model)
        parts = expectations(labels, model)
    except (ClothTrackError, FileNotFoundError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    write_rows(kept_rows(parts), options.rows[0] / "label_quality.jsonl")
    say(f"## Label quality: rank correlation with the true error (target {TARGET})\n\n")
    say(f"{scores(parts)}\n\n{single_evidence(labels, model)}\n")
    return 0 if labels else 1


if __name__ == "__main__":
    sys.exit(main())
