"""The mesh dynamics as the core finds them: by the entry point `mesh` of `clothtrack.dynamics`."""

from pathlib import Path

from clothtrack.planning.planning_dynamics import LearnedDynamics, PlanningDynamics

SHIPPED_WEIGHTS = Path(__file__).parent / "weights" / "mesh_dynamics.safetensors"
"""For every garment; they come with the package, with a card."""


def load(weights: Path, *, device: str = "cpu") -> PlanningDynamics:
    """Return the mesh dynamics of a file of weights; PyTorch is imported here and not before.

    Raises:
        InvalidResultError: the weights are missing, damaged or of something else.
    """
    from clothtrack_lab.graph_dynamics.mesh_dynamics import load_mesh_dynamics

    return load_mesh_dynamics(weights, device=device)


MESH_DYNAMICS = LearnedDynamics(load, SHIPPED_WEIGHTS, "learn")
"""Learned on roll-outs of our simulator."""
