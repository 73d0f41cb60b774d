"""Write surface.txt, what users and their programs can name: `python surface.py [FILE]`.

It lists verbs with their options, settings, public names with their signatures, fields of files,
and errors. Every change of it is a difference in review, and a line of CHANGELOG.md.
"""

import ast
import inspect
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import zarr

import clothtrack as ct
from clothtrack import errors
from clothtrack.cli.command_line import VERBS
from clothtrack.cli.signature import configuration_of, options_of, parameters_of
from clothtrack.files.settings import settings_of
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_suffix(".txt")
PACKAGES = ("clothtrack", "clothtrack_capture", "clothtrack_lab")
MODULES = re.compile(r"\b(?:[a-z_]\w*\.)+(?=[A-Za-z_])")
"""A type may move to another module without anybody's noticing."""


def verbs() -> Iterator[str]:
    """Yield every option of every verb, and what `--set` changes there."""
    for verb, load in sorted(VERBS.items()):
        function = load()
        for one in parameters_of(function):
            if one.kind is not one.KEYWORD_ONLY:
                yield f"{verb} {one.name.upper()}"
        yield from (f"{verb} {option}" for option in sorted(options_of(function)))
        if configure := configuration_of(function):
            yield from (f"{verb} --set {one.name}={one.value}" for one in settings_of(configure()))


def names() -> Iterator[str]:
    """Yield every public name with its signature, and the public members of classes."""
    for package in map(import_module, PACKAGES):
        for name in sorted(package.__all__):
            thing = getattr(package, name)
            yield f"{package.__name__}.{name}{signature(thing)}"
            for member in sorted(dir(thing)) if inspect.isclass(thing) else ():
                value = inspect.getattr_static(thing, member)
                if not member.startswith("_") and not issubclass(thing, Exception):
                    yield f"{package.__name__}.{name}.{member}{signature(value)}"


def signature(thing: Any) -> str:
    """Return how a thing is called; empty for what is not called, and for errors."""
    thing = getattr(thing, "__func__", thing)
    if not callable(thing) or (inspect.isclass(thing) and issubclass(thing, Exception)):
        return ""
    written = MODULES.sub("", str(inspect.signature(inspect.unwrap(thing))))
    return re.sub(r"<(\w+) [^>]*>", r"<\1>", written)


def fields() -> Iterator[str]:
    """Yield the fields of recording.json, arrays and attributes of a result, and formats."""
    file = ROOT / "src/clothtrack/recordings/recording.schema.json"
    schema = json.loads(file.read_text("utf-8"))
    for owner, part in {"recording.json": schema, **schema["$defs"]}.items():
        for name, field in sorted(part.get("properties", {}).items()):
            needed = " (required)" if name in part.get("required", ()) else ""
            kind = {key: value for key, value in field.items() if key != "description"}
            yield f"{owner} {name}{needed} {json.dumps(kind)}"
    with tempfile.TemporaryDirectory() as folder:
        trajectory().save(Path(folder) / "NAME.zarr")
        group = zarr.open_group(Path(folder) / "NAME.zarr", mode="r")
        yield f"NAME.zarr attributes {', '.join(sorted(group.attrs))}"
        for name, part in sorted(group.members(max_depth=None)):
            shape = f"{part.dtype} {part.ndim}d" if isinstance(part, zarr.Array) else "group"
            yield f"NAME.zarr {name} {shape} {', '.join(sorted(part.attrs))}"
    known = set()
    for module in (ROOT / "src").rglob("*.py"):
        for line in ast.parse(module.read_text("utf-8")).body:
            if isinstance(line, ast.Assign) and isinstance(line.value, ast.Constant):
                name = ast.unparse(line.targets[0])
                if name.endswith(("FORMAT", "FORMAT_VERSION")):
                    known.add(f"{module.stem} {name} {line.value.value}")
    yield from sorted(known)


def trajectory() -> TrackedTrajectory:
    """Return a trajectory of two triangles that has every array."""
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    mesh = ct.ClothMesh(flat, np.array([[0, 1, 2], [1, 3, 2]]), canonical=flat)
    calibration = Calibration(
        "grid", ("table_friction",), np.ones((2, 1)), np.ones(2), 1, 2.0, spread_m=np.ones(4)
    )
    action = TrackedAction(0, 1, flat, flat, np.ones(2), {"table_friction": 1.0}, calibration, {})
    return TrackedTrajectory(
        "NAME", mesh, np.arange(2), np.arange(2.0), np.stack([flat, flat]), np.ones((2, 4), bool),
        (action,), StepRecords.empty(2),
    )  # fmt: skip


def wrongs() -> Iterator[str]:
    """Yield every error with its base."""
    for name, kind in sorted(vars(errors).items()):
        if inspect.isclass(kind) and issubclass(kind, ct.ClothTrackError):
            yield f"{name}({kind.__base__.__name__})"


def surface() -> str:
    """Return the whole list."""
    parts = {"verbs": verbs, "names": names, "files": fields, "errors": wrongs}
    return "\n".join(line for title, part in parts.items() for line in (f"# {title}", *part(), ""))


if __name__ == "__main__":
    Path(sys.argv[1] if len(sys.argv) > 1 else FILE).write_text(surface(), encoding="utf-8")
