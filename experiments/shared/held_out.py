"""Training and test recordings, with a check that no recording is both."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import content_hash
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from shared.bench_runs import BENCH_FILE, Trajectory, trajectories

HELD_OUT = 10
"""One trajectory in so many is held out where nobody says which: 45 of 50 are learned from, as in
the paper."""


def measured_on(bench: Path, split: str, held_out: int | None = None) -> list[Trajectory]:
    """Return the trajectories of a benchmark folder to measure on."""
    if not (bench / BENCH_FILE).exists():
        return parted(trajectories(bench), held_out)[1]
    return trajectories(bench, split)


def parted(
    found: Iterable[Trajectory], count: int | None = None
) -> tuple[list[Trajectory], list[Trajectory]]:
    """To learn from and to measure on: of each garment, by name, the last are held out."""
    ordered = sorted(found, key=lambda one: one.name)
    learned, held_out = [], []
    for kind in dict.fromkeys(one.kind for one in ordered):
        own = [one for one in ordered if one.kind == kind]
        last = max(1, round(len(own) / HELD_OUT)) if count is None else count
        if not 0 < last < max(2, len(own)):
            raise InvalidConfigError(
                f"--held-out is {last}, and there are {len(own)} trajectories of a {kind}; "
                f"hold out 1 to {max(1, len(own) - 1)}"
            )
        first = len(own) - last
        learned += own[:first]
        held_out += own[first:]
    return learned, held_out


def require_apart(learned: Iterable[Path], measured: Iterable[Path]) -> None:
    """Refuse to measure on a recording that is learned from, under whatever name it lies there.

    Files are compared by their content, pictures only: another document, another name, a part of
    it or its frames backwards do not make another recording (`same_film`).
    """
    measured = list(measured)
    for one in learned:
        for other in measured:
            if same_film(_pictures(one.resolve()), _pictures(other.resolve())):
                raise InvalidConfigError(
                    f"{one}, to learn from, and {other}, to measure on, show the same pictures; "
                    "take one of them out, or record another to measure on"
                )


@cache
def _pictures(folder: Path) -> frozenset[str]:
    return picture_digests(read_recording(folder))


def picture_digests(recording: Recording) -> frozenset[str]:
    """Return the SHA-256 of every file that shows what was measured; nothing is decoded.

    Of each frame its depth pictures count; its cloud where there are none, its color where there
    is nothing else. A mask is no picture: the same one may be drawn twice. A picture that another
    program has compressed anew is another file.
    """
    files: list[Path] = []
    for frame in recording.frames:
        clouds = [] if frame.cloud is None else [frame.cloud]
        files += list(frame.depth.values()) or clouds or list(frame.color.values())
    return frozenset(map(content_hash, files))


def same_film(one: frozenset[str], other: frozenset[str]) -> bool:
    """Return whether two recordings show the same moments, whatever their names and documents say.

    So does a part of a recording, or one with another template, or turned around. Two pictures
    decide: a single one, in which nothing was measured, may be the same anywhere.
    """
    return len(one & other) >= max(1, min(2, len(one), len(other)))
