"""Run the reliability tests: kills, damaged input, a long run, physics, full disks, trust.

Claims judged: whatever the moment of a `kill -9`, nothing finished is lost and the same command
ends with the same bits; whatever is damaged is refused in one line; a process that tracks many
recordings does not grow; no permitted physics leaves the finite numbers or crosses the table, and
near the default (`near`) none gains energy; a full or read-only disk costs nothing that was there;
no recording that is wrong (`wrong`) ends in a mesh that is trusted and far off, and none that is
right (`harmless`) in one that is right and not trusted.

    python experiments reliability --out OUT [--only kills fuzz soak physics near disk]
    python experiments reliability --out OUT --only wrong harmless --data DIR
    python experiments reliability --out OUT --case fuzz:1234     one case again, alone

Finished cases are kept in OUT/KIND.jsonl, and a second call resumes. A case depends only on its
number and on `--seed`. `--smoke` takes a few cases of each kind.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import _path  # noqa: F401
from shared import full_disk, fuzz, kills, near_physics, random_physics, soak, wrong_proof
from shared.figures import say, write_json
from shared.proof_bases import REAL
from shared.proof_stage import prepared
from shared.trial import preload

PROOFS = {"kills": kills, "fuzz": fuzz, "soak": soak, "physics": random_physics,
          "near": near_physics, "disk": full_disk, "wrong": wrong_proof.WRONG,
          "harmless": wrong_proof.HARMLESS_PROOF}  # fmt: skip
COUNTS = {"kills": 200, "fuzz": 10_000, "soak": 50, "physics": 1000, "near": 1000,
          "disk": 2 * full_disk.COUNT, "wrong": 1000, "harmless": 500}  # fmt: skip
SMOKE = {"kills": 1, "fuzz": 9, "soak": 2, "physics": 8, "near": 8, "disk": 2, "wrong": 3,
         "harmless": 2}  # fmt: skip
OWN_STAGE = {"wrong", "harmless"}
"""Proofs that do not need the small world."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Do the cases that are missing, print the tables; 1 where a case shows a defect."""
    options = parse(arguments)
    preload()
    with tempfile.TemporaryDirectory(prefix="reliability-") as temporary:
        out = (options.out or Path(temporary)).resolve()
        # One case alone may be tried while the others run.
        box = out / ("alone" if options.case else "box")
        box.mkdir(parents=True, exist_ok=True)
        kind, _, number = (options.case or "").partition(":")
        stage = staged(out / "stage", {kind} if kind else set(options.only), options.data)
        if options.case:
            row = PROOFS[kind].case(int(number), options.seed, stage, box)
            say(json.dumps(row, indent=1) + "\n")
            return int(PROOFS[kind].violates(row))
        report = {}
        for kind in options.only:
            count = SMOKE[kind] if options.smoke else getattr(options, kind)
            report[kind] = cases(kind, count, options.seed, stage, out, kinds=options.kinds)
            say(f"\n{kind}\n\n{PROOFS[kind].markdown(report[kind])}")
        if options.json is not None:
            tables = {kind: PROOFS[kind].markdown(rows) for kind, rows in report.items()}
            write_json(options.json, {"seed": options.seed, "tables": tables, "rows": report})
    wrong = [(kind, row) for kind, rows in report.items() for row in rows
             if PROOFS[kind].violates(row)]  # fmt: skip
    for kind, row in wrong:
        say(f"{kind}:{row['case']}  {json.dumps(row)[:600]}\n")
    return 1 if wrong else 0


def staged(folder: Path, kinds: set[str], data: Path | None) -> Path:
    """Return the folder of what the proofs work on, with what these kinds need."""
    folder.mkdir(parents=True, exist_ok=True)
    if data is not None and not (folder / REAL).exists():
        (folder / REAL).symlink_to(data.resolve(), target_is_directory=True)
    return folder if kinds <= OWN_STAGE else prepared(folder)


def cases(
    kind: str, count: int, seed: int, stage: Path, out: Path, *, kinds: Sequence[str] = ()
) -> list[dict]:
    """Return the rows of the first `count` cases; those that are missing are done, one by one.

    With `kinds`, only the cases of these kinds of change.
    """
    told = progress(kind, count)
    file, proof = out / f"{kind}.jsonl", PROOFS[kind]
    if hasattr(proof, "rows"):
        # One process does all of them: there is nothing to go on from.
        told(0)
        made = proof.rows(count, seed, stage, out / "box")
        file.write_text("".join(json.dumps(row) + "\n" for row in made))
        return made
    done = {row["case"]: row for row in read_rows(file) if row["seed"] == seed}
    wanted = range(count)
    if kinds:
        wanted = [n for n in wanted if proof.kinds[n % len(proof.kinds)].name in kinds]
    for number in wanted:
        if number not in done:
            told(number)
            row = proof.case(number, seed, stage, out / "box")
            done[number] = {"case": number, "seed": seed, **row}
            with file.open("a", encoding="utf-8") as rows:
                rows.write(json.dumps(done[number]) + "\n")
    return [done[number] for number in wanted]


def read_rows(file: Path) -> list[dict]:
    """Return the rows of a file; of a line that a kill cut off, nothing."""
    rows = []
    for line in file.read_text("utf-8").splitlines() if file.exists() else ():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def progress(kind: str, count: int) -> Callable[[int], None]:
    """Says how far it is, every hundredth part."""

    def told(number: int) -> None:
        if number % max(count // 100, 1) == 0:
            sys.stderr.write(f"{kind}: {number} of {count}\n")

    return told


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder of the rows and of the small world")
    parser.add_argument("--only", nargs="+", choices=PROOFS, default=list(PROOFS))
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, help=f"cases ({count})")
    parser.add_argument("--data", type=Path, help="folder of the real sets, for wrong and harmless")
    parser.add_argument(
        "--kinds", nargs="+", default=(), help="of wrong or harmless: the cases of these alone"
    )
    parser.add_argument("--seed", type=int, default=0, help="of all cases")
    parser.add_argument("--case", help="one case, such as fuzz:1234; nothing is kept")
    parser.add_argument("--json", type=Path, help="write rows and tables to this file")
    parser.add_argument("--smoke", action="store_true", help="a few cases of each kind")
    options = parser.parse_args(arguments)
    if options.out is None and not options.smoke:
        parser.error("give --out FOLDER, or --smoke")
    if options.kinds and not set(options.only) <= OWN_STAGE:
        parser.error("--kinds needs --only wrong, harmless or both")
    kind, _, number = (options.case or "kills:0").partition(":")
    if kind not in PROOFS or not number.isdigit():
        parser.error("--case is KIND:NUMBER, such as fuzz:1234")
    return options


if __name__ == "__main__":
    sys.exit(main())
