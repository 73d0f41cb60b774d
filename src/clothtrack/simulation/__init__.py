"""dyn(x, a): position-based cloth on Warp, and the picker."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.simulation.dynamics import ClothDynamics, RollOut
    from clothtrack.simulation.parameters import ClothParameters, SolverConfig
    from clothtrack.simulation.pick_and_place import ActionConfig, PlannedAction, plan_action
    from clothtrack.simulation.picker_action import HeldMotion, PickerAction
    from clothtrack.simulation.solver import ClothSolver
    from clothtrack.simulation.state import Attachment, ClothState
    from clothtrack.simulation.untangling import Untangling, untangled
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "ActionConfig",
    "Attachment",
    "ClothDynamics",
    "ClothParameters",
    "ClothSolver",
    "ClothState",
    "HeldMotion",
    "PickerAction",
    "PlannedAction",
    "RollOut",
    "SolverConfig",
    "Untangling",
    "plan_action",
    "untangled",
]
