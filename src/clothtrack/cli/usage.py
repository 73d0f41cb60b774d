"""Wrong usage in one line: what was written, what may have been meant, where the help is.

Verbs and options are compared with those that exist before tyro sees them. What tyro refuses
besides (a missing option, a value that is none of the choices) it draws in a box; the first
sentence of that is kept.
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
_REFUSED = re.compile(r"could be instantiated from \[(.*)\]")
_EXPLAINED = "  Argument helptext:"
_MARGIN = 2
_LONGEST = 300
"""Characters of what is said about an option."""

_HELP_INDENT = 8
"""Spaces that tyro puts before the help of an option, in the list of those that are missing."""


def parse(
    words: Sequence[str], verbs: Mapping[str, Callable[[], Function]]
) -> tuple[Function, dict[str, Any]]:
    """The function of the verb that the words ask for, and its arguments.

    Args:
        words: after `clothtrack`.
        verbs: what loads the functions, by the names of their verbs.

    Raises:
        WrongUsageError: there is no such verb or option, or one is missing or has another value.
        SystemExit: help was asked for, and written.
    """
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
    """Return what `clothtrack --help` shows: every verb in its group, with one sentence.

    Args:
        verbs: what loads the functions, by the names of their verbs.
        groups: names by the title of their group, in order; those that are missing are left out.
    """
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
    """Return the first line of what a function's docstring says."""
    first = (inspect.unwrap(function).__doc__ or "").strip().split("\n\n")[0]
    return shorten(" ".join(first.split()), width, placeholder=" ...")


def meant(word: str, known: Sequence[str]) -> str:
    """What may have been meant by a word, as the end of a sentence; empty where nothing is."""
    close = get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _known(words: Sequence[str], verbs: Mapping[str, Callable[[], Function]]) -> Function:
    """The function of a verb, whose options are all known."""
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
    """What a box of tyro's says before it explains, in one line."""
    said: list[str] = []
    rows = [_BOX.sub(" ", row).rstrip() for row in drawn.splitlines()]
    for row in rows:
        text = row.strip()
        if said and not text.strip("─-"):
            break
        indent = len(row) - len(row.lstrip()) - _MARGIN
        if indent < 0 or indent >= _HELP_INDENT or not text.strip("─-"):
            continue
        # Names of missing options, each in a row of its own.
        said.append(f"{text}," if indent > 0 else text)
    sentence = " ".join(said).rstrip(",.") or drawn.strip()
    refused = _REFUSED.search(sentence)
    if refused is not None:
        option = rows[rows.index(_EXPLAINED) + 1].strip() if _EXPLAINED in rows else "an option"
        sentence = f"{option} cannot be {refused[1]}"
    if len(sentence) > _LONGEST:
        # A long value comes in rows of the box: no word of it is long.
        sentence = f"{sentence[: _LONGEST // 2]} ... {sentence[-_LONGEST // 2 :]}"
    return f"{sentence}; clothtrack {verb} --help says more"
