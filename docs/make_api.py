"""Write docs/api.md from the docstrings of the front: `python docs/make_api.py [FILE]`."""

import inspect
import json
import re
import sys
from pathlib import Path

import clothtrack

PAGE = Path(__file__).with_name("api.md")
INTRODUCTION = """\
# The Python interface

<!-- Made by `python docs/make_api.py` from the docstrings; change those. -->

    import clothtrack as ct

What is listed here is what clothtrack promises. Each name is imported when it is first used.
"""
CHAPTERS = {
    "Track and look": [
        "track", "load", "Run", "Label", "evaluate", "judge_labels", "Truth", "view",
        "write_report", "export", "verify", "Verification", "demo",
    ],
    "While it moves": ["LiveTracker", "LiveState", "LiveStream", "play_live"],
    "Many at once": ["track_many", "evaluate_many", "label_many", "inspect_many"],
    "Configure": ["mode", "MODES", "RunConfig", "with_settings"],
    "Recordings": [
        "read_recording", "inspect_recording", "shipped_recording", "RecordingWriter", "Recording",
        "Camera", "Table", "PickerPath", "ClothDescription", "ClothMesh", "observe",
        "ColorSegmenter", "read_color", "read_depth",
    ],
    "Learn": ["garment_template", "reconstruct", "label", "pretrain", "finetune"],
    "Errors": [
        "ClothTrackError", "InvalidRecordingError", "InvalidMeshError", "InvalidResultError",
        "InvalidConfigError", "SimulationDivergedError", "StorageError",
    ],
}  # fmt: skip
SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields):$")


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION]
    for chapter, names in CHAPTERS.items():
        parts += [f"## {chapter}\n", *(entry(name) for name in names)]
    return "\n".join(parts)


def entry(name: str) -> str:
    """Signature and docstring of one name; of a class, its own methods too."""
    thing = getattr(clothtrack, name)
    if not callable(thing):
        return f"### {name}\n\n{', '.join(f'`{key}`' for key in thing)}.\n"
    lines = [f"### {name}\n"]
    if not (isinstance(thing, type) and issubclass(thing, Exception)):
        lines.append(f"```python\n{signature(name, thing)}\n```\n")
    lines.append(prose(inspect.getdoc(thing) or ""))
    if isinstance(thing, type):
        lines += [method(name, key, value) for key, value in methods(thing)]
    return "\n".join(lines)


def methods(kind: type) -> list[tuple[str, object]]:
    """Public methods and properties that a class or a base of ours defines, in that order."""
    owners = [one for one in kind.__mro__ if one.__module__.startswith("clothtrack")]
    found = {}
    for owner in owners:
        for name, value in vars(owner).items():
            if not name.startswith("_") and is_method(value):
                found.setdefault(name, value)
    return list(found.items())


def is_method(value: object) -> bool:
    """Whether it is a function, a class or static method, or a property."""
    plain = inspect.isfunction(value) or isinstance(value, classmethod | staticmethod | property)
    return plain or type(value).__name__ == "cached_property"


def method(owner: str, name: str, value: object) -> str:
    """One line: how it is called, and the first sentence of its docstring."""
    function = getattr(value, "__func__", value)
    called = ""
    if inspect.isfunction(function):
        names = [
            one for one in inspect.signature(function).parameters if one not in ("self", "cls")
        ]
        called = f"({', '.join(names)})"
    first = (inspect.getdoc(function) or "").split("\n\n")[0].replace("\n", " ")
    return f"- `{owner}.{name}{called}`: {first}\n"


def signature(name: str, thing: object) -> str:
    """How it is called: one parameter a line where one line would be too long."""
    parameters = []
    kinds = inspect.Parameter
    for one in inspect.signature(inspect.unwrap(thing)).parameters.values():
        starred = any(other.startswith("*") for other in parameters)
        if one.kind is kinds.KEYWORD_ONLY and not starred:
            parameters.append("*")
        stars = {kinds.VAR_POSITIONAL: "*", kinds.VAR_KEYWORD: "**"}.get(one.kind, "")
        default = "" if one.default is kinds.empty else f"={shown(one.default)}"
        parameters.append(f"{stars}{one.name}{default}")
    line = f"{name}({', '.join(parameters)})"
    if len(line) <= 88:
        return line
    return "\n".join([f"{name}(", *(f"    {one}," for one in parameters), ")"])


def shown(value: object) -> str:
    """A default as one would write it; `...` for one that is made anew."""
    # As the formatter writes texts, so that it leaves the page alone.
    text = json.dumps(value) if isinstance(value, str) else repr(value)
    return "..." if text.startswith("<") or "\n" in text or len(text) > 60 else text


def prose(docstring: str) -> str:
    """Google's sections as lists."""
    lines, section = [], ""
    for line in docstring.splitlines():
        if found := SECTION.match(line):
            section = found[1]
            lines.append(f"**{section}**\n")
        elif section and re.match(r"    \S", line):
            head, colon, rest = line.strip().partition(": ")
            named = section in ("Args", "Attributes", "Raises") and colon
            lines.append(
                f"- `{head.replace(chr(92), '')}`: {rest}" if named else f"- {line.strip()}"
            )
        elif section and line.strip():
            lines.append(f"  {line.strip()}")
        else:
            section = section if not line.strip() else ""
            lines.append(line)
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1] if len(sys.argv) > 1 else PAGE).write_text(page(), encoding="utf-8")
