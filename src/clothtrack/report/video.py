"""Writing of PNG pictures and of H.264 MP4 videos that every browser plays."""

import itertools
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import atomic_file, write_file


def write_video(
    pictures: Iterable[UInt8[np.ndarray, "height width 3"]],
    path: Path,
    *,
    frames_per_second: float,
    quality: int = 26,
) -> int:
    """Encode RGB pictures of one size and return their number.

    Sizes are made even by repeating the last row or column, as 4:2:0 requires. `quality` is x264's
    rate factor: 18 looks like the source, 30 is coarse.
    """
    pictures = iter(pictures)
    first = next(pictures, None)
    if first is None:
        raise InvalidConfigError(f"{path}: there is no frame to show; track at least one frame")
    height, width = (side + side % 2 for side in first.shape[:2])
    count = 0
    with atomic_file(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream(
            "libx264", rate=Fraction(frames_per_second).limit_denominator(1000)
        )
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        # Two key frames per second, because the page seeks in the video.
        stream.options = {
            "crf": str(quality),
            "preset": "veryfast",
            "g": str(max(1, round(frames_per_second / 2))),
            "threads": "1",
        }
        for picture in itertools.chain([first], pictures):
            even = np.pad(
                picture,
                ((0, height - picture.shape[0]), (0, width - picture.shape[1]), (0, 0)),
                mode="edge",
            )
            for packet in stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")):
                container.mux(packet)
            count += 1
        for packet in stream.encode():
            container.mux(packet)
    return count


def write_picture(path: Path, picture: UInt8[np.ndarray, "height width 3"]) -> None:
    """Write a picture, red first, as PNG, whole or not at all."""
    # Encode in memory, since on a full disk OpenCV only writes a line to standard error.
    done, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    assert done, "OpenCV refuses a picture whose shape and type were checked"
    write_file(path, data.tobytes())


def frame_rate(time_s: Float[np.ndarray, " frames"]) -> float:
    """Return the frame rate of a real-time video [1/s], within 2 to 60."""
    steps = np.diff(time_s)
    steps = steps[steps > 0]
    return float(np.clip(1.0 / np.median(steps), 2.0, 60.0)) if len(steps) else 10.0
