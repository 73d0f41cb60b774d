"""The callback through which long work reports its progress."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with a description of the step, the amount of work done, and the total.

The description names the item, then its parts by number ("towel_0001: action 1/2, frame 12/41").
The amount done only grows. Its units take about the same time each, so that the remaining time can
be estimated. The total may be an estimate, and is 0 while it is unknown.
"""

_PARTS = 10_000
"""Units of work per item, if several items are done one after the other."""


def one_of(progress: Progress | None, before: int, count: int, kind: str = "") -> Progress | None:
    """Return a callback that reports one of several equal items as a part of all."""
    name = f"{kind} {before + 1}/{count}," if kind else f"{before + 1}/{count}"
    if progress is None or count == 1:
        return progress

    def tell(place: str, done: int, total: int) -> None:
        share = round(_PARTS * done / total) if total else 0
        progress(f"{name} {place}", before * _PARTS + share, count * _PARTS)

    return tell
