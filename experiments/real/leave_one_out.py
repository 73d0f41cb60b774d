"""Leave-one-out on real napkins: learning from labels of other fabrics, or of the same fabric.

    python experiments leave_one_out --data DIR --json OUT
    python experiments leave_one_out --data DIR --json OUT --learn-from same_fabric

DIR has robot-lift-fold-clouds: ten lifts and folds of three fabrics. For each fabric, the shipped
token network learns from all sequences of the others, and is scored on those of the fabric. With
`same_fabric`, the protocol of the paper, it is scored on each sequence after learning from the
others of its fabric. The recipe was fixed before the first run: `finetune_short` of the package,
evaluated every fourth epoch, with three in ten of the training sequences, at least one, for
selecting the weights. The labels are the control's pictures, labels of open loop and of the default
tracker, and the default's and the control's together, as made and stored by `table2_real`.

Finished results are written after every fold, and a second call resumes. `--labels` takes any of
them.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row
from shared.figures import say, write_json
from shared.learning_runs import Tuner
from shared.table_column import table

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.provenance import commit
from clothtrack.geometry.devices import quiet_warp
from real import table2_real
from real.robot_learning import Napkin, napkins, refuse_shared
from real.table2_real import CONTROL, JOINED, NETWORKS, NONE, TRACKER, Plan

LABELS = (NONE, CONTROL, "open_loop", "default", JOINED)
SETTINGS = ("tokens.evaluate_epochs=4",)
HELD_OUT_SHARE = 0.3

MEASURES = (
    ("chamfer_pc_m2", "Chamfer PC", 1e4),
    ("chamfer_mesh_m2", "Chamfer Mesh", 1e4),
    ("corner_mm", "corner to gripper, mm", 1.0),
    ("second_camera_mm", "second camera, mm", 1.0),
)


def fabric_of(name: str) -> str:
    """Return the fabric of a sequence, which its takes share: "tan" of "lift_tan2"."""
    return name.partition("_")[2].rstrip("0123456789")


Folds = dict[str, dict[str, list[Napkin]]]
"""What is learned from, "train", and what is judged, "left out", by the name of the fold."""


def other_fabrics(found: Sequence[Napkin]) -> Folds:
    """Return one fold for each fabric: all sequences of the others are learned from."""
    fabrics = sorted({fabric_of(one.name) for one in found})
    if len(fabrics) < 2:
        raise InvalidConfigError(f"all sequences are of one fabric, {fabrics}; give those of two")
    parts = {}
    for fabric in fabrics:
        train = [one for one in found if fabric_of(one.name) != fabric]
        left_out = [one for one in found if fabric_of(one.name) == fabric]
        refuse_shared(train, left_out)
        parts[fabric] = {"train": train, "left out": left_out}
    return parts


def same_fabric(found: Sequence[Napkin]) -> Folds:
    """Return one fold for each sequence: the others of its fabric are learned from."""
    parts = {}
    for one in found:
        train = [
            other
            for other in found
            if other is not one and fabric_of(other.name) == fabric_of(one.name)
        ]
        if not train:
            raise InvalidConfigError(
                f"{one.file} is the only sequence of its fabric; give another, or learn from "
                "other_fabrics"
            )
        refuse_shared(train, [one])
        parts[one.name] = {"train": train, "left out": [one]}
    return parts


FOLDS = {"other_fabrics": other_fabrics, "same_fabric": same_fabric}


def rows_of(
    plan: Plan, parts: Mapping[str, Mapping[str, Sequence[Napkin]]], labels: Sequence[str]
) -> Iterator[list[Row]]:
    """Yield the pictures of all that is left out, one kind of label and one fold at a time."""
    for network, start in plan.starts.items():
        for name in (*labels, TRACKER):
            for left_out, splits in parts.items():
                fold = replace(plan, splits=splits)
                weights = start if name == NONE else None
                if name not in (NONE, TRACKER):
                    weights = fold.tuner.tuned(start, fold.labels(name))
                named = {"network": network, "labels": name, "fold": left_out}
                pictures = fold.all_pictures(splits["left out"], weights)
                yield [{**named, **picture} for picture in pictures]


def tables(rows: Sequence[Row]) -> str:
    """Over all pictures, and the median Chamfer distance of each sequence."""
    parts = []
    for network in dict.fromkeys(row["network"] for row in rows):
        own = [row for row in rows if row["network"] == network]
        by_label = {
            name: [row for row in own if row["labels"] == name]
            for name in dict.fromkeys(str(row["labels"]) for row in own)
        }
        parts.append(f"## {network}: all pictures of what was left out")
        head = ["learned from", "pictures"]
        for _, title, _ in MEASURES:
            head += [f"{title}: median", "mean"]
        lines = [_line(name, pictures) for name, pictures in by_label.items()]
        parts.append(table([*head, "nearer than before"], _compared(lines, by_label)))
        sequences = list(dict.fromkeys(str(row["sequence"]) for row in own))
        lines = [
            [name, *(_median(_of(pictures, one)) for one in sequences)]
            for name, pictures in by_label.items()
        ]
        parts.append(table(["Chamfer PC, median, 1e-4 m^2", *sequences], lines))
    return "\n\n".join(parts) + "\n"


def _line(name: str, pictures: Sequence[Row]) -> list[str]:
    line = [name, str(len(pictures))]
    for key, _, factor in MEASURES:
        known = [factor * float(one[key]) for one in pictures if one.get(key) is not None]
        line += [f"{np.median(known):.1f}", f"{np.mean(known):.1f}"] if known else ["-", "-"]
    return line


def _compared(
    lines: Iterable[list[str]], by_label: Mapping[str, Sequence[Row]]
) -> Iterator[list[str]]:
    """Each line with how many pictures have a lower Chamfer PC than before."""
    before = {_picture(one): one.get("chamfer_pc_m2") for one in by_label.get(NONE, ())}
    for line in lines:
        pairs = [
            (one.get("chamfer_pc_m2"), before[_picture(one)])
            for one in by_label[line[0]]
            if before.get(_picture(one)) is not None
        ]
        lower = sum(now is not None and now < then for now, then in pairs)
        yield [*line, f"{lower} of {len(pairs)}" if line[0] != NONE and pairs else "-"]


def _picture(row: Row) -> tuple[object, object]:
    return row["sequence"], row["frame"]


def _of(pictures: Sequence[Row], sequence: str) -> list[float]:
    own = [one.get("chamfer_pc_m2") for one in pictures if one["sequence"] == sequence]
    return [1e4 * float(value) for value in own if value is not None]


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f}" if values else "-"


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is missing, print the tables; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder that holds the set")
    parser.add_argument("--json", type=Path, help="rows; all else lies beside it")
    parser.add_argument("--labels", nargs="+", choices=LABELS, default=LABELS, help="all of them")
    parser.add_argument(
        "--learn-from", choices=list(FOLDS), default="other_fabrics", help="of each that is judged"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes that measure")
    parser.add_argument("--smoke", action="store_true", help="drawn clouds, one epoch")
    options = parser.parse_args(arguments)
    if not options.smoke and (options.data is None or options.json is None):
        parser.error("give --data DIR and --json OUT, or --smoke")
    quiet_warp()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="leave-one-out-") as temporary:
        try:
            plan = _smoke(options, Path(temporary)) if options.smoke else _planned(options)
            found = napkins(options.data, options.json.with_suffix("") / "recordings")
            for pictures in rows_of(plan, FOLDS[options.learn_from](found), options.labels):
                rows += pictures
                write_json(options.json, {"commit": commit(), "rows": rows})
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
    if options.smoke:
        say("Smoke run: drawn clouds, one epoch; no result.\n\n")
    say(tables(rows))
    return 0


def _planned(options: argparse.Namespace) -> Plan:
    keep = options.json.with_suffix("")
    tuner = Tuner(keep / "networks", "finetune_short", SETTINGS, held_out_share=HELD_OUT_SHARE)
    return Plan(keep, {}, {"tokens": NETWORKS["tokens"]}, tuner, workers=options.workers)


def _smoke(options: argparse.Namespace, temporary: Path) -> Plan:
    """Return a published network that has learned nothing, in place of the token network."""
    options.networks, options.training = ["published"], "finetune_short"
    options.settings, options.test = [], None
    return table2_real.smoke(options, temporary)


if __name__ == "__main__":
    sys.exit(main())
