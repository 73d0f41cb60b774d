"""One moment of a live source, the input of a tracker update."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8


@dataclass(frozen=True, eq=False)
class LivePicture:
    """The data of a camera and a robot at one moment.

    Attributes:
        time_s: seconds since the source's first depth picture.
        depth: depth along the optical axis [m], float32; 0 where nothing was measured.
        color: color picture, red first, registered to depth; None without a color camera.
        mask: true where the picture shows the cloth; None if not known.
        picker: tip position in the world [m] and whether it is closed, per picker name; None if no
            picker is tracked or its pose has stalled.
    """

    time_s: float
    depth: Float[np.ndarray, "height width"]
    color: UInt8[np.ndarray, "height width 3"] | None = None
    mask: Bool[np.ndarray, "height width"] | None = None
    picker: Mapping[str, tuple[Float[np.ndarray, " 3"], bool]] | None = None
