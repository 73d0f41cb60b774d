"""Who works: a process, known well enough that its neighbours can say whether it still lives."""

import hashlib
import os
import re
import socket
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

_MARK = re.compile(r"\.([0-9a-f]{8})-(\d+)-(\d+)-[0-9a-f]{8}(?=\.|$)")


@dataclass(frozen=True)
class Owner:
    """A process.

    Attributes:
        host: name of its machine, for people.
        machine: eight hexadecimal digits that tell its machine, or container, from others.
        pid: its number there.
        start: when it began [clock ticks since the machine started]; 0 where nobody knows. A
            number is given again, this one is not.
    """

    host: str
    machine: str
    pid: int
    start: int

    @classmethod
    def me(cls) -> "Owner":
        """This process."""
        pid = os.getpid()
        _, start = _state_of(pid) or ("", 0)
        return cls(socket.gethostname(), _machine(), pid, start)

    @classmethod
    def of(cls, document: Any) -> "Owner | None":
        """What `as_dict` has written; None when it is something else."""
        try:
            return cls(
                str(document["host"]),
                str(document["machine"]),
                int(document["pid"]),
                int(document["start"]),
            )
        except (KeyError, TypeError, ValueError):
            return None

    def as_dict(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)

    @property
    def alive(self) -> bool | None:
        """Whether the process still runs; None when it is one of another machine."""
        if self.machine != _machine():
            return None
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass
        found = _state_of(self.pid)
        if found is None or not self.start:
            return True
        state, start = found
        # A zombie has ended; nobody has asked how.
        return state != "Z" and start == self.start


def hidden_name(name: str, suffix: str = "") -> str:
    """Name under which this process writes what is to be called `name`; no two are equal."""
    me = Owner.me()
    return f".{name}.{me.machine}-{me.pid}-{me.start}-{os.urandom(4).hex()}{suffix}"


def hidden_parts(hidden: str) -> tuple[str, Owner, str] | None:
    """What a `hidden_name` was made of: the name, the process, the suffix; None: it is none."""
    found = _MARK.search(hidden)
    if found is None or not hidden.startswith("."):
        return None
    owner = Owner("", found[1], int(found[2]), int(found[3]))
    return hidden[1 : found.start()], owner, hidden[found.end() :]


@cache
def _machine() -> str:
    parts = [socket.gethostname()]
    # Containers may share the name of their machine, and have process numbers of their own.
    for place in ("/etc/machine-id", "/proc/self/ns/pid"):
        path = Path(place)
        try:
            parts.append(str(path.readlink()) if path.is_symlink() else path.read_text("ascii"))
        except (OSError, ValueError):
            parts.append("")
    return hashlib.sha256("|".join(parts).encode()).hexdigest()[:8]


def _state_of(pid: int) -> tuple[str, int] | None:
    """State of a process, and when it began [clock ticks]; None where nobody knows."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text("utf-8", errors="replace")
        # The name of the program stands in parentheses, and may have any of them itself.
        values = text.rpartition(")")[2].split()
        return values[0], int(values[19])
    except (OSError, ValueError, IndexError):
        return None
