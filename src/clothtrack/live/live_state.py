"""Estimated state of the cloth after a picture."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Float32


@dataclass(frozen=True, eq=False)
class LiveState:
    """State of the cloth after a picture.

    Attributes:
        time_s: time of the picture [s], on the caller's clock.
        frame: number of the picture, from 0; dropped ones count.
        positions: vertices in the world [m], hidden ones included.
        visible: whether the camera sees the vertex.
        expected_error_m: expected error of each vertex [m], from the last judgment; NaN before it.
        lost: vertices more than 15 mm away from the observation, from the last judgment.
        judged_s: time of the last judged picture [s]; NaN before. Judgments run in parallel with
            the stream, a few times per second.
        acting: whether an action is in progress.
        settling: whether the final alignment of the last action is still running in parallel with
            the stream; a later state includes it.
        picker_lag_s: delay of the cloth's motion after the closed picker's in the last action, in
            the given times [s]; below 0 if the picker's times are late, 0 if no lag was found.
        held: vertices that each closed picker holds, by its name.
        latency_s: time from the call of `update` to this state [s]; in a `LiveStream` from the
            arrival of the picture.
        spent_s: CPU time per step for this picture [s]: "observe" (segmentation, cloud and followed
            points, in a separate thread), "predict", "align", "correct".
        dropped: number of pictures not processed so far.
        stalled: sources without data for 0.2 s: "camera", or a picker's name.
        notes: problems with this picture, in words.
    """

    time_s: float
    frame: int
    positions: Float32[np.ndarray, "vertices 3"]
    visible: Bool[np.ndarray, " vertices"]
    expected_error_m: Float[np.ndarray, " vertices"]
    lost: Bool[np.ndarray, " vertices"]
    judged_s: float
    acting: bool
    settling: bool
    picker_lag_s: float
    held: Mapping[str, tuple[int, ...]]
    latency_s: float
    spent_s: Mapping[str, float] = field(default_factory=dict)
    dropped: int = 0
    stalled: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return one line, without the positions."""
        lost = f", {100 * self.lost.mean():.0f} % lost" if self.lost.any() else ""
        return (
            f"LiveState({self.time_s:.2f} s, {len(self.positions)} vertices, "
            f"{1e3 * self.latency_s:.0f} ms{lost})"
        )
