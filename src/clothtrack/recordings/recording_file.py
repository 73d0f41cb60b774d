"""The file `recording.json`: read strictly and held against the JSON Schema of the format."""

import difflib
import json
import math
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

import jsonschema
from jsonschema.exceptions import ValidationError, relevance

from clothtrack.recordings.violation import Violation, shown

VERSION = 1
DOCUMENT = "recording.json"


def load_document(folder: Path) -> tuple[dict[str, Any] | None, list[Violation]]:
    """The content of `recording.json`, or None with what keeps it from being read.

    A content that is returned fulfils the schema; every violation of it is reported otherwise.
    """
    path = folder / DOCUMENT
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        return None, [_whole_file("the file is missing", _where_to_look(folder))]
    except (OSError, UnicodeDecodeError) as error:
        return None, [_whole_file(f"the file cannot be read ({error})", "write it as UTF-8 text")]
    try:
        document = json.loads(
            text,
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=_whole,
            object_pairs_hook=_without_doubles,
        )
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        remedy = "correct the JSON there (a comma, a quote, a bracket?)"
        return None, [Violation(DOCUMENT, place, "", f"broken JSON: {error.msg}", remedy)]
    except (ValueError, RecursionError) as error:
        problem = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        return None, [_whole_file(problem, "correct the JSON")]
    violations = document_violations(document)
    return (None if violations else document), violations


def document_violations(document: object) -> list[Violation]:
    """What is wrong with the content of a `recording.json`; what it names is not looked at."""
    return _newer(document) or [_explain(error) for error in _errors(document)]


@cache
def schema() -> dict[str, Any]:
    """The JSON Schema of `recording.json`, format version 1."""
    text = files("clothtrack.recordings").joinpath("recording.schema.json").read_text("utf-8")
    return json.loads(text)


def _errors(document: Any) -> list[ValidationError]:
    validator = jsonschema.Draft202012Validator(schema())
    return sorted(validator.iter_errors(document), key=lambda error: list(map(str, error.path)))


def _newer(document: object) -> list[Violation]:
    version = document.get("version") if isinstance(document, dict) else None
    if not isinstance(version, int) or version <= VERSION:
        return []
    problem = f"written by a newer clothtrack (this one reads version {VERSION})"
    return [Violation(DOCUMENT, "version", shown(version), problem, "upgrade clothtrack")]


def _explain(error: ValidationError) -> Violation:
    while error.context:
        error = max(error.context, key=relevance)
    place = ""
    for step in error.absolute_path:
        place += f"[{step}]" if isinstance(step, int) else f".{step}"
    place = place.removeprefix(".")
    rule: str = str(error.validator)
    limit: Any = error.validator_value
    value: Any = error.instance
    if rule == "required":
        missing = next(name for name in limit if name not in value)
        field = f"{place}.{missing}".removeprefix(".")
        return Violation(DOCUMENT, field, "", "the field is missing", "add it")
    if rule == "additionalProperties":
        surrounding: Any = error.schema
        known = list(surrounding["properties"])
        unknown = next(name for name in value if name not in known)
        near = difflib.get_close_matches(unknown, known, n=1)
        remedy = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(known)}"
        field = f"{place}.{unknown}".removeprefix(".")
        return Violation(DOCUMENT, field, shown(value[unknown]), "unknown field", remedy)
    problem, remedy = _rule_in_words(rule, limit)
    return Violation(DOCUMENT, place or "the document", shown(value), problem, remedy)


def _rule_in_words(rule: str, limit: Any) -> tuple[str, str]:
    kinds = " or ".join(limit) if isinstance(limit, list) else str(limit)
    words = {
        "type": ("of the wrong kind", f"write a JSON {kinds}"),
        "const": ("not the version that this clothtrack reads", f"write {limit}"),
        "enum": ("not one of the known values", f"choose from {shown(limit)}"),
        "minItems": ("too few entries", f"give at least {limit}"),
        "maxItems": ("too many entries", f"give at most {limit}"),
        "minimum": (f"less than {limit}", "correct it"),
        "maximum": (f"more than {limit}", "correct it"),
        "exclusiveMinimum": (f"not more than {limit}", "correct it"),
        "minLength": ("empty", "write it out or leave the field out"),
        "minProperties": ("empty", "name at least one file or leave the field out"),
        "uniqueItems": ("an entry stands there twice", "keep one"),
        "pattern": ("not a plain name", "use letters, digits, dot, underscore and hyphen"),
    }
    return words.get(rule, (f"against the rule {rule!r} of the schema", "see docs/data_format.md"))


def _whole_file(problem: str, remedy: str) -> Violation:
    return Violation(DOCUMENT, "", "", problem, remedy)


def _where_to_look(folder: Path) -> str:
    if not folder.is_dir():
        return f"{folder} is not a folder: give the folder of a recording"
    inside = sorted(path.parent.name for path in folder.glob(f"*/{DOCUMENT}"))
    if inside:
        return f"{folder} holds recordings, it is none: give one of them, such as {inside[0]}"
    return "check the name, or write one as docs/data_format.md shows"


def _refuse_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} stands where a number belongs")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text} is too large")
    return value


def _whole(text: str) -> int:
    if len(text) > 18:
        raise ValueError(f"the number {text[:20]}... is too large")
    return int(text)


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the field {double!r} stands twice in one object")
    return content
