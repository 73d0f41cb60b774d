"""Verdicts against the truth: by word, and with one piece of evidence left out."""

from collections.abc import Iterable, Mapping, Sequence

from clothtrack.evaluation.verdict import WORDS, Verdict
from shared.bench_measures import Row


def told(found: Verdict) -> Row:
    """Return what a row keeps of a verdict."""
    words = {one.name: one.word for one in found.evidence}
    return {"word": found.word, "reason": found.reason, "evidence": words}


def of_each_word(rows: Sequence[Row]) -> Mapping[str, str]:
    """Return how many rows of each word there are, and how many of these are right."""
    return {f"{word}: right": _right(row for row in rows if row["word"] == word) for word in WORDS}


def trusted_without(rows: Sequence[Row]) -> Mapping[str, str]:
    """Return how many rows would be trusted, and how many are right, without each evidence."""
    names = dict.fromkeys(name for row in rows for name in row.get("evidence", {}))
    return {
        f"trust without {left_out}: right": _right(
            row for row in rows if row.get("evidence") and all(
                word == "trust" for name, word in row["evidence"].items() if name != left_out
            )
        )
        for left_out in names
    }  # fmt: skip


def _right(rows: Iterable[Row]) -> str:
    right = [row["right"] for row in rows]
    return f"{sum(right)} of {len(right)}"
