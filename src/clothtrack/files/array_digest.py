"""The SHA-256 by which an array on disk is known to be what was written."""

import hashlib

import numpy as np

DIGEST = "sha256"
"""Under what name a file keeps it."""


def array_digest(values: np.ndarray) -> str:
    """Return SHA-256 of an array's type, shape and values, in hexadecimal digits."""
    described = f"{values.dtype.str} {values.shape}".encode()
    return hashlib.sha256(described + np.ascontiguousarray(values).tobytes()).hexdigest()
