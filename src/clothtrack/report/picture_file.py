"""Pictures of a report on disk."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from clothtrack.files.atomic_write import write_file


def write_picture(path: Path, picture: UInt8[np.ndarray, "height width 3"]) -> None:
    """Write a picture, red first, as PNG, whole or not at all.

    Raises:
        StorageError: when the disk refuses.
    """
    # In memory first: on a full disk OpenCV only writes a line of its own to standard error.
    done, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    assert done, "OpenCV refuses a picture whose shape and type were checked"
    write_file(path, data.tobytes())
