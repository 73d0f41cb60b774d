"""Common parts of model cards: file name, versions in words, and tables."""

from collections.abc import Mapping, Sequence
from typing import Any

CARD = "model_card.md"
"""Name of the card's file, next to the weights."""


def made_in_words(made: Mapping[str, Any]) -> str:
    """Return versions and machine as a sentence (`provenance.made_with` and the device)."""
    packages = ", ".join(f"{name} {version}" for name, version in made["packages"].items())
    commit = f" (`{made['commit']}`)" if made["commit"] else ""
    return (
        f"clothtrack {made['clothtrack']}{commit} on {made['device']}; {made['machine']}, Python "
        f"{made['python']}; {packages}."
    )


def markdown_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table of texts."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
