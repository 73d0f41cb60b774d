"""One moment of a live source: what a tracker is updated with."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8


@dataclass(frozen=True, eq=False)
class LivePicture:
    """What a camera and a robot tell of one moment.

    Attributes:
        time_s: seconds since the source's first depth picture.
        depth: along the optical axis [m], float32; 0 where nothing was measured.
        color: red first, registered to depth; None without a color camera.
        mask: true where the picture shows the cloth; None where nobody says.
        picker: name to tip position in the world [m] and whether it is closed; None where no
            picker is followed, or its pose has stalled.
    """

    time_s: float
    depth: Float[np.ndarray, "height width"]
    color: UInt8[np.ndarray, "height width 3"] | None = None
    mask: Bool[np.ndarray, "height width"] | None = None
    picker: Mapping[str, tuple[Float[np.ndarray, " 3"], bool]] | None = None
