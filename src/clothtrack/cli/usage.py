"""One-line messages for wrong usage: what was written, what may be meant, where the help is.

Verbs and options are checked before tyro sees them. Tyro reports other errors (a missing option, a
value outside the choices) in a box, of which the first sentence is kept.
"""

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from difflib import get_close_matches
from io import StringIO
from textwrap import fill, shorten
from typing import Any

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes

from clothtrack.cli.signature import SHOW_SETTINGS, command, options_of, parameters_of
from clothtrack.errors import WrongUsageError

_DESCRIPTION = (
    "Know where every point of a crumpled cloth is, from one depth camera. Every verb takes "
    "--verbose, to log what happens, and --json, to write one JSON document in place of text; "
    "clothtrack --version says what is installed."
)
Function = Callable[..., Any]

_WIDTH = 100

_BOX = re.compile("\x1b\\[[0-9;]*m|[│╭╮╰╯]")
_CHOICES = re.compile(r"\. Expected one of \(.*\)")
_CHOICE = re.compile(r"'([^']*)'")
_REFUSED = re.compile(r"could be instantiated from \[(.*)\]")
_EXPLAINED = "  Argument helptext:"
_MARGIN = 2
_LONGEST = 300
"""Longest message about an option [characters]."""

_HELP_INDENT = 8
"""Spaces that tyro puts before the help of an option in its list of missing options."""


def parse(
    words: Sequence[str], verbs: Mapping[str, Callable[[], Function]]
) -> tuple[Function, dict[str, Any]]:
    """Return the function of the requested verb, and its arguments."""
    function = _known(words, verbs)
    drawn = StringIO()
    try:
        with redirect_stderr(drawn):
            found = tyro.cli(
                command(function, words[0], lenient=SHOW_SETTINGS in words),
                prog=f"clothtrack {words[0]}",
                args=words[1:],
                config=(FlagCreatePairsOff, OmitArgPrefixes),
            )()
    except SystemExit as end:
        if not end.code:
            raise
        raise WrongUsageError(_first_sentence(drawn.getvalue(), words[0])) from None
    for word in parameters_of(function):
        if (
            word.default is word.empty
            and found.get(word.name) == ()
            and not found.get("show_settings")
        ):
            raise WrongUsageError(f"no {word.name} given; name at least one")
    return function, found


def overview(
    verbs: Mapping[str, Callable[[], Function]], groups: Mapping[str, Sequence[str]]
) -> str:
    """Return what `clothtrack --help` shows: every verb in its group, with one sentence."""
    named = {name for names in groups.values() for name in names}
    whole = {**groups, "others": [name for name in verbs if name not in named]}
    width = max(map(len, verbs))
    parts = ["usage: clothtrack VERB ...", fill(_DESCRIPTION, _WIDTH)]
    for title, names in whole.items():
        rows = [
            f"  {name:<{width}}  {_sentence(verbs[name](), _WIDTH - width - 4)}"
            for name in names
            if name in verbs
        ]
        if rows:
            parts.append("\n".join([f"{title}:", *rows]))
    parts.append("clothtrack VERB --help lists the options of a verb.")
    return "\n\n".join(parts)


def _sentence(function: Function, width: int) -> str:
    """Return the first paragraph of a function's docstring, shortened to a width."""
    first = (inspect.unwrap(function).__doc__ or "").strip().split("\n\n")[0]
    return shorten(" ".join(first.split()), width, placeholder=" ...")


def meant(word: str, known: Sequence[str]) -> str:
    """Return the closest known word as the end of a message; empty if none is close."""
    close = get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _known(words: Sequence[str], verbs: Mapping[str, Callable[[], Function]]) -> Function:
    """Return the function of a verb after checking that the verb and all options exist."""
    if not words:
        raise WrongUsageError("say what to do: clothtrack VERB; clothtrack --help lists the verbs")
    verb = words[0]
    if verb not in verbs:
        kind = "option; options stand behind the verb" if verb.startswith("-") else "verb"
        guess = meant(verb, list(verbs)) or "; clothtrack --help lists the verbs"
        raise WrongUsageError(f"{verb} is no {kind}{guess}")
    function = verbs[verb]()
    known = options_of(function)
    for word in words[1:]:
        option = word.partition("=")[0]
        if option.startswith("--") and option.replace("_", "-") not in known:
            guess = meant(option, sorted(known)) or f"; clothtrack {verb} --help lists them"
            raise WrongUsageError(f"{option} is no option of {verb}{guess}")
    return function


def _first_sentence(drawn: str, verb: str) -> str:
    """Return, in one line, what a box of tyro says before its explanation."""
    said: list[str] = []
    rows = [_BOX.sub(" ", row).rstrip() for row in drawn.splitlines()]
    for row in rows:
        text = row.strip()
        if said and not text.strip("─-"):
            break
        indent = len(row) - len(row.lstrip()) - _MARGIN
        if indent < 0 or indent >= _HELP_INDENT or not text.strip("─-"):
            continue
        # Names of missing options, one per row.
        said.append(f"{text}," if indent > 0 else text)
    sentence = " ".join(said).rstrip(",.") or drawn.strip()
    refused = _REFUSED.search(sentence)
    if refused is not None:
        option = rows[rows.index(_EXPLAINED) + 1].strip() if _EXPLAINED in rows else "an option"
        sentence = f"{option} cannot be {refused[1]}"
    # Tyro lists a set, whose order changes, with the None of an option that was not given.
    sentence = _CHOICES.sub(
        lambda found: f"; choose from {', '.join(sorted({*_CHOICE.findall(found[0])} - {'None'}))}",
        sentence,
    )
    if len(sentence) > _LONGEST:
        # The box wraps a long value, so that no single word is long.
        sentence = f"{sentence[: _LONGEST // 2]} ... {sentence[-_LONGEST // 2 :]}"
    return f"{sentence}; clothtrack {verb} --help says more"
