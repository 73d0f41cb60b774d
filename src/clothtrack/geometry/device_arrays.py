"""Writes arrays of NumPy into arrays of Warp that exist already."""

import numpy as np
import warp as wp


def overwrite(array: wp.array, values: np.ndarray) -> None:
    """Write values into an array; on a CPU without a copy in between.

    `wp.array.assign` makes an array of its own first, which takes longer than the copy.

    Args:
        array: of any type; its memory is kept.
        values: as many, or one row (first axis) that is given to all rows.
    """
    if wp.get_device(array.device).is_cpu:
        np.copyto(array.numpy(), values)
        return
    rows = (array.shape[0], *values.shape[1:])
    array.assign(np.ascontiguousarray(np.broadcast_to(values, rows)))
