"""Configuration of flattening, and the identity of an episode."""

from dataclasses import asdict, dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import content_hash
from clothtrack.files.bounds import Bounds, Checked
from clothtrack.files.extras import install_command
from clothtrack.planning.perception import PerceptionConfig
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.planning_dynamics import (
    LearnedDynamics,
    PlanningDynamics,
    SimulatorConfig,
    SimulatorDynamics,
)
from clothtrack.reconstruction.availability import missing_modules, shipped_weights

Policy = Literal["planned", "random", "outwards", "heuristic"]


@dataclass(frozen=True)
class FlattenConfig(Checked):
    """Settings of a flattening episode.

    Attributes:
        policy: "planned"; or the name of a policy without any mesh
            (`clothtrack_lab.flattening`).
        perception: estimator of the cloth state.
        dynamics: "simulator", or "mesh" for the learned dynamics.
        dynamics_weights: file with the weights of the learned dynamics; "": the shipped weights.
        simulator: settings of the solver as dynamics.
        planner: settings of the planner.
        actions: largest number of actions in an episode (paper: 10).
    """

    policy: Policy = "planned"
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    dynamics: Literal["simulator", "mesh"] = "simulator"
    dynamics_weights: str = ""
    simulator: SimulatorConfig = field(default_factory=SimulatorConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    actions: Annotated[int, Bounds(least=1, most=1000)] = 10


def weights_used(config: FlattenConfig) -> dict[str, Path]:
    """Return the weights files that flattening reads, under "network" and "dynamics"."""
    used: dict[str, Path | None] = {}
    if config.policy == "planned" and config.perception.name != "truth":
        named = config.perception.weights
        used["network"] = Path(named) if named else shipped_weights()
    if config.policy == "planned" and config.dynamics == "mesh":
        used["dynamics"] = Path(config.dynamics_weights or _learned_dynamics("mesh").shipped)
    return {name: path for name, path in used.items() if path is not None}


def episode_identity(config: FlattenConfig) -> dict[str, Any]:
    """Return the identity of an episode; files enter by content hash, not by name."""
    settings = asdict(config)
    if config.perception.template:
        settings["perception"]["template"] = content_hash(Path(config.perception.template))
    del settings["perception"]["weights"], settings["dynamics_weights"]
    hashes = {name: content_hash(path) for name, path in weights_used(config).items()}
    return {"config": settings, "weights_sha256": hashes}


def _learned_dynamics(name: str) -> LearnedDynamics:
    """Return the learned dynamics that an installed package registers under a name."""
    for found in entry_points(group="clothtrack.dynamics", name=name):
        return found.load()
    raise InvalidConfigError(
        f"dynamics is {name}, and no installed package has them; install clothtrack again, or plan "
        "in the simulator"
    )


def dynamics_of(config: FlattenConfig, *, device: str = "cpu") -> PlanningDynamics:
    """Return the configured dynamics; only the learned ones import PyTorch."""
    if config.dynamics == "mesh":
        learned = _learned_dynamics("mesh")
        missing = missing_modules()
        if missing:
            raise InvalidConfigError(
                f"dynamics is mesh, which needs {', '.join(missing)}; install with: "
                f"{install_command(learned.extra)}, or plan in the simulator"
            )
        return learned.load(Path(config.dynamics_weights or learned.shipped), device=device)
    return SimulatorDynamics(config.simulator, device=device)
