"""Write NumPy arrays into existing Warp arrays."""

import numpy as np
import warp as wp


def overwrite(array: wp.array, values: np.ndarray) -> None:
    """Write values into an array; on a CPU without an intermediate copy.

    `wp.array.assign` first creates a temporary array, which takes longer than the copy.
    """
    if wp.get_device(array.device).is_cpu:
        np.copyto(array.numpy(), values)
        return
    rows = (array.shape[0], *values.shape[1:])
    array.assign(np.ascontiguousarray(np.broadcast_to(values, rows)))
