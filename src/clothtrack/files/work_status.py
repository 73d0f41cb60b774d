"""How far the work in a folder is: what is done, running, failed or not begun."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Literal

from clothtrack.errors import InvalidResultError
from clothtrack.files.work_folder import HIDDEN, WorkFolder, verbs_of

State = Literal["done", "running", "failed", "not begun"]


@dataclass(frozen=True)
class ItemStatus:
    """One item.

    Attributes:
        name: of the item.
        state: how far it is.
        seconds: how long it took, or has been running for [s]; None where nobody knows.
        host: machine on which it runs or ended; empty where nobody knows.
        pid: process there; 0 where nobody knows.
        why: it failed.
    """

    name: str
    state: State
    seconds: float | None = None
    host: str = ""
    pid: int = 0
    why: str = ""


@dataclass(frozen=True)
class VerbStatus:
    """The work of one verb.

    Attributes:
        verb: as it is written.
        items: in the order in which they were asked for.
        command: does what is left; finished items are kept.
    """

    verb: str
    items: Sequence[ItemStatus]
    command: str

    def of(self, state: State) -> list[ItemStatus]:
        """The items in a state."""
        return [item for item in self.items if item.state == state]

    @property
    def left_s(self) -> float | None:
        """Time that is left [s] with the processes that run; one if none does.

        None while nothing is finished from which one could tell.
        """
        took = [item.seconds for item in self.of("done") if item.seconds is not None]
        if not took:
            return None
        usual, running = mean(took), self.of("running")
        begun = sum(max(usual - (item.seconds or 0.0), 0.0) for item in running)
        return (begun + usual * len(self.of("not begun"))) / max(len(running), 1)


def work_status(out: Path) -> list[VerbStatus]:
    """How far the work of every verb in a folder is.

    Raises:
        InvalidResultError: nobody has worked there.
    """
    found = [_status(folder) for folder in verbs_of(Path(out)) if folder.asked()]
    if not found:
        raise InvalidResultError(
            f"{out}: nothing was begun here (no {HIDDEN} in it); give the folder of track, label, "
            "evaluate, simulate, bench or flatten"
        )
    return found


def _status(folder: WorkFolder) -> VerbStatus:
    asked = folder.asked()
    places = {name: place for one in asked for name, place in one["items"].items()}
    return VerbStatus(
        folder.verb,
        [_item(folder, name, folder.out / place) for name, place in places.items()],
        str(asked[-1]["command"]),
    )


def _item(folder: WorkFolder, name: str, result: Path) -> ItemStatus:
    holder, record = folder.holder(name), folder.record(name)
    if holder is not None and holder.lives:
        owner = holder.owner
        return ItemStatus(name, "running", time.time() - holder.since, owner.host, owner.pid)
    host, pid = str(record.get("host", "")), int(record.get("pid", 0))
    if record.get("status") == "failed":
        return ItemStatus(name, "failed", None, host, pid, str(record.get("error")))
    if result.exists():
        return ItemStatus(name, "done", record.get("seconds"), host, pid)
    return ItemStatus(name, "not begun")
