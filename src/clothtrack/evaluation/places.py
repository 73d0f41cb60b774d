"""Where a part of the cloth lies, in words that a person at the picture understands."""

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.recordings.recording import Recording

MIDDLE = 0.25
"""Nearer to the middle of the cloth than this share of its half extent, a part has no side."""


def place_of(
    vertices: Float[np.ndarray, "vertices 3"],
    part: Bool[np.ndarray, " vertices"],
    recording: Recording,
) -> str:
    """Return where a part of the cloth lies in the first camera's picture, such as "at the left".

    Args:
        vertices: of the whole cloth [m, world].
        part: which of them, at least one.
        recording: with its cameras.
    """
    camera = recording.cameras[0] if recording.cameras else None
    whole = vertices[:, :2] if camera is None else camera.project(np.asarray(vertices, float))[0]
    middle, extent = whole.mean(axis=0), np.ptp(whole, axis=0).max() / 2
    across, down = (whole[part].mean(axis=0) - middle) / max(float(extent), 1e-9)
    sides = []
    if abs(down) > MIDDLE:
        sides.append("bottom" if down > 0 else "top")
    if abs(across) > MIDDLE:
        sides.append("right" if across > 0 else "left")
    return f"at the {' '.join(sides)}" if sides else "in the middle"
