"""The named methods: the functions that make up Algorithm 1.

`default` is ours and `paper` is the method as published. Each is written out in full, so that they
can be compared side by side. docs/method.md gives the reason for every difference and its measured
effect.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Literal, cast

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.aligner import AlignmentConfig
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.recording import PickAndPlace, Recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import SETTLE_IN_S
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.calibration import (
    OpenLoopCalibration,
    OutlineGap,
    TrackingCalibration,
    Uncalibrated,
)
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.ensemble import MeanOfCandidates
from clothtrack.tracking.feature_anchors import FeatureAnchors, no_anchors
from clothtrack.tracking.final_alignment import FinalAlignment, no_final_alignment
from clothtrack.tracking.line_search import PseudoActionSearch
from clothtrack.tracking.open_loop import BATCH, OpenLoopScore
from clothtrack.tracking.picking import HeldCloth, pick
from clothtrack.tracking.protocols import Anchor, Calibrate, Dynamics, Method, Observe, State
from clothtrack.tracking.rest import PicturesAtRest, never_at_rest
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.visible_alignment import VisibleAlignment, no_alignment, only_at

SOFT = 0.999
"""Strength of the default's pseudo-action: observed vertices are pulled inside the solver loop."""

HELD = 1.0
"""Strength of the paper's pseudo-action: visible vertices are placed at their targets."""

PREDICTION_COARSENESS = 2
"""Substeps of the default's predictions are this many times as long. A prediction that is only
aligned need not be exact, since the accepted roll-out is computed anew. It saves a tenth of the
time."""

_ANCHOR_WEIGHT = 300.0
"""Weight of a vertex's feature-track target: each track counts as this many cloud points."""

_ICP_TOLERANCE = 0.02
"""Gauss-Newton ends when two iterations together lower the objective by less than this share."""

FLEX_SLEEP_SPEED = 0.02
"""Supported vertices slower than this [m/s] stand still in the paper's simulator."""

_MIN_OBSERVED = 0.5
"""Minimum share of the first mesh's visible vertices that the cloud must be able to contradict;
below it, the mesh is not aligned to the cloud."""

_VISIBILITY_WIDTH = 320
"""Width of the z-buffer that determines visibility [pixels]; its pixels are finer than the
mesh's edges."""

VISIBILITY_TOLERANCE_M = 0.003
"""How far behind the z-buffer's surface a vertex still counts as visible [m]; less than
the distance of two layers."""


@dataclass(frozen=True, eq=False)
class Components:
    """Components that the functions of a method share, for one recording and one cloth.

    Attributes:
        mesh: the flat cloth in the world [m]; its edges give the rest lengths.
        start: vertices at the first frame [m], if the cloth does not lie flat there.
    """

    recording: Recording
    mesh: ClothMesh
    config: RunConfig
    observe: Observe
    start: Float[np.ndarray, "vertices 3"] | None = None
    device: str = "cpu"

    @cached_property
    def visible(self) -> VisibilityCheck:
        """Check of which vertices some camera sees."""
        cameras = tuple(camera.resized(_VISIBILITY_WIDTH) for camera in self.recording.cameras)
        return VisibilityCheck(
            self.mesh.faces, cameras, tolerance_m=VISIBILITY_TOLERANCE_M, device=self.device
        )

    @cached_property
    def search(self) -> SearchConfig:
        """Settings of the search, with the grasp uncertainty that the recording states."""
        return self.config.search.with_grasp_offset(self.recording.cloth.grasp_uncertainty_m)

    @cached_property
    def anchors(self) -> FeatureAnchors:
        """Feature tracks bound to the cloth."""
        return FeatureAnchors(self.mesh, self.visible)

    def pick(self, action: PickAndPlace, state: ClothState, theta: Theta) -> HeldCloth:
        """Return what the pickers grasp."""
        return pick(action, state, theta, recording=self.recording, mesh=self.mesh)

    def simulator(
        self, *, velocity_kept: float, prediction_coarseness: int = 1, sleep_speed: float = 0.0
    ) -> ClothDynamics:
        """Return the dynamics with the cloth at the first frame, at rest."""
        config = self.config.cloth.solver(self.recording.table, sleep_speed=sleep_speed)
        solver = ClothSolver(self.mesh, config, device=self.device)
        if self.start is not None:
            # Step once while flat so that contact stores which side of each triangle every vertex
            # is on.
            solver.step(SETTLE_IN_S)
            solver.place(self.start)
            solver.set_velocities(np.zeros_like(self.start))
        return ClothDynamics(solver, velocity_kept, prediction_coarseness)

    def dynamics(self, simulator: ClothDynamics) -> Callable[[Theta], Dynamics]:
        """Return dyn as a function of theta."""

        def with_parameters(theta: Theta) -> Dynamics:
            simulator.solver.set_parameters(theta.cloth_parameters(self.mesh))
            # These dynamics receive only states that they have produced.
            return cast(Dynamics, simulator)

        return with_parameters

    def aligner(
        self, solver: Literal["adam", "icp"], *, icp_tolerance: float = 0.0, **attached: bool
    ) -> VisibleAlignment:
        """Return an alignment of the visible vertices with the weights of the configuration."""
        alignment = AlignmentConfig(
            **asdict(self.config.objective), solver=solver, icp_tolerance=icp_tolerance,
            marks_weight=_ANCHOR_WEIGHT if self.config.color else 0.0,
        )  # fmt: skip
        return VisibleAlignment(
            self.mesh, alignment, self.visible, table=self.recording.table,
            rest_height_m=0.5 * self.config.cloth.thickness_m, anchors=self.anchors,
            device=self.device, **attached,
        )  # fmt: skip

    @property
    def anchor(self) -> Anchor:
        """Function that binds feature tracks; it does nothing if color is switched off."""
        return self.anchors.bind if self.config.color else no_anchors

    def open_loop_calibration(self, *, sleep_speed: float = 0.0) -> Calibrate:
        """Return the paper's calibration; `sleep_speed` is as in `ClothConfig.solver` [m/s]."""
        config = self.search
        if config.method == "none":
            return Uncalibrated(self.pick)
        sizes = [len(values) for values in config.axes.values()]
        widest = min(BATCH, int(np.prod(sizes))) if config.method == "grid" else max(sizes)
        solver = self.config.cloth.solver(self.recording.table, sleep_speed=sleep_speed)
        score = OpenLoopScore(
            self.recording, self.mesh, solver, self.observe, self.visible, widest, self.device
        )
        return OpenLoopCalibration(self.pick, config, score)


