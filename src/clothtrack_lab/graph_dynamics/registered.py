"""Registration of the mesh dynamics under the entry point `mesh` of `clothtrack.dynamics`."""

from pathlib import Path

from clothtrack.planning.planning_dynamics import LearnedDynamics, PlanningDynamics

SHIPPED_WEIGHTS = Path(__file__).parent / "weights" / "mesh_dynamics.safetensors"
"""Shipped weights for every garment, with a card."""


def load(weights: Path, *, device: str = "cpu") -> PlanningDynamics:
    """Return the mesh dynamics from a weights file; PyTorch is imported only here."""
    from clothtrack_lab.graph_dynamics.mesh_dynamics import load_mesh_dynamics

    return load_mesh_dynamics(weights, device=device)


MESH_DYNAMICS = LearnedDynamics(load, SHIPPED_WEIGHTS, "learn")
"""The dynamics learned on roll-outs of our simulator."""
