"""Zarr groups that detect damage, by a SHA-256 of every array and of all attributes.

Zarr itself reads a missing chunk as zeros, and does not notice altered values.
"""

import hashlib
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import zarr
from zarr.errors import ZarrFutureWarning

from clothtrack.errors import InvalidResultError
from clothtrack.files.array_digest import DIGEST, array_digest

CONTENTS = "contents"

DAMAGE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What Zarr and its codecs raise when a file is damaged."""


def put_array(
    group: zarr.Group,
    name: str,
    values: np.ndarray,
    *,
    unit: str = "",
    chunks: tuple[int, ...] | None = None,
) -> None:
    """Write an array with the SHA-256 of its values."""
    values = np.ascontiguousarray(values)
    sizes = tuple(max(1, size) for size in chunks or values.shape)
    array = group.create_array(name, shape=values.shape, dtype=values.dtype, chunks=sizes)
    # A single assignment would write the chunks in parallel: if the disk refuses one, the others
    # would still be written, into a folder that is being removed.
    for part in _rows(values, sizes):
        array[part] = values[part]
    array.attrs.update({DIGEST: array_digest(values), "unit": unit})


def _rows(values: np.ndarray, chunks: tuple[int, ...]) -> Iterator[Any]:
    """Yield the slice of each row of chunks."""
    if not values.ndim:
        yield ...
        return
    for first in range(0, len(values), chunks[0]):
        yield slice(first, first + chunks[0])


def take_array(group: zarr.Group, name: str) -> np.ndarray:
    """Read an array that `put_array` has written."""
    try:
        array = _member(group, name)
        values = np.asarray(array[...])
        promised = array.attrs[DIGEST]
    except KeyError as error:
        raise InvalidResultError(f"array {name} is missing ({error})") from error
    except DAMAGE as error:
        raise InvalidResultError(f"array {name} cannot be read ({error})") from error
    if array_digest(values) != promised:
        raise InvalidResultError(
            f"array {name} is damaged (its SHA-256 differs from the one it was written with)"
        )
    return values


def seal(group: zarr.Group, attributes: Mapping[str, Any]) -> None:
    """Finish a group: write its attributes, its contents, and a SHA-256 over all attributes."""
    contents = sorted(name for name, _ in group.members(max_depth=None))
    group.attrs.update({**attributes, CONTENTS: contents})
    # This comes last, so that a group without it is unfinished.
    group.attrs[DIGEST] = _digest_of_attributes(group, contents)


def sealed_attributes(group: zarr.Group) -> dict[str, Any]:
    """Return the attributes of a sealed group, after checking all attributes below it, too."""
    attributes = group.attrs.asdict()
    contents, promised = attributes.get(CONTENTS), attributes.get(DIGEST)
    if promised is None or not isinstance(contents, list):
        raise InvalidResultError("its attributes have no SHA-256")
    if _digest_of_attributes(group, contents) != promised:
        raise InvalidResultError(
            "its attributes are damaged (their SHA-256 differs from the one they were written with)"
        )
    return attributes


def _member(group: zarr.Group, name: str) -> zarr.Array | zarr.Group:
    """Return an array or group below a group, without a warning about its type."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrFutureWarning)
        return group[name]


def _digest_of_attributes(group: zarr.Group, contents: Iterable[Any]) -> str:
    own = {name: value for name, value in group.attrs.asdict().items() if name != DIGEST}
    attributes = {"": own}
    for name in contents:
        try:
            attributes[name] = _member(group, name).attrs.asdict()
        except DAMAGE as error:
            raise InvalidResultError(f"{name} is missing or cannot be read ({error})") from error
    # Convert through JSON before sorting names, because it turns numeric names into strings.
    plain = json.loads(json.dumps(attributes))
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()
