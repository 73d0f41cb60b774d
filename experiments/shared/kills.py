"""Test `kill -9` at a seeded moment, followed by the same command: what is lost or differs.

Half of the kills come after a share of the CPU time of an undisturbed run, the others before one of
its changes of the file system, where a file may be half-written.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

import clothtrack
from shared.proof_verbs import VERBS, Verb, before
from shared.same_content import contents, hidden_in
from shared.trial import Limits, Trial, run

SOURCES = Path(clothtrack.__file__).parent

CPU_S = 120
"""No run takes longer [s]."""

CHECKS = ("whole", "nothing lost", "rerun", "same bits", "nothing hidden")


def case(number: int, seed: int, stage: Path, box: Path, names: tuple[str, ...] = ()) -> dict:
    """Kill one verb once and run it again; a row with a check each.

    Args:
        number: of the case; verbs take turns.
        seed: of the proof.
        stage: the small world.
        box: folder of cases.
        names: only these verbs; all but dear ones by default.
    """
    verbs = [verb for verb in VERBS if verb.name in names or (not names and not verb.dear)]
    verb = verbs[number % len(verbs)]
    rng = np.random.default_rng([seed, number])
    known = undisturbed(verb, stage, box)
    if rng.random() < 0.5:
        limits = Limits(cpu_s=CPU_S, kill_cpu_s=float(rng.uniform(0.02, 0.95)) * known["cpu_s"])
    else:
        limits = Limits(cpu_s=CPU_S, kill_change=int(rng.integers(known["changes"])))
    out = box / "out"
    verb.fresh(stage, out)
    began = _times(out)
    killed = run(verb.words(stage, out), box, limits=limits, before=before)
    row = {"verb": verb.name, "killed": killed.code == -9, "moment": _moment(limits)}
    there, times = contents(out), _times(out)
    made = {name for name in there if times[name] != began.get(name)}
    again = run(verb.words(stage, out), box, limits=Limits(cpu_s=CPU_S), before=before)
    end, wanted = contents(out), known["contents"]
    # Lists and documents grow: they must be whole, and the end decides what they hold.
    growing = {name for name in made if _is_document(out / name)}
    odd = sorted(name for name in made - growing if there[name] != wanted.get(name))
    row["whole"] = not odd and all(name in wanted for name in made)
    row["nothing lost"] = set(there) <= set(end)
    row["rerun"] = again.code == 0 or _refused_whole(verb, again, end == wanted)
    row["same bits"] = end == wanted
    row["nothing hidden"] = not hidden_in(out)
    row["made again"] = sum(_times(out).get(name) != times[name] for name in made - growing)
    row["there"] = len(made - growing)
    if not all(row[check] for check in CHECKS):
        differing = sorted(name for name in {*end, *wanted} if end.get(name) != wanted.get(name))
        row["seen"] = {
            "odd": odd[:5], "lost": sorted(set(there) - set(end))[:5], "differing": differing[:5],
            "hidden": hidden_in(out)[:5], "code": again.code, "said": again.complaints[:3],
        }  # fmt: skip
    return row


def undisturbed(verb: Verb, stage: Path, box: Path) -> dict[str, Any]:
    """Return cost and results of an uninterrupted run; they are stored next to the cases."""
    # Another state of the code may leave other bits.
    newest = max(path.stat().st_mtime_ns for path in SOURCES.rglob("*.py"))
    name = verb.name.replace(" ", "_").replace("/", "")
    kept = box / "undisturbed" / f"{name}.{newest}.json"
    if kept.exists():
        return json.loads(kept.read_text())
    out = box / "out"
    verb.fresh(stage, out)
    done = run(verb.words(stage, out), box, limits=Limits(cpu_s=CPU_S), before=before)
    if done.code != 0:
        raise RuntimeError(f"{verb.name}: {done.code}: {' '.join(done.complaints)}")
    known = {"cpu_s": done.cpu_s, "changes": done.changes, "contents": contents(out)}
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps(known))
    return known


def markdown(rows: list[dict]) -> str:
    """Return a line per verb: how many of its kills passed each check."""
    lines = [
        "| verb | cases | killed | " + " | ".join(CHECKS) + " | finished files made again |",
        "|---|---:|---:|" + "---:|" * (len(CHECKS) + 1),
    ]
    for name in dict.fromkeys([*(verb.name for verb in VERBS), "all"]):
        mine = [row for row in rows if name in ("all", row["verb"])]
        if mine:
            passed = " | ".join(str(sum(row[check] for row in mine)) for check in CHECKS)
            killed = sum(row["killed"] for row in mine)
            again = f"{sum(row['made again'] for row in mine)} of {sum(r['there'] for r in mine)}"
            lines.append(f"| {name} | {len(mine)} | {killed} | {passed} | {again} |")
    return "\n".join(lines) + "\n"


def violates(row: dict) -> bool:
    """Return whether a case shows a defect."""
    return not all(row[check] for check in CHECKS)


def _is_document(path: Path) -> bool:
    """Return whether a file grows with the work: a list, or a state of training or episode."""
    if path.name in ("bench.json", "states.json", "episode.json", "improvement.json", "README.md",
                     "best.safetensors", "recording.json"):  # fmt: skip
        if path.suffix == ".json":
            json.loads(path.read_text())
        return True
    return False


def _times(out: Path) -> dict[str, int]:
    """Return when each result was written [ns]."""
    return {
        path.relative_to(out).as_posix(): path.stat().st_mtime_ns
        for path in out.rglob("*")
        if path.is_file()
    }


def _refused_whole(verb: Verb, again: Trial, whole: bool) -> bool:
    """Return whether a verb that replaces nothing refused a complete result in one line."""
    return not verb.keeps and whole and again.code == 1 and len(again.complaints) == 1


def _moment(limits: Limits) -> str:
    if limits.kill_change is not None:
        return f"before change {limits.kill_change}"
    return f"after {limits.kill_cpu_s:.2f} s of CPU time"
