"""Is work that many processes share, and that is killed again and again, the work of one process?

Films tiny towels, then tracks and labels them in one process that nobody disturbs, and over two
pools at once, over four shards, and by Ray, while random workers and parents are killed (-9). The
same commands are given again until all of them end well. Every label must be there, with the bits
of the one process, and nothing else may be left. Then Ray is measured beside the pool.

    python experiments many_machines --out OUT --json OUT/table.json

CPU times are those of all processes of a command, Ray's own included, read every 0.2 s.
"""

import argparse
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.figures import say

TINY = {
    "size_m": "[0.2, 0.2]", "vertex_count": 120, "template.vertex_count": 100, "actions": 1,
    "sensor.width": 80, "sensor.height": 60, "sensor.focal": 75, "action.frame_rate": 6,
    "action.distance_m": "[0.06, 0.08]",
}  # fmt: skip
LOOK_S = 0.2
LINGER_S = 180.0
"""How long Ray's own processes may outlive a parent that was killed [s]."""
ROUNDS = 20
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")

Command = tuple[str, ...]

_POOL, _RAY = ("--workers", "2"), ("--workers", "2", "--ray", "local")
WAYS: dict[str, list[Command]] = {
    "two pools at once": [_POOL, _POOL],
    "four shards": [("--shard", f"{number}/4") for number in (1, 2, 3, 4)],
    "Ray": [_RAY],
    "pool, undisturbed": [_POOL],
    "Ray, undisturbed": [_RAY],
}
"""Options of each of the processes that are at work at once."""
UNDISTURBED = ("alone", "pool, undisturbed", "Ray, undisturbed")


@dataclass
class Watched:
    """What was seen of some commands.

    Attributes:
        kills: processes that were killed.
        begun: tokens of the claims that were seen, one for each time that an item was begun.
        cpu_s: CPU time of each process that was seen [s], by its number and its start.
        shared: wall time [s] and CPU time [s] at the first and at the last claim.
    """

    kills: int = 0
    begun: set[str] = field(default_factory=set)
    cpu_s: dict[tuple[int, int], float] = field(default_factory=dict)
    shared: list[tuple[float, float]] = field(default_factory=list)


