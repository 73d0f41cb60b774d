"""What Algorithm 1 is made of: the protocols behind which every part can be exchanged.

`clothtrack.tracking.tracker` assembles the parts of a configuration; docs/extending.md shows how
to hand in one of your own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.simulation.dynamics import PickerAction
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration, StepRecords

Observe = Callable[[Frame], Observation]
"""The point cloud P_t of a frame."""

Watch = Callable[[Recording, ClothMesh, Frame, Float[np.ndarray, "vertices 3"]], None]
"""Is shown each mesh [m] as soon as it is known: the first one, those of every pass over an action
frame by frame, and the one that the chosen pass ends with."""


State = Any
"""The cloth at one time, x_t: whatever the dynamics go on from.

Algorithm 1 reads its `positions` only: vertices in the world [m], shape (1, vertices, 3).
"""


@runtime_checkable
class Prediction(Protocol):
    """What a roll-out of the dynamics ends with."""

    @property
    def state(self) -> State:
        """To go on from."""
        ...

    @property
    def positions(self) -> Float[np.ndarray, "environments vertices 3"]:
        """Vertices at its end [m]."""
        ...

    @property
    def started_at(self) -> Float[np.ndarray, "environments vertices 3"]:
        """Vertices at its start [m]."""
        ...

    @property
    def highest_speed(self) -> Float[np.ndarray, " environments"]:
        """Of a free vertex on the way [m/s]."""
        ...


@dataclass(frozen=True, eq=False)
class Correction:
    """What the cloud says about a predicted mesh: delta x_corr (paper, Sec. III-B.2).

    Attributes:
        start: the vertices that the alignment started from [m].
        displacement: from there to where the cloud wants them [m].
        attached: the vertices that a pseudo-action takes hold of.
        losses: objective [m^2] before and after.
    """

    start: Float[np.ndarray, "vertices 3"]
    displacement: Float[np.ndarray, "vertices 3"]
    attached: Bool[np.ndarray, " vertices"]
    losses: tuple[float, float]


@runtime_checkable
class Dyn(Protocol):
    """dyn(x, a) and dyn(x, a, a~): the cloth after one frame."""

    def __call__(
        self, state: State, action: PickerAction, pseudo_action: Attachment | None = None
    ) -> Prediction:
        """Move the cloth for the duration of an action.

        Args:
            state: the cloth before.
            action: what the pickers do.
            pseudo_action: where an observation wants vertices at the end.
        """
        ...


@runtime_checkable
class Dynamics(Protocol):
    """Dynamics as a function of the cloth's parameters."""

    def __call__(self, theta: Theta) -> Dyn:
        """The dynamics of a cloth with these parameters."""
        ...


@runtime_checkable
class Predict(Protocol):
    """x'_{t+1} = dyn(x_t, a_t): where an alignment starts from."""

    def __call__(self, dyn: Dyn, state: State, action: PickerAction) -> Prediction:
        """The cloth after a frame, before its cloud is looked at.

        Args:
            dyn: the dynamics.
            state: the cloth before the frame.
            action: what the pickers do during it.
        """
        ...


def exact(dyn: Dyn, state: State, action: PickerAction) -> Prediction:
    """The dynamics as they are: the paper's prediction."""
    return dyn(state, action)


def coarse(dyn: Dyn, state: State, action: PickerAction) -> Prediction:
    """The dynamics as coarse as they can be: `dyn.predict(state, action)`, where they have it."""
    return getattr(dyn, "predict", dyn)(state, action)


@runtime_checkable
class Aligner(Protocol):
    """Test-time optimisation 1: mesh to cloud."""

    def __call__(self, predicted: Prediction, observation: Observation) -> Correction | None:
        """How a predicted mesh has to move to meet the cloud.

        Args:
            predicted: where the dynamics ended.
            observation: the cloud of the frame.

        Returns:
            None when there is nothing to align to: the prediction stands.
        """
        ...


@dataclass(frozen=True, eq=False)
class Corrected:
    """The cloth after one frame.

    Attributes:
        prediction: the roll-out that was accepted.
        scale: the share of the correction that it was given; NaN without a correction, 0 when the
            line search gave up.
        trials: roll-outs spent on it.
        gave_up: no share of the correction was stable: the prediction stands.
    """

    prediction: Prediction
    scale: float = np.nan
    trials: int = 0
    gave_up: bool = False

    @property
    def state(self) -> State:
        """The state to go on from."""
        return self.prediction.state