@dataclass(frozen=True, eq=False)
class Assembled:
    """Method that is ready to run."""

    method: Method
    state: State
    theta: Theta


def default(components: Components) -> Assembled:
    """Return our method."""
    simulator = components.simulator(velocity_kept=0.0, prediction_coarseness=PREDICTION_COARSENESS)
    aligner = components.aligner("icp", icp_tolerance=_ICP_TOLERANCE)
    method = Method(
        observe=components.observe,
        calibrate=_tracking_calibration(components, simulator),
        dynamics=components.dynamics(simulator),
        align=aligner,
        line_search=PseudoActionSearch(SOFT),
        align_last=FinalAlignment(
            components.recording, components.mesh, aligner, simulator, device=components.device
        ),
        anchor=components.anchor,
        at_rest=PicturesAtRest(components.recording, components.observe),
    )
    state = aligned_first(components, method, simulator.solver.save())
    return Assembled(method, state, components.config.cloth.theta())


def paper(components: Components) -> Assembled:
    """Return the method as published, on our simulator."""
    simulator = components.simulator(velocity_kept=1.0, sleep_speed=FLEX_SLEEP_SPEED)
    aligner = components.aligner("adam", observed_only=False, uncrossed_only=False)
    method = Method(
        observe=components.observe,
        calibrate=components.open_loop_calibration(sleep_speed=FLEX_SLEEP_SPEED),
        dynamics=components.dynamics(simulator),
        align=aligner,
        line_search=PseudoActionSearch(HELD),
        align_last=FinalAlignment(
            components.recording, components.mesh, aligner, simulator,
            slide=False, untangle=False, rounds=1, roll_s=0.0, device=components.device,
        ),
        anchor=components.anchor,
        at_rest=never_at_rest,
    )  # fmt: skip
    return Assembled(method, simulator.solver.save(), components.config.cloth.theta(held_layers=0))


def open_loop(components: Components) -> Assembled:
    """Return the calibrated dynamics alone."""
    whole = paper(components)
    recording = components.recording
    ends = {action.last_frame for action in recording.actions}
    method = replace(
        whole.method,
        observe=only_at(ends, components.observe, recording),
        align=no_alignment,
        align_last=no_final_alignment,
    )
    return replace(whole, method=method)


METHODS: Mapping[str, Callable[[Components], Assembled]] = {
    "default": default,
    "paper": paper,
    "open_loop": open_loop,
}
"""The method of each mode (`tracking.configuration.MODES`)."""


def _tracking_calibration(components: Components, simulator: ClothDynamics) -> Calibrate:
    """Return the default's calibration; `search.method` may name the paper's."""
    search = components.search
    if search.method != "tracking":
        return components.open_loop_calibration()
    score = OutlineGap(components.recording, components.mesh, components.observe, components.device)
    mean = MeanOfCandidates(simulator, components.recording.name)
    return TrackingCalibration(components.pick, search, score, combine=mean)


def aligned_first(components: Components, method: Method, state: State) -> State:
    """Return the first state aligned to its cloud, if the cloud shows most of the cloth.

    The rest lengths stay those of the first mesh.
    """
    recording, positions = components.recording, state.positions[0]
    first = recording.frames[0]
    observation, start_s = components.observe(first), first.time_s
    visible = components.visible(positions)
    observed = visible & ~observation.unobservable(positions.astype(np.float64))
    # If the cloth lies below a cut, the cloud shows little of it and the rest would slide there.
    if observed.sum() < _MIN_OBSERVED * visible.sum():
        return state
    held = any(path.closed_at(start_s) for path in recording.picker_paths.values())
    # Use the default theta: a replay with a chosen theta must start from the same state.
    theta = RunConfig().cloth.theta()
    return method.align_last(state, theta, observation, held)[0]