def members(sessions: set[int], watched: Watched) -> list[int]:
    """Living processes of these sessions; their CPU times are noted."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            values = path.read_text().rpartition(")")[2].split()
            if int(values[3]) in sessions and values[0] != "Z":
                pid = int(path.parent.name)
                found.append(pid)
                spent = (int(values[11]) + int(values[12])) * _TICK_S
                watched.cpu_s[pid, int(values[19])] = spent
    return found


def claimants(out: Path, verb: str, watched: Watched) -> list[int]:
    """Processes that are at an item; each time that one was begun is noted."""
    found = []
    for path in (out / ".work" / verb / "claims").glob("[!.]*"):
        with suppress(OSError, ValueError):
            claim = json.loads(path.read_text())
            watched.begun.add(claim["token"])
            found.append(claim["pid"])
    return found


def run(
    commands: list[Command], out: Path, *, kills: int, rng: random.Random, log: Path
) -> tuple[Watched, int]:
    """Give the commands at once, and those that fail again, until all end well.

    Args:
        commands: words after `clothtrack`.
        out: folder that they work in.
        kills: workers and parents to kill meanwhile.
        rng: chooses whom, and when.
        log: gets what they say.

    Returns:
        What was seen, and how many processes were still there after a while.
    """
    watched, sessions, left = Watched(), set(), list(commands)
    verb, start = commands[0][0], time.monotonic()
    for _ in range(ROUNDS):
        with log.open("ab") as said:
            running = {
                subprocess.Popen(
                    [sys.executable, "-m", "clothtrack.cli", *command],
                    stdout=said, stderr=said, start_new_session=True,
                ): command
                for command in left
            }  # fmt: skip
        parents = {process.pid for process in running}
        sessions |= parents
        due = time.monotonic() + rng.expovariate(0.3)
        while any(process.poll() is None for process in running):
            alive, busy = members(sessions, watched), claimants(out, verb, watched)
            if busy:
                now = time.monotonic() - start, sum(watched.cpu_s.values())
                watched.shared[1:] = [now]
            if busy and watched.kills < kills and time.monotonic() > due:
                pids = busy if rng.random() < 0.6 else sorted(parents)
                if (pid := rng.choice(pids)) in alive:
                    os.kill(pid, signal.SIGKILL)
                    watched.kills += 1
                due = time.monotonic() + rng.expovariate(0.3)
            time.sleep(LOOK_S)
        if not (left := [command for process, command in running.items() if process.returncode]):
            break
    else:
        raise SystemExit(f"{left[0]}: did not end well in {ROUNDS} rounds; see {log}")
    end = time.monotonic() + LINGER_S
    while (still := members(sessions, watched)) and time.monotonic() < end:
        time.sleep(LOOK_S)
    return watched, len(still)


def bits(tracked: Path, labels: Path) -> dict[str, str]:
    """Digests of all that was tracked and labelled, but times and where it was made."""
    found = {
        f"{path.relative_to(tracked)}": hashlib.sha256(path.read_bytes()).hexdigest()
        for path in tracked.glob("*.zarr/**/*")
        if path.is_file() and path.name != "zarr.json" and "steps" not in path.parts
    }
    for path in labels.glob("*.labels.npz"):
        with np.load(path, allow_pickle=False) as arrays:
            for name in sorted({*arrays.files} - {"sha256"}):
                data = arrays[name].tobytes()
                if name == "document":
                    # The provenance holds the CPU time of the tracking, and where it ran.
                    document = {**json.loads(data), "provenance": None}
                    data = json.dumps(document, sort_keys=True).encode()
                found[f"{path.name}/{name}"] = hashlib.sha256(data).hexdigest()
    return found


def litter(out: Path) -> list[Path]:
    """What nobody finished or cleared away."""
    hidden = [path for path in out.rglob(".*") if path.name != ".work"]
    return hidden + list(out.glob(".work/*/claims/*"))


def row(name: str, many: list[Command], world: Path, out: Path, *, kills: int, seed: int) -> dict:
    """Track and label in one way; what it took, and what came of it.

    Args:
        name: of the way.
        many: options of each of its processes.
        world: the recordings.
        out: folder of the results.
        kills: of each verb.
        seed: of the kills.
    """
    rng, folders = random.Random(seed), sorted((world / "recordings").iterdir())
    tracked, labels, start = out / "tracked", out / "labels", time.monotonic()
    tracked.mkdir(parents=True, exist_ok=True)
    track = ("track", *map(str, folders), "--output", str(tracked), "--set",
             "search.method=none")  # fmt: skip
    label = ("label", *(str(tracked / f"{folder.name}.zarr") for folder in folders),
             "--recordings", str(world / "recordings"), "--output", str(labels))  # fmt: skip
    seen, still = [], 0
    for verb, folder in ((track, tracked), (label, labels)):
        commands = [(*verb, *options) for options in many]
        watched, left = run(commands, folder, kills=kills, rng=rng, log=out / "log.txt")
        seen.append(watched)
        still += left
    shared = seen[0].shared or [(0.0, 0.0)]
    wall_s, cpu_s = np.subtract(shared[-1], shared[0])
    return {
        "way": name,
        "items": 2 * len(folders),
        "kills": sum(one.kills for one in seen),
        # At least: a claim that came and went between two looks was not seen.
        "again": max(sum(len(one.begun) for one in seen) - 2 * len(folders), 0),
        "wall_s": round(time.monotonic() - start, 1),
        "cpu_s": round(sum(sum(one.cpu_s.values()) for one in seen), 1),
        "tracking_wall_s": round(float(wall_s), 1),
        "tracking_cpu_s": round(float(cpu_s), 1),
        "labels": len(list(labels.glob("*.labels.npz"))),
        "litter": len(litter(tracked) + litter(labels)),
        "processes_left": still,
    }


def main(arguments: list[str] | None = None) -> int:
    """Films, does the work in every way, and prints the table; 1 where something is not right."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for everything; a new one by default")
    parser.add_argument("--recordings", type=int, default=40, help="how many")
    parser.add_argument("--kills", type=int, default=6, help="of each verb in each way")
    parser.add_argument("--seed", type=int, default=0, help="of the kills")
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), help="beside the one; all")
    parser.add_argument("--json", type=Path, help="file that gets the table")
    parser.add_argument("--smoke", action="store_true", help="two recordings, two pools, one kill")
    options = parser.parse_args(arguments)
    if options.smoke:
        options.recordings, options.kills = 2, 1
    with tempfile.TemporaryDirectory(prefix="many-machines-") as temporary:
        return compare(options, options.out or Path(temporary))


def compare(options: argparse.Namespace, out: Path) -> int:
    """Every way beside the process that nobody disturbs."""
    world, count = out / "world", str(options.recordings)
    (out / "alone").mkdir(parents=True, exist_ok=True)
    settings = [word for one in TINY.items() for word in ("--set", "=".join(map(str, one)))]
    film = ("simulate", str(world), "--trajectories", count, "--workers", "2", *settings)
    run([film], world, kills=0, rng=random.Random(0), log=out / "log.txt")
    chosen = options.ways or (list(WAYS)[:1] if options.smoke else list(WAYS))
    rows, first = [], {}
    for name in ("alone", *chosen):
        many = WAYS.get(name, [()])
        kills = 0 if name in UNDISTURBED else options.kills
        place = out / name.replace(", ", "_").replace(" ", "_").lower()
        rows.append(row(name, many, world, place, kills=kills, seed=options.seed))
        found = bits(place / "tracked", place / "labels")
        first = first or found
        rows[-1]["same_bits"] = found == first
        say(json.dumps(rows[-1]))
        if options.json:
            document = {"seed": options.seed, "recordings": options.recordings, "rows": rows}
            options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    say(table(rows))
    right = [
        one["same_bits"] and one["labels"] == options.recordings
        and not one["litter"] and not one["processes_left"]
        for one in rows
    ]  # fmt: skip
    return 0 if all(right) else 1


def table(rows: list[dict]) -> str:
    """The rows as Markdown."""
    names = list(rows[0])
    lines = [names, ["---"] * len(names), *([str(one[name]) for name in names] for one in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
