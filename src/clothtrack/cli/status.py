"""The verb that says how far the work in a folder is: status."""

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from clothtrack.cli.options import AsJson
from clothtrack.cli.progress_line import duration
from clothtrack.cli.terminal import say_result

if TYPE_CHECKING:
    from clothtrack.files.work_status import ItemStatus, VerbStatus

STATES = ("done", "running", "failed", "not begun")


def status(output: Positional[Path], *, json: AsJson = False) -> int:
    """How far is the work in a folder: done, running where, failed why, and how long still?

    Args:
        output: folder that track, label, evaluate, simulate, bench or flatten write to, from any
            number of processes and machines.
        json: machine-readable.
    """
    from clothtrack.files.work_status import work_status

    found = work_status(output)
    rows = [
        {
            "verb": one.verb,
            "counts": {state: len(one.of(state)) for state in STATES},
            "left_s": one.left_s,
            "command": one.command,
            "items": [asdict(item) for item in one.items],
        }
        for one in found
    ]
    say_result("\n\n".join(map(_in_words, found)), rows, json=json)
    return 0


def _in_words(work: "VerbStatus") -> str:
    counts = ", ".join(f"{len(found)} {state}" for state in STATES if (found := work.of(state)))
    left = work.left_s
    told = f"; {duration(left)} left" if left and len(work.of("done")) < len(work.items) else ""
    lines = [f"{work.verb}: {counts}{told}", *(_line(item) for item in work.items)]
    if work.command and (work.of("failed") or work.of("not begun")):
        lines.append(f"what is left, and nothing else: {work.command}")
    return "\n".join(lines)


def _line(item: "ItemStatus") -> str:
    said = {"running": _since(item), "failed": item.why, "done": "", "not begun": ""}[item.state]
    if item.state == "done" and item.seconds is not None:
        said = f"{duration(item.seconds)} on {item.host}"
    return f"  {item.state:<9}  {item.name}   {said}".rstrip()


def _since(item: "ItemStatus") -> str:
    began = time.localtime(time.time() - (item.seconds or 0.0))
    return f"{item.host}, process {item.pid}, since {time.strftime('%Y-%m-%d %H:%M', began)}"
