"""The function that long work calls to say how far it is."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with the place in the work, and how much of it is done and in all.

The place is words: the thing worked on, then what of how many ("towel_0001: action 1/2, frame
12/41"). What is done is counted in units that take about the same time, so that the time that is
left can be estimated; it grows. The total may be an estimate, and is 0 while it is unknown.
"""

_PARTS = 10_000
"""Units of each of several things that are done one after the other."""


def one_of(progress: Progress | None, before: int, count: int, kind: str = "") -> Progress | None:
    """Return a progress that reports one of several equal things as a part of all.

    Args:
        progress: gets the progress of all; None: no reports.
        before: how many are done.
        count: how many there are.
        kind: what they are, where the place does not say it.
    """
    name = f"{kind} {before + 1}/{count}," if kind else f"{before + 1}/{count}"
    if progress is None or count == 1:
        return progress

    def tell(place: str, done: int, total: int) -> None:
        share = round(_PARTS * done / total) if total else 0
        progress(f"{name} {place}", before * _PARTS + share, count * _PARTS)

    return tell
