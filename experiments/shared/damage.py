"""Seeded damage to bytes, documents, tables, arrays and words."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

NASTY = (0, 1, 0x7F, 0x80, 0xFF)
LONG = "long" * 1250
"""A text that no message may repeat whole."""

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**70), 10**30, 0.5, -0.0, 1e-320, 1e308, -1e308,
    float("nan"), float("inf"), "", "0", "nan", "../x", "/etc/hostname", "a/b", "\x00", "\n",
    "\u202e", "\ud800", LONG, [], {}, [[]], [None], [0] * 1000, {"a": {"b": {}}}, {"": 1}, [1e309],
    ["x", 1],
)  # fmt: skip
"""What a field of a document may be replaced by."""

TEXTS = (
    "", " ", "0", "-1", "1", "-0", "1e308", "1e309", "1e-320", "nan", "NaN", "inf", "-Infinity",
    "null", "true", "None", "[]", "[1]", "[1,2]", "[1,2,3]", "{}", '"', '""', "'", "=", "==", ".",
    "..", "../x", "/", "/dev/null", "/etc/hostname", "\t", "\n", "\u202e", "é", "\ud800", LONG,
    "[" * 2000, "9" * 5000, "0x10", "1_000", "1,5", "--", "-", "--help", "%s%n", "$(x)", "{0}",
    "cpu", "cuda:0", "tpu", "2147483648", "1.5", "[null, null]", "[1e400, 0]", "towel",
)  # fmt: skip
"""What a word of the command line, or a cell of a table, may be replaced by."""


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with a few changes: flipped, overwritten, cut, doubled, shorter or longer."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        if not data:
            break
        # Half of the damage hits the start, where the structure is.
        reach = len(data) if rng.random() < 0.5 else min(len(data), 4096)
        at, size = int(rng.integers(reach)), int(2 ** rng.integers(0, 7))
        how = rng.integers(7)
        if how == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif how == 1:
            data[at : at + size] = bytes(rng.integers(0, 256, size, dtype=np.uint8))
        elif how == 2:
            data[at : at + 4] = bytes([NASTY[int(rng.integers(len(NASTY)))]] * 4)
        elif how == 3:
            del data[at : at + size]
        elif how == 4:
            data[at:at] = data[at : at + size]
        elif how == 5:
            data[at : at + 8] = int(rng.integers(0, 2**63)).to_bytes(8, "little")
        else:
            del data[int(rng.integers(len(data))) :]
    return bytes(data)


def damage_file(path: Path, rng: np.random.Generator) -> None:
    """Damage the bytes of a file, empty it, take it away, or put a folder in its place."""
    how = rng.random()
    if how < 0.8:
        path.write_bytes(damaged(path.read_bytes(), rng))
    elif how < 0.86:
        path.write_bytes(b"")
    else:
        path.unlink()
        if how > 0.95:
            path.mkdir()


def chosen(options: Any, rng: np.random.Generator) -> Any:
    """Return one of a sequence."""
    return options[int(rng.integers(len(options)))]


def spoilt_document(document: Any, rng: np.random.Generator) -> Any:
    """Return a JSON document with one value, somewhere in it, replaced, taken away or doubled."""
    spots: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        keys = value if isinstance(value, dict) else range(len(value))
        for key in keys:
            spots.append((value, key))
            if isinstance(value[key], dict | list):
                walk(value[key])

    if not isinstance(document, dict | list) or not document:
        return chosen(VALUES, rng)
    walk(document)
    # Half of the damage hits the upper levels: lists of numbers would get it all.
    reach = len(spots) if rng.random() < 0.5 else min(len(spots), 40)
    owner, key = spots[int(rng.integers(reach))]
    how = rng.random()
    if how < 0.15:
        del owner[key]
    elif how < 0.25 and isinstance(owner, list):
        owner.insert(key, owner[key])
    elif how < 0.45 and isinstance(owner[key], int | float):
        owner[key] *= float(chosen((-1, 0, 1e-9, 0.001, 2, 1000, 1e12), rng))
    elif how < 0.55 and isinstance(owner, dict):
        owner[chosen(("", "x", LONG, *owner), rng)] = owner.pop(key)
    else:
        owner[key] = chosen(VALUES, rng)
    return document


def spoilt_text(text: str, rng: np.random.Generator) -> str:
    """Return a table or mesh in text with one cell or line replaced, taken away or doubled."""
    lines = text.splitlines()
    at = int(rng.integers(len(lines))) if rng.random() < 0.7 else min(int(rng.integers(4)),
                                                                    len(lines) - 1)  # fmt: skip
    how = rng.random()
    if how < 0.15:
        del lines[at]
    elif how < 0.3:
        lines.insert(at, lines[at])
    elif how < 0.4:
        lines = lines[:at]
    elif how < 0.5:
        lines[at] = str(chosen(TEXTS, rng))
    else:
        mark = "," if "," in lines[at] else " "
        cells = lines[at].split(mark)
        cells[int(rng.integers(len(cells)))] = str(chosen(TEXTS, rng))
        lines[at] = mark.join(cells)
    return "\n".join(lines) + "\n"


def spoilt_arrays(arrays: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return arrays of which one has other values, another shape or type, or is gone."""
    arrays = dict(arrays)
    name = chosen(sorted(arrays), rng)
    arrays[name] = chosen(_CHANGES, rng)(arrays[name], arrays, rng)
    if rng.random() < 0.1:
        del arrays[name]
    return arrays


def _set_some(values: np.ndarray, _: Any, rng: np.random.Generator) -> np.ndarray:
    if values.dtype.kind not in "fiu" or not values.size:
        return np.array(chosen(("", "{", "null", LONG, "[]", "{}"), rng))
    extremes: tuple[Any, ...] = (np.nan, np.inf, -np.inf, 1e30, -1e9, 0.0)
    if values.dtype.kind in "iu":
        limit = np.iinfo(values.dtype)
        extremes = (limit.max, limit.min, 0, 1)
    values = values.copy()
    spots = rng.integers(0, values.size, int(chosen((1, 1, 3, values.size), rng)))
    values.flat[spots] = chosen(extremes, rng)
    return values


def _other_type(values: np.ndarray, _: Any, rng: np.random.Generator) -> np.ndarray:
    kind = chosen(("f2", "f8", "i1", "u8", "c8", "?", "U3", "S2"), rng)
    with np.errstate(all="ignore"):
        try:
            return values.astype(kind)
        except (ValueError, TypeError):
            return np.array(0)


_CHANGES: tuple[Callable[..., np.ndarray], ...] = (
    _set_some,
    _set_some,
    _set_some,
    _other_type,
    lambda values, *_: values[:-1] if values.ndim and len(values) else values[None],
    lambda values, *_: values[:0] if values.ndim else np.zeros((0, 3)),
    lambda values, *_: np.concatenate([values, values]) if values.ndim else values[None, None],
    lambda values, *_: values.reshape(-1),
    lambda values, *_: values.T,
    lambda values, *_: values[..., None],
    lambda _, arrays, rng: arrays[chosen(sorted(arrays), rng)],
)
