"""The whole configuration of a tracking run, and the named modes that the tables compare."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from clothtrack.alignment.aligner import AlignmentConfig
from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Bounds, Checked, Count, PositiveShare
from clothtrack.simulation.dynamics import DynamicsConfig
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.tracking.calibration import CalibrationConfig
from clothtrack.tracking.line_search import LineSearchConfig
from clothtrack.tracking.theta import PARAMETERS, check_parameter


def _default_parameters() -> dict[str, float]:
    return {
        # That of a knitted cloth, 60 N/m. One that cannot stretch cannot shear either: it wrinkles
        # across where the true one lies flat.
        "stretch_compliance": 0.02,
        "bend_compliance": 1.0,
        "table_friction": 0.5,
        "particle_friction": 0.5,
        "held_layers": 1.0,
        "grasp_offset_x_m": 0.0,
        "grasp_offset_y_m": 0.0,
        "grasp_offset_z_m": 0.0,
    }


def _calibration() -> CalibrationConfig:
    # Judged by tracking, a candidate costs a pass. Nearly half the actions need only one: the time
    # is better spent on more values and a second sweep for the others.
    axes = {
        # One, or all: a few pick-and-places make no pile of more than eight.
        "held_layers": (1.0, 8.0),
        "table_friction": (0.2, 0.5, 1.5),
        # A real T-shirt is stiffer than the cloth of the benchmark.
        "bend_compliance": (0.1, 1.0, 4.0),
        "particle_friction": (0.2, 0.5),
    }
    return CalibrationConfig(judge="tracking", axes=axes, sweeps=2, enough=0.03, clearly=0.1)


def _alignment() -> AlignmentConfig:
    # A prediction may be millimetres or a hand's breadth away: as many iterations as it takes.
    return AlignmentConfig(solver="icp", iterations=30, icp_tolerance=0.02)


def _dynamics() -> DynamicsConfig:
    # What is aligned need not be exact: what stands is rolled again.
    return DynamicsConfig(velocity_kept=0.0, prediction_coarseness=2)


@dataclass(frozen=True)
class FinalAlignmentConfig(Checked):
    """How TTO2 minimises the objective at the end of an action, and carries out what comes of it.

    Attributes:
        solver: "adam" or "icp".
        iterations: of the solver. Once per action it may take its time; what is left to correct may
            be far.
        slide: before, slide and turn a cloth that nobody holds on its table as a whole until its
            outline fits: nearest points alone hold a slipped cloth where it is.
        rounds: how often the alignment is computed and applied; each round starts from what the
            dynamics made of the last.
        roll_s: time over which the dynamics carry it out [s], as a soft pseudo-action from which
            the cloth is left at rest: short, so that gravity has no say, but layers keep their
            sides. 0 displaces the vertices at once, through whatever is in the way (the paper).
        untangle: take the cloth apart where it passes through itself, before and after.
    """

    solver: Literal["adam", "icp"] = "icp"
    iterations: Count = 30
    slide: bool = True
    rounds: Annotated[int, Bounds(least=1, most=100)] = 2
    roll_s: Annotated[float, Bounds(least=0, most=10)] = 0.1
    untangle: bool = True


@dataclass(frozen=True)
class TrackerConfig(Checked):
    """Everything that decides how a recording is tracked.

    Attributes:
        use_pseudo_action: correct the dynamics at every frame (paper: full method). Without it the
            dynamics run open loop inside an action ("No Pseudo Act").
        use_dynamics_initialisation: start the alignment from the dynamics' prediction; without it
            from the last mesh ("No Dyn Init").
        use_action: give the picker's motion to the dynamics, and calibrate ("No Act Cond").
        use_final_alignment: align once more at the end of an action ("No TTO2").
        align_first_mesh: align the first mesh to its cloud, as the mesh at the end of an action is
            (TTO2), before anything moves, where the cloud shows most of it; its rest lengths stay.
        average_candidates: where a search has tracked several candidates, go on from their mean,
            weighted by how well they fit, and not from the best one.
        attachment_strength: 1 holds the attached vertices at their targets ("held", the paper's
            pseudo-action); less pulls them there inside the solver loop ("soft"), so that
            contacts, stretch and table win over the observation.
        attach_observed_only: attach only vertices that the sensor could have contradicted; the
            paper attaches every visible vertex.
        attach_crossed: attach vertices, too, where the predicted cloth passes through itself; the
            paper does. Left free they sort themselves out: contact undoes a crossing, but not
            against a pull.
        score_frames: frames of an action at which calibration compares clouds, evenly spaced and
            ending with the last; 1 in the paper.
        parameters: cloth parameters and grasp offset before any calibration; the bend compliance is
            that of a mesh with a spacing of 8 mm (`tracking.theta.cloth_parameters`).
        calibration: what is searched per action.
        alignment: test-time optimisation at every frame (TTO1); its objective is TTO2's, too.
        final_alignment: how TTO2 differs.
        line_search: when a pseudo-action is too much.
        dynamics: how a frame is cut into simulator steps.
        solver: the cloth simulator. Nothing sleeps in the default: slow cloth has a way to go, too.
    """

    use_pseudo_action: bool = True
    use_dynamics_initialisation: bool = True
    use_action: bool = True
    use_final_alignment: bool = True
    align_first_mesh: bool = True
    average_candidates: bool = True
    attachment_strength: PositiveShare = 0.999
    attach_observed_only: bool = True
    attach_crossed: bool = False
    score_frames: Count = 3
    parameters: Mapping[str, float] = field(default_factory=_default_parameters)
    calibration: CalibrationConfig = field(default_factory=_calibration)
    alignment: AlignmentConfig = field(default_factory=_alignment)
    final_alignment: FinalAlignmentConfig = field(default_factory=FinalAlignmentConfig)
    line_search: LineSearchConfig = field(default_factory=LineSearchConfig)
    dynamics: DynamicsConfig = field(default_factory=_dynamics)
    solver: SolverConfig = field(default_factory=lambda: SolverConfig(sleep_speed=0.0))

    def __post_init__(self) -> None:
        """Refuse contradictions.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        missing = [name for name in PARAMETERS if name not in self.parameters]
        unknown = [name for name in self.parameters if name not in PARAMETERS]
        if missing or unknown:
            raise InvalidConfigError(
                f"parameters: missing {missing}, unknown {unknown}; known are {list(PARAMETERS)}"
            )
        for name, value in self.parameters.items():
            check_parameter(name, value)

    @property
    def uses_color(self) -> bool:
        """Whether points are followed from picture to picture."""
        return self.alignment.marks_weight > 0.0

    @property
    def last_alignment(self) -> AlignmentConfig:
        """What TTO2 minimises, and how."""
        last = self.final_alignment
        return replace(self.alignment, solver=last.solver, iterations=last.iterations)