@runtime_checkable
class LineSearch(Protocol):
    """Rolls the dynamics again with the correction as pseudo-action."""

    def __call__(
        self,
        dyn: Dyn,
        state: State,
        action: PickerAction,
        predicted: Prediction,
        correction: Correction | None,
    ) -> Corrected:
        """The cloth after a frame, with as much of the correction as it can take.

        Args:
            dyn: the dynamics.
            state: the cloth before the frame.
            action: what the pickers do during it.
            predicted: the roll-out without a pseudo-action, which the correction starts from.
            correction: what the cloud wants; None leaves the dynamics alone.
        """
        ...


@runtime_checkable
class AlignLast(Protocol):
    """Test-time optimisation 2: at the end of an action the mesh is aligned once more."""

    def __call__(
        self, state: State, theta: Theta, observation: Observation, held: bool
    ) -> tuple[State, tuple[float, float]]:
        """The cloth that the next action starts from, at rest.

        Args:
            state: the cloth at the action's last frame.
            theta: its parameters.
            observation: the cloud of that frame.
            held: some picker still holds it.

        Returns:
            The state, and the objective [m^2] before and after; NaN where nothing was aligned.
        """
        ...


@runtime_checkable
class Grasps(Protocol):
    """What the pickers of an action hold."""

    def action(self, start_s: float, end_s: float) -> PickerAction:
        """What they do between two times [s]: a_t."""
        ...

    def closed_at(self, time_s: float) -> bool:
        """Whether any of them still holds cloth at this time [s]."""
        ...

    def identity(self, theta: Theta) -> tuple[object, ...]:
        """Equal for choices of theta that come to the same hold of the same cloth."""
        ...

    @property
    def held_vertices(self) -> Mapping[str, tuple[int, ...]]:
        """The vertices each picker holds, by its name."""
        ...


@runtime_checkable
class Pick(Protocol):
    """Decides what the pickers hold."""

    def __call__(self, action: PickAndPlace, state: State, theta: Theta) -> Grasps:
        """What they take hold of where the cloth lies when the action starts."""
        ...


@dataclass(frozen=True, eq=False)
class FollowedAction:
    """One action, followed to its last frame with one choice of parameters.

    Attributes:
        action: the pick-and-place.
        theta: the parameters.
        grasps: what the pickers held.
        positions: vertices [m] at every frame after the action's first.
        state: the cloth at the last one.
        records: what happened at each frame; those outside the action are empty.
    """

    action: PickAndPlace
    theta: Theta
    grasps: Grasps
    positions: Float32[np.ndarray, "frames vertices 3"]
    state: State
    records: StepRecords


@runtime_checkable
class Calibrate(Protocol):
    """Finds the cloth's parameters for one action (paper, Sec. III-B.1)."""

    def __call__(
        self,
        action: PickAndPlace,
        state: State,
        theta: Theta,
        follow_with: Callable[[Theta], FollowedAction],
    ) -> tuple[Theta, Calibration]:
        """The parameters that suit an action best, and the record of all candidates.

        Args:
            action: the pick-and-place.
            state: the cloth at its first frame.
            theta: where the search starts: the previous action's optimum.
            follow_with: Algorithm 1's inner loop over this action with these parameters; the one
                that is chosen is not followed a second time.
        """
        ...


@runtime_checkable
class Combine(Protocol):
    """Makes one end of an action of the candidates that were followed to it."""

    def __call__(self, state: State, theta: Theta, calibration: Calibration) -> State:
        """The cloth that the final alignment starts from.

        Args:
            state: where the pass that was chosen ends.
            theta: its parameters.
            calibration: all candidates, and where they end in the mean.
        """
        ...


@runtime_checkable
class Mark(Protocol):
    """Colour as a second witness: binds points that are followed in the pictures to the cloth."""

    def __call__(self, state: State, observation: Observation) -> None:
        """Note which material points they are; TTO1 and TTO2 ask for it later.

        Args:
            state: the cloth at the first frame of an action.
            observation: what is seen there.
        """
        ...


@dataclass(frozen=True)
class Parts:
    """The functions that Algorithm 1 is made of.

    Attributes:
        observe: the point cloud of a frame.
        pick: what the pickers hold.
        calibrate: theta of an action.
        dynamics: dyn, given theta.
        predict: what is aligned.
        align: TTO1.
        line_search: the pseudo-action.
        combine: one end of an action of all candidates.
        align_last: TTO2.
        mark: binds points that are followed in the pictures to the cloth, at every action.
    """

    observe: Observe
    pick: Pick
    calibrate: Calibrate
    dynamics: Dynamics
    predict: Predict
    align: Aligner
    line_search: LineSearch
    combine: Combine
    align_last: AlignLast
    mark: Mark
