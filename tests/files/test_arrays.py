"""Arrays come back as they were written, or are refused."""

import errno
import os
import time
from pathlib import Path

import numpy as np
import pytest
import zarr
from zarr.storage import MemoryStore

from clothtrack.errors import InvalidResultError
from clothtrack.files.arrays import put_array, read_npz, take_array, write_npz

ARRAYS = {"points": np.arange(6.0).reshape(2, 3), "text": np.array("äöü"), "none": np.zeros((0, 3))}


def flipped(data, rng):
    damaged = bytearray(data)
    damaged[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def test_no_flipped_bit_of_an_archive_changes_an_array(tmp_path, rng):
    path = tmp_path / "a.npz"
    write_npz(path, ARRAYS)
    whole = path.read_bytes()
    refused = 0
    for _ in range(200):
        path.write_bytes(flipped(whole, rng))
        try:
            found = read_npz(path)
        except InvalidResultError:
            refused += 1
            continue
        # Remarks of ZIP about dates and systems, or one array less.
        for name, values in found.items():
            np.testing.assert_array_equal(values, ARRAYS[name])
    assert refused > 20


def test_every_flipped_bit_and_every_missing_chunk_is_refused(tmp_path, rng):
    values = np.vstack([rng.normal(size=(4, 5)), np.zeros((2, 5))])
    group = zarr.open_group(tmp_path / "a.zarr", mode="w")
    put_array(group, "values", values, chunks=(2, 5))
    np.testing.assert_array_equal(take_array(group, "values"), values)
    chunks = [one for one in Path(tmp_path).rglob("c/*/*") if one.is_file()]
    assert len(chunks) == 3
    for chunk in chunks:
        whole = chunk.read_bytes()
        for _ in range(20):
            chunk.write_bytes(flipped(whole, rng))
            with pytest.raises(InvalidResultError, match="array values cannot be read"):
                take_array(group, "values")
        chunk.unlink()
        with pytest.raises(InvalidResultError, match="array values lacks 1 of its chunks"):
            take_array(group, "values")
        chunk.write_bytes(whole)


class FullDisk(MemoryStore):
    """Takes what describes an array, and no values."""

    refused = 0

    async def set(self, key, value, byte_range=None):
        if "/c/" in key:
            self.refused += 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        await super().set(key, value)


def test_nothing_is_written_after_the_disk_was_full():
    """Zarr writes chunks side by side; those after the first would go on into a removed folder."""
    disk = FullDisk()
    group = zarr.open_group(disk, mode="w")
    with pytest.raises(OSError, match="No space left"):
        put_array(group, "values", np.ones((50, 3)), chunks=(1, 3))
    time.sleep(0.2)
    assert disk.refused == 1


@pytest.mark.parametrize(
    ("values", "chunks"),
    [
        (np.arange(24).reshape(4, 3, 2), (1, 2, 2)),
        (np.zeros((0, 3)), None),
        (np.array(5), None),
    ],
)
def test_what_was_put_is_taken(values, chunks):
    group = zarr.open_group(MemoryStore(), mode="w")
    put_array(group, "part/values", values, chunks=chunks)
    np.testing.assert_array_equal(take_array(group, "part/values"), values)
