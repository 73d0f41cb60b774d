"""The file `recording.json`, read strictly and checked against the format's JSON Schema."""

import difflib
import json
import math
import re
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
from jsonschema.exceptions import ValidationError, relevance

from clothtrack.errors import why_unreadable
from clothtrack.recordings.violation import DOCUMENT, Violation, Violations, shown

VERSION = 1
_RULES = {
    "type": "of the wrong kind; write a JSON {}",
    "const": "not the version that this clothtrack reads; write {}",
    "enum": "not one of the known values; choose from {}",
    "minItems": "too few entries; give at least {}",
    "maxItems": "too many entries; give at most {}",
    "minimum": "less than {}; correct it",
    "maximum": "more than {}; correct it",
    "exclusiveMinimum": "not more than {}; correct it",
    "minLength": "empty; write it out or leave the field out",
    "minProperties": "empty; name at least one file or leave the field out",
    "uniqueItems": "an entry stands there twice; keep one",
    "pattern": "not a plain name; use letters, digits, dot, underscore and hyphen",
}
"""The meaning of a broken rule of the schema and the remedy, with the rule's limit."""


_HALF_CHARACTER = re.compile("[\ud800-\udfff]")
"""Half of a pair of UTF-16: JSON can write it, and nothing can print it."""


def load_document(folder: Path) -> tuple[dict[str, Any] | None, list[Violation]]:
    """Return the content of `recording.json`, or None with the reasons that it cannot be read.

    Content that is returned fulfills the schema; otherwise, every violation of it is reported.
    """
    violations = Violations()
    try:
        document = json.loads(
            (folder / DOCUMENT).read_text(encoding="utf-8-sig"),
            parse_constant=_number,
            parse_float=_number,
            parse_int=_number,
            object_pairs_hook=_without_doubles,
        )
        if half := _HALF_CHARACTER.search(json.dumps(document, ensure_ascii=False)):
            raise ValueError(f"half a character ({ascii(half[0])[1:-1]}) in a text")
    except FileNotFoundError:
        violations.add("", "", f"the file is missing; {_where_to_look(folder)}")
    except OSError as error:
        violations.add("", "", why_unreadable(error, "give the folder of a recording"))
    except UnicodeDecodeError as error:
        violations.add("", "", f"the file cannot be read ({error}); write it as UTF-8 text")
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        remedy = "correct the JSON there (a comma, a quote, a bracket?)"
        violations.add(place, "", f"broken JSON: {error.msg}; {remedy}")
    except RecursionError:
        violations.add("", "", "nested too deeply; correct the JSON")
    except ValueError as error:
        violations.add("", "", f"{error}; correct the JSON")
    else:
        violations += document_violations(document)
        return (None if violations else document), violations
    return None, violations


def document_violations(document: object) -> list[Violation]:
    """Return what is wrong with the content of a `recording.json`.

    The files that it names are not read.
    """
    violations = Violations()
    version = document.get("version") if isinstance(document, dict) else None
    if isinstance(version, int) and version > VERSION:
        problem = f"written by a newer clothtrack (this one reads version {VERSION})"
        violations.add("version", shown(version), f"{problem}; upgrade clothtrack")
        return violations
    errors: Any = jsonschema.Draft202012Validator(schema()).iter_errors(document)
    for error in sorted(errors, key=lambda error: list(map(str, error.path))):
        for field, value, words in _explain(error):
            violations.add(field, value, words)
    return list(dict.fromkeys(violations))


@cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema of `recording.json`, format version 1."""
    text = files("clothtrack.recordings").joinpath("recording.schema.json").read_text("utf-8")
    return json.loads(text)


def _explain(error: ValidationError) -> Iterator[tuple[str, str, str]]:
    """Yield field, value and "problem; remedy" of each violation of the schema."""
    while error.context:
        error = max(error.context, key=relevance)
    steps = (f"[{s}]" if isinstance(s, int) else f".{s}" for s in error.absolute_path)
    place = "".join(steps).removeprefix(".")
    rule = str(error.validator)
    limit: Any = error.validator_value
    value: Any = error.instance
    inside = f"{place}." if place else ""
    if rule == "required":
        for name in limit:
            if name not in value:
                yield f"{inside}{name}", "", "the field is missing; add it"
    elif rule == "additionalProperties":
        schema_here: Any = error.schema
        known = list(schema_here["properties"])
        for name in [name for name in value if name not in known]:
            near = difflib.get_close_matches(name, known, n=1)
            remedy = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(known)}"
            yield f"{inside}{name}", shown(value[name]), f"unknown field; {remedy}"
    else:
        if isinstance(limit, list):
            limit = " or ".join(limit) if rule == "type" else shown(limit)
        words = _RULES.get(rule, "against a rule of the schema; see docs/data_format.md")
        yield place or "the document", shown(value), words.format(limit)


def _where_to_look(folder: Path) -> str:
    if not folder.is_dir():
        return f"{folder} is not a folder: give the folder of a recording"
    inside = sorted(path.parent.name for path in folder.glob(f"*/{DOCUMENT}"))
    if inside:
        return f"{folder} holds recordings, it is none: give one of them, such as {inside[0]}"
    remedy = "check the name, or write one as docs/data_format.md shows"
    pictures = (folder / "depth").is_dir()
    return remedy + f", or import the pictures: clothtrack import {folder} NEW" * pictures


def _number(text: str) -> int | float:
    """Return a finite number from a file; an integer has at most 18 characters."""
    if text[-1].isalpha():  # NaN, Infinity
        raise ValueError(f"{text} stands where a number belongs")
    whole = text.removeprefix("-").isdigit()
    if len(text) > 18 if whole else not math.isfinite(float(text)):
        raise ValueError(f"the number {text[:20]}{'...' * (len(text) > 20)} is too large")
    return int(text) if whole else float(text)


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the field {double!r:.80} stands twice in one object")
    return content