_PAPER = TrackerConfig(
    parameters={
        **_default_parameters(),
        "stretch_compliance": 0.0,
        "held_layers": 0.0,
    },
    calibration=CalibrationConfig(),
    align_first_mesh=False,
    average_candidates=False,
    attachment_strength=1.0,
    attach_observed_only=False,
    attach_crossed=True,
    score_frames=1,
    dynamics=DynamicsConfig(velocity_kept=1.0),
    alignment=AlignmentConfig(two_way_weight=0.0, length_weight=0.0, marks_weight=0.0),
    final_alignment=FinalAlignmentConfig(
        solver="adam", iterations=200, slide=False, rounds=1, roll_s=0.0, untangle=False
    ),
    solver=SolverConfig(),
)

MODES: Mapping[str, TrackerConfig] = {
    "default": TrackerConfig(),
    "full_held_paper": _PAPER,
    "no_pseudo_action": replace(_PAPER, use_pseudo_action=False),
    "no_dynamics_initialisation": replace(_PAPER, use_dynamics_initialisation=False),
    "no_action_conditioning": replace(_PAPER, use_action=False),
    "no_final_alignment": replace(_PAPER, use_final_alignment=False),
    "open_loop": replace(_PAPER, use_pseudo_action=False, use_final_alignment=False),
}
"""Our default, the paper's method, the paper's four ablations, and the dynamics alone."""


def mode(name: str) -> TrackerConfig:
    """The configuration of a named mode.

    Raises:
        InvalidConfigError: with the names that exist.
    """
    if name not in MODES:
        raise InvalidConfigError(f"unknown mode {name!r}; there are {', '.join(MODES)}")
    return MODES[name]
