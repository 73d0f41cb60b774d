"""Masks of the cloth that were found before: who reads a frame twice need not segment it twice."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.recording import Table


@dataclass(frozen=True, eq=False)
class KnownMasks:
    """The cloth is what was found in this frame before: one mask per camera, as a `Segmenter`.

    Attributes:
        packed: the masks by the camera's name, eight pixels a byte: 40 kB for 640 x 480.
    """

    packed: dict[str, UInt8[np.ndarray, " bytes"]] = field(default_factory=dict)

    def keep(self, camera: Camera, mask: Bool[np.ndarray, "height width"]) -> None:
        """Remember what a camera saw of the cloth."""
        self.packed[camera.name] = np.packbits(mask)

    def knows(self, pictures: Mapping[str, object]) -> bool:
        """Whether the masks of all cameras are known that have such a picture."""
        return self.packed.keys() >= pictures.keys()

    def __call__(
        self,
        color: UInt8[np.ndarray, "height width 3"] | None,  # noqa: ARG002
        depth_m: Float[np.ndarray, "height width"],
        camera: Camera,
        table: Table | None,  # noqa: ARG002
    ) -> Bool[np.ndarray, "height width"]:
        """The mask as it was found."""
        bits = np.unpackbits(self.packed[camera.name], count=depth_m.size)
        return bits.view(bool).reshape(depth_m.shape)
