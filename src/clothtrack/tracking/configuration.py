"""The settings of a tracking run, and the named modes that the tables compare.

A setting is what a user changes or an experiment varies. Everything else is a constant next to the
code that uses it. How a mode changes the method itself is in `tracking/methods.py`.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count, NotNegative, Positive
from clothtrack.recordings.recording import Table
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.theta import PARAMETERS, Theta, check_parameter

ModeName = Literal["default", "paper", "open_loop"]

Source = Literal["auto", "template", "network", "flat"]
"""Possible sources of the first mesh."""


@dataclass(frozen=True)
class InitialStateConfig(Checked):
    """Source of the first mesh.

    Attributes:
        source: "template": the recording's template; "network": reconstructed from the first depth
            picture, even if there is a template; "flat": a flat garment fitted to the first
            cloud, even if there is a template; "auto": the template, else the flat fit if the
            cloth lies flat, else the network if there are weights for the garment.
        template: file with the flat mesh of this garment (`clothtrack garment`), which is fitted
            to the first cloud instead of a generic garment of the recording's kind, or is given to
            the network if the source is "network"; empty: none.
        weights: file with the network's weights; empty: those that come with the package, if any.
        vertex_count: approximate number of mesh vertices.
        refined: whether a network's mesh is fine-tuned to the first cloud.
    """

    source: Source = "auto"
    template: str = ""
    weights: str = ""
    vertex_count: Count = 1000
    refined: bool = True


@dataclass(frozen=True)
class ClothConfig(Checked):
    """Cloth parameters before any calibration, and settings of its simulation.

    Attributes:
        stretch_compliance: compliance of an edge in tension [m/N]; 0.02 is a knitted cloth. A cloth
            that cannot stretch cannot shear either, so it wrinkles where the true one lies flat.
        bend_compliance: compliance in bending [m/N], for a mesh with a spacing of 8 mm.
        table_friction: Coulomb coefficient of cloth on table.
        particle_friction: Coulomb coefficient of cloth on cloth.
        thickness_m: distance between layers [m]; a vertex rests half of it above the table.
        area_density: mass per area [kg/m^2].
        substep_s: longest substep [s].
    """

    stretch_compliance: NotNegative = 0.02
    bend_compliance: NotNegative = 1.0
    table_friction: NotNegative = 0.5
    particle_friction: NotNegative = 0.5
    thickness_m: Positive = 0.003
    area_density: Positive = 0.2
    substep_s: Positive = 1.1e-3

    def __post_init__(self) -> None:
        """Reject invalid values.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        for name, value in asdict(self).items():
            if name in PARAMETERS:
                check_parameter(name, value)

    def theta(self, *, held_layers: int = 1) -> Theta:
        """Return the parameters before any calibration."""
        return Theta(
            self.stretch_compliance, self.bend_compliance, self.table_friction,
            self.particle_friction, held_layers,
        )  # fmt: skip

    def solver(self, table: Table | None, *, sleep_speed: float = 0.0) -> SolverConfig:
        """Return the settings of the simulator.

        Args:
            table: the plane under the cloth, or None.
            sleep_speed: speed [m/s] below which supported vertices stand still. The default is 0,
                because slow cloth may still move far.
        """
        return SolverConfig(
            thickness_m=self.thickness_m, substep_s=self.substep_s, table=table,
            area_density=self.area_density, sleep_speed=sleep_speed,
        )  # fmt: skip


@dataclass(frozen=True)
class ObjectiveConfig(Checked):
    """Weights of the objective of both alignments; every term is a mean of squares [m^2].

    Attributes:
        rigidity_weight: difference of the displacements at the two ends of an edge (paper: 10).
        two_way_weight: distance of trusted visible vertices to the nearest cloud point (paper: 0).
        length_weight: stretch of edges relative to the first mesh (paper: 0).
        iterations: maximum solver steps: of Adam in the paper's modes, else of Gauss-Newton.
    """

    rigidity_weight: NotNegative = 10.0
    two_way_weight: NotNegative = 1.0
    length_weight: NotNegative = 300.0
    iterations: Count = 30


@dataclass(frozen=True)
class RunConfig(Checked):
    """All settings of a tracking run; they are stored with every result.

    Attributes:
        mode: "default", "paper" (the method as published), or "open_loop" (the calibrated dynamics
            alone).
        seed: stored with the result; tracking does not draw random numbers so far.
        cloud_spacing_m: clouds are thinned to one point per cube of this size [m]; 0 keeps all.
        color: follow points of the cloth in the color pictures and anchor the mesh to them.
        initial_state: source of the first mesh.
        cloth: the cloth before any calibration.
        search: calibration of each action.
        objective: objective of both alignments.
    """

    mode: ModeName = "default"
    seed: int = 0
    cloud_spacing_m: NotNegative = 0.004
    color: bool = True
    initial_state: InitialStateConfig = field(default_factory=InitialStateConfig)
    cloth: ClothConfig = field(default_factory=ClothConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)


PAPER_AXES: Mapping[str, tuple[float, ...]] = {
    "bend_compliance": (1e-2, 1.0, 100.0),
    "table_friction": (0.3, 1.0, 3.0),
    "particle_friction": (0.3, 1.0),
}
"""Search axes of the paper's modes: its stiffness and two frictions, with lower values added."""


def _as_published(name: ModeName) -> RunConfig:
    return RunConfig(
        mode=name,
        color=False,
        cloth=ClothConfig(stretch_compliance=0.0),
        search=SearchConfig(method="descent", axes=dict(PAPER_AXES)),
        objective=ObjectiveConfig(two_way_weight=0.0, length_weight=0.0, iterations=200),
    )


MODES: Mapping[str, RunConfig] = {
    "default": RunConfig(),
    "paper": _as_published("paper"),
    "open_loop": _as_published("open_loop"),
}
"""Our default, the paper's method, and the dynamics alone. `experiments/shared/ablations.py`
replaces functions for the paper's ablations."""


def mode(name: str) -> RunConfig:
    """Return the settings of a named mode.

    Raises:
        InvalidConfigError: the name is unknown; the message lists the known names.
    """
    if name not in MODES:
        raise InvalidConfigError(f"unknown mode {name!r}; there are {', '.join(MODES)}")
    return MODES[name]
