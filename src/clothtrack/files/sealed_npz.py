"""NPZ files that detect damage: one extra array holds the SHA-256 of every array.

The checksum that ZIP has of each array is short, and is replaced along with the array.
"""

import json
import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidResultError
from clothtrack.files.array_digest import DIGEST, array_digest
from clothtrack.files.atomic_write import atomic_file

logger = logging.getLogger(__name__)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays with the SHA-256 of each, compressed; whole or not at all."""
    digests = {name: array_digest(values) for name, values in arrays.items()}
    with atomic_file(path) as unfinished, unfinished.open("wb") as file:
        # This comes first, because a damaged directory of the archive loses the last entries.
        np.savez_compressed(file, **{DIGEST: np.array(json.dumps(digests)), **arrays})


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read arrays that `write_npz` has written, or an older version without SHA-256."""
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except Exception as error:
            # NumPy, zipfile and zlib refuse a damaged file with a dozen kinds of exception.
            text = " ".join(str(error).split()) or type(error).__name__
            raise InvalidResultError(f"not a whole NPZ file ({text})") from error
    if DIGEST not in arrays:
        logger.info("%s: was written without SHA-256, damage may go unnoticed", path)
        return arrays
    try:
        promised = dict(json.loads(str(arrays.pop(DIGEST))))
    except (ValueError, TypeError, RecursionError) as error:
        raise InvalidResultError(f"the list of its SHA-256 is damaged ({error})") from error
    for name in sorted({*arrays, *promised}):
        if name not in arrays:
            raise InvalidResultError(f"array {name} is missing")
        if array_digest(arrays[name]) != promised.get(name):
            raise InvalidResultError(
                f"array {name} is damaged (its SHA-256 differs from the one it was written with)"
            )
    return arrays
