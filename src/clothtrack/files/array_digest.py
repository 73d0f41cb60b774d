"""The SHA-256 that shows whether an array on disk is what was written."""

import hashlib

import numpy as np

DIGEST = "sha256"
"""Name under which a file stores it."""


def array_digest(values: np.ndarray) -> str:
    """Return the SHA-256 of an array's type, shape and values, in hexadecimal digits."""
    described = f"{values.dtype.str} {values.shape}".encode()
    return hashlib.sha256(described + np.ascontiguousarray(values).tobytes()).hexdigest()
