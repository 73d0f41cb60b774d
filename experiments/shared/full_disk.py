"""Test every writing verb on a full disk and a read-only folder: one line, and no damage.

If root may mount, the disks are small tmpfs mounts, the second of them read-only. Otherwise a full
disk is imitated by a limit on the size of files, and the read-only one is left out.
"""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from shared.kills import CPU_S, undisturbed
from shared.proof_verbs import VERBS, before
from shared.same_content import contents, hidden_in
from shared.trial import Limits, run

USUAL = tuple(verb for verb in VERBS if not verb.dear)
COUNT = len(USUAL)
MINE = "mine.txt"
CHECKS = ("one line", "nothing harmed", "nothing half-written", "nothing hidden", "then whole")
PAGE = 4096
SMALLEST = 2 * PAGE
"""Size of the smallest disk [bytes]: one page has the file that is there before."""


def case(number: int, seed: int, stage: Path, box: Path) -> dict:
    """Return one verb on a disk that gets full at a seeded moment, or on a read-only one.

    The first `COUNT` cases are full disks, the next as many read-only ones, and so on.
    """
    verb, full = USUAL[number % COUNT], (number // COUNT) % 2 == 0
    row: dict = {"verb": verb.name, "disk": "full" if full else "read-only"}
    known = undisturbed(verb, stage, box)
    wanted = {**known["contents"]}
    out = box / "out"
    verb.fresh(stage, out)
    space = int(_size(box, verb, stage) * np.random.default_rng([seed, number]).uniform(0, 0.9))
    shutil.rmtree(out)
    out.mkdir()
    with mounted(out, max(space, SMALLEST) + _input_size(stage, verb)) as is_mounted:
        if not is_mounted and not full:
            return {**row, "left out": "nobody but root may mount"}
        _fill(verb, stage, out)
        was = contents(out)
        if is_mounted and not full:
            _mount("-o", "remount,ro", str(out))
        limit = None if is_mounted else 1000
        done = run(verb.words(stage, out), box, before=before,
                   limits=Limits(cpu_s=CPU_S, file_bytes=limit))  # fmt: skip
        there = contents(out)
        made = {name for name in there if there[name] != was.get(name)}
        row["fitted"] = full and done.code == 0
        row["one line"] = row["fitted"] or (done.code == 1 and len(done.complaints) == 1)
        row["nothing harmed"] = set(was) <= set(there) and there[MINE] == was[MINE]
        row["nothing half-written"] = all(name in wanted for name in made)
        row["nothing hidden"] = not hidden_in(out)
        if is_mounted:
            _mount("-o", "remount,rw,size=1g", str(out))
        again = run(verb.words(stage, out), box, before=before, limits=Limits(cpu_s=CPU_S))
        end = contents(out)
        end.pop(MINE)
        row["then whole"] = end == wanted and (again.code == 0 or not verb.keeps)
        if violates(row):
            row["seen"] = {"code": done.code, "said": done.complaints[:4], "again": again.code,
                           "again said": again.complaints[:2],
                           "made": sorted(made)[:6], "hidden": hidden_in(out)[:6],
                           "differing": sorted(set(end.items()) ^ set(wanted.items()))[:6],
                           }  # fmt: skip
    return row


def _fill(verb: object, stage: Path, out: Path) -> None:
    """Write the files present before the run: a foreign file, and what the verb changes."""
    (out / MINE).write_text("mine")
    if verb.copied is not None:
        shutil.copytree(stage / verb.copied[0], out / verb.copied[1])


def _input_size(stage: Path, verb: object) -> int:
    """Return room that copied inputs take on a disk of pages [bytes]."""
    if verb.copied is None:
        return 0
    return _pages(stage / verb.copied[0])


def _pages(folder: Path) -> int:
    """Return room that the files of a folder take on a tmpfs [bytes]."""
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return sum(-(-size // PAGE) * PAGE for size in sizes)


def _size(box: Path, verb: object, stage: Path) -> int:
    """Return room that the results of an undisturbed run take [bytes]; measured once."""
    kept = box / "undisturbed" / "sizes" / verb.name.replace(" ", "_")
    if not kept.exists():
        out = box / "out"
        run(verb.words(stage, out), box, before=before, limits=Limits(cpu_s=CPU_S))
        total = _pages(out)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(str(total - _input_size(stage, verb)))
    return max(int(kept.read_text()), 0)


@contextmanager
def mounted(folder: Path, size: int) -> Iterator[bool]:
    """Yield whether a separate disk could be mounted at a folder."""
    try:
        _mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder))
    except (OSError, subprocess.CalledProcessError):
        yield False
        return
    try:
        yield True
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def _mount(*words: str) -> None:
    subprocess.run(["mount", *words], check=True, capture_output=True)


def violates(row: dict) -> bool:
    """Return whether a case shows a defect."""
    return "left out" not in row and not all(row[check] for check in CHECKS)


def markdown(rows: list[dict]) -> str:
    """Return a line per kind of disk."""
    lines = ["| disk | cases | the work fitted | " + " | ".join(CHECKS) + " | left out |",
             "|---|---:|---:|" + "---:|" * (len(CHECKS) + 1)]  # fmt: skip
    for disk in ("full", "read-only"):
        mine = [row for row in rows if row["disk"] == disk]
        tried = [row for row in mine if "left out" not in row]
        passed = " | ".join(str(sum(row[check] for row in tried)) for check in CHECKS)
        fitted = sum(row["fitted"] for row in tried)
        lines.append(f"| {disk} | {len(tried)} | {fitted} | {passed} | {len(mine) - len(tried)} |")
    return "\n".join(lines) + "\n"
