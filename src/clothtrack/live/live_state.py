"""What is known of the cloth after a picture."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Float32


@dataclass(frozen=True, eq=False)
class LiveState:
    """The cloth after a picture.

    Attributes:
        time_s: when the picture was taken [s], on the caller's clock.
        frame: number of the picture, from 0; dropped ones count.
        positions: vertices in the world [m], hidden ones included.
        visible: whether the camera sees the vertex.
        expected_error_m: error to expect of each vertex [m], by the last judgment; NaN before it.
        lost: vertices that lie more than 15 mm away from what was seen, by the last judgment.
        judged_s: time of the picture that was judged last [s]; NaN before. A judgment is made
            beside the stream, a few times a second.
        acting: whether an action is under way.
        settling: whether the final alignment of the last action is still being made beside the
            stream; a later state has it.
        searching: whether candidates of an action that has ended are still being tracked beside
            the stream. The mesh of the first picture between actions that has the answer is the
            better one; an action that begins earlier begins from the one that was tracked live.
        astray: whether the mesh has lost the cloth: a fifth of the vertices is lost, in two
            judgments. Once no picker holds the cloth, the network is asked for another mesh.
        picker_lag_s: how long after the closed picker the cloth moved in the last action, by the
            times that were given [s]; below 0 where the picker's are late, 0 where nothing speaks
            against them.
        held: the vertices that each closed picker holds, by its name.
        latency_s: from the call of `update` to this state [s]; in a `LiveStream` from the arrival
            of the picture.
        spent_s: CPU time of the parts of this picture [s]: "observe" (segmentation, cloud and
            followed points, in a thread of its own), "predict", "align", "correct".
        dropped: pictures that were not served so far.
        stalled: what has sent nothing for 0.2 s: "camera", or a picker's name.
        notes: what was wrong with this picture, in words.
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
    searching: bool
    astray: bool
    picker_lag_s: float
    held: Mapping[str, tuple[int, ...]]
    latency_s: float
    spent_s: Mapping[str, float] = field(default_factory=dict)
    dropped: int = 0
    stalled: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """One line, without the positions."""
        lost = f", {100 * self.lost.mean():.0f} % lost" if self.lost.any() else ""
        return (
            f"LiveState({self.time_s:.2f} s, {len(self.positions)} vertices, "
            f"{1e3 * self.latency_s:.0f} ms{lost})"
        )
