"""Arrays in Zarr groups and NPZ files, whose own checksums refuse damage on reading."""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec
from zarr.errors import ZarrFutureWarning

from clothtrack.errors import InvalidResultError
from clothtrack.files.atomic_write import atomic_file

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

_BEFORE = "sha256"
"""Array of older NPZ files with the digests of the others."""


def put_array(
    group: zarr.Group,
    name: str,
    values: np.ndarray,
    *,
    unit: str = "",
    chunks: tuple[int, ...] | None = None,
) -> None:
    """Write an array whose chunks have a CRC-32C."""
    values = np.ascontiguousarray(values)
    sizes = tuple(max(1, size) for size in chunks or values.shape)
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=values.dtype,
        chunks=sizes,
        compressors=[ZstdCodec(), Crc32cCodec()],
        config={"write_empty_chunks": True},
    )
    # A single assignment would write the chunks in parallel: if the disk refuses one, the others
    # would still be written, into a folder that is being removed.
    for part in _rows(values, sizes):
        array[part] = values[part]
    array.attrs["unit"] = unit


def _rows(values: np.ndarray, chunks: tuple[int, ...]) -> Iterator[Any]:
    """Yield the slice of each row of chunks."""
    if not values.ndim:
        yield ...
        return
    for first in range(0, len(values), chunks[0]):
        yield slice(first, first + chunks[0])


def take_array(group: zarr.Group, name: str) -> np.ndarray:
    """Read an array that `put_array`, or an earlier version without CRC, has written."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ZarrFutureWarning)
            array = group[name]
        values = np.asarray(array[...])
        # Zarr reads a missing chunk as zeros, and earlier versions wrote no chunk of zeros.
        checked = any(isinstance(one, Crc32cCodec) for one in array.compressors)
        missing = array.nchunks - array.nchunks_initialized if checked else 0
    except KeyError as error:
        raise InvalidResultError(f"array {name} is missing ({error})") from error
    except DAMAGE as error:
        raise InvalidResultError(f"array {name} cannot be read ({error})") from error
    if missing:
        raise InvalidResultError(f"array {name} lacks {missing} of its chunks")
    return values


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays, compressed; whole or not at all."""
    with atomic_file(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of an NPZ file; the CRC of ZIP refuses damage."""
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files if name != _BEFORE}
        except Exception as error:
            # NumPy, zipfile and zlib refuse a damaged file with a dozen kinds of exception.
            text = " ".join(str(error).split()) or type(error).__name__
            raise InvalidResultError(f"not a whole NPZ file ({text})") from error
