"""The interfaces of the functions that make up Algorithm 1.

`clothtrack.tracking.methods` assembles them into a `Method`; docs/extending.md shows how to pass in
your own.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration, StepRecords


@runtime_checkable
class State(Protocol):
    """The cloth at one time, x_t, from which the dynamics continue."""

    @property
    def positions(self) -> Float[np.ndarray, "environments vertices 3"]:
        """Vertices in the world [m]; Algorithm 1 has one environment."""
        ...


@runtime_checkable
class Prediction(Protocol):
    """The end of a roll-out of the dynamics."""

    @property
    def state(self) -> State:
        """The state to continue from."""
        ...

    @property
    def positions(self) -> Float[np.ndarray, "environments vertices 3"]:
        """Vertices at the end [m]."""
        ...

    @property
    def started_at(self) -> Float[np.ndarray, "environments vertices 3"]:
        """Vertices at the start [m]."""
        ...

    @property
    def highest_speed(self) -> Float[np.ndarray, " environments"]:
        """Highest speed of a free vertex during the roll-out [m/s]."""
        ...

    @property
    def exact(self) -> bool:
        """Whether tracking may continue from this state; a coarse prediction is only aligned."""
        ...


@runtime_checkable
class Dynamics(Protocol):
    """dyn(x, a) and dyn(x, a, a~) for one choice of the cloth's parameters."""

    def __call__(
        self, state: State, action: PickerAction, pseudo_action: Attachment | None = None
    ) -> Prediction:
        """Roll the cloth out for the duration of an action."""
        ...

    def predict(self, state: State, action: PickerAction) -> Prediction:
        """Return x'_{t+1} = dyn(x_t, a_t) for the alignment; it may be coarse for speed."""
        ...


@runtime_checkable
class Grasps(Protocol):
    """Grasps of the pickers during an action."""

    def action(self, start_s: float, end_s: float) -> PickerAction:
        """Return a_t: what the pickers do between two times [s]."""
        ...

    def closed_at(self, time_s: float) -> bool:
        """Return whether any picker still holds cloth at this time [s]."""
        ...

    def identity(self, theta: Theta) -> tuple[object, ...]:
        """Return a key that is equal for parameters with the same grasp of the same cloth."""
        ...

    @property
    def held_vertices(self) -> Mapping[str, tuple[int, ...]]:
        """The vertices that each picker holds, by the picker's name."""
        ...


@dataclass(frozen=True, eq=False)
class Candidate:
    """One choice of parameters for an action."""

    theta: Theta
    grasps: Grasps


@dataclass(frozen=True, eq=False)
class TrackedCandidate:
    """One action that was tracked to its last frame with one candidate, before TTO2.

    Attributes:
        positions: vertices [m] at every frame after the action's first.
        records: record of each frame; those outside the action are empty.
    """

    action: PickAndPlace
    candidate: Candidate
    positions: Float32[np.ndarray, "frames vertices 3"]
    state: State
    records: StepRecords


@runtime_checkable
class Search(Protocol):
    """The calibration of one action (paper, Sec. III-B.1), as an ask-and-tell interface.

    Iteration yields the candidates to track; each is passed to `tell` before the next is yielded.
    """

    def __iter__(self) -> Iterator[Candidate]:
        """Yield candidates until the search ends; at least one."""
        ...

    def tell(self, tracked: TrackedCandidate) -> None:
        """Receive the tracked candidate that was yielded last."""
        ...

    def result(self) -> tuple[TrackedCandidate, State, Calibration]:
        """Return the best candidate, the state to continue from, and the record of the search."""
        ...


@dataclass(frozen=True, eq=False)
class Correction:
    """Correction of a predicted mesh by the cloud: delta x_corr (paper, Sec. III-B.2).

    Attributes:
        start: vertices that the alignment started from [m].
        displacement: displacement from there to the aligned vertices [m].
        losses: objective [m^2] before and after.
    """

    start: Float[np.ndarray, "vertices 3"]
    displacement: Float[np.ndarray, "vertices 3"]
    attached: Bool[np.ndarray, " vertices"]
    losses: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Corrected:
    """The cloth after one frame.

    Attributes:
        scale: share of the correction that was applied; NaN without a correction, 0 if the line
            search gave up.
        gave_up: whether no share of the correction was stable; then the prediction is kept.
    """

    prediction: Prediction
    scale: float = np.nan
    trials: int = 0
    gave_up: bool = False

    @property
    def state(self) -> State:
        """The state to continue from."""
        return self.prediction.state


Observe = Callable[[Frame], Observation]
"""Return the point cloud P_t of a frame."""

Align = Callable[[Prediction, Observation], Correction | None]
"""TTO1: return the correction of a predicted mesh to the cloud; None keeps the prediction."""

LineSearch = Callable[[Dynamics, State, PickerAction, Prediction, Correction | None], Corrected]
"""Roll out the dynamics again with the largest stable share of the correction."""

AlignLast = Callable[[State, Theta, Observation, bool], tuple[State, tuple[float, float]]]
"""TTO2: return the cloth at the end of an action, at rest, and the objective [m^2] before and after
(NaN if nothing was aligned). The last argument says whether a picker still holds it."""

Calibrate = Callable[[PickAndPlace, State, Theta], Search]
"""Begin the search for the parameters of an action; theta is the previous action's."""

AtRest = Callable[[PickerAction, Frame, Frame], bool]
"""Return whether no picker holds the cloth and it did not move between the two frames, so that the
mesh stays as it is (not in the paper)."""

Anchor = Callable[[State, Observation], None]
"""Bind the visible feature tracks to material points (not in the paper)."""

Watch = Callable[[Recording, ClothMesh, Frame, Float[np.ndarray, "vertices 3"]], None]
"""Called with each mesh [m] as soon as it is known: the first one, those of every candidate frame
by frame, and the final one of the chosen candidate."""


@dataclass(frozen=True)
class Method:
    """The functions of Algorithm 1; an ablation replaces one.

    Attributes:
        observe: returns the point cloud of a frame.
        line_search: rolls out the dynamics with the pseudo-action.
        anchor: binds feature tracks to material points at the start of every action.
        at_rest: returns whether the cloth is at rest.
    """

    observe: Observe
    calibrate: Calibrate
    dynamics: Callable[[Theta], Dynamics]
    align: Align
    line_search: LineSearch
    align_last: AlignLast
    anchor: Anchor
    at_rest: AtRest
