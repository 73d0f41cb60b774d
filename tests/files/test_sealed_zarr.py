"""An array that the disk refuses is given up at its first chunk."""

import errno
import os
import time

import numpy as np
import pytest
import zarr
from zarr.storage import MemoryStore

from clothtrack.files.sealed_zarr import put_array, take_array


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
        (np.arange(21.0).reshape(7, 3), (2, 3)),
        (np.arange(24).reshape(4, 3, 2), (1, 2, 2)),
        (np.zeros((0, 3)), None),
        (np.array(5), None),
    ],
)
def test_what_was_put_is_taken(values, chunks):
    group = zarr.open_group(MemoryStore(), mode="w")
    put_array(group, "part/values", values, chunks=chunks)
    np.testing.assert_array_equal(take_array(group, "part/values"), values)
