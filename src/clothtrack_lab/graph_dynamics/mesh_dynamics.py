"""Learned mesh dynamics with the planner's protocol; needs the extra [learn].

Importing this module imports PyTorch, which nothing else in planning does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.planning_dynamics import HeldPaths, MotionConfig, PlannedCloth
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack.simulation.parameters import RESTING_HEIGHT_M
from clothtrack_lab.graph_dynamics.mesh_network import (
    MeshNetwork,
    MeshNetworkConfig,
    Ways,
    roll_out,
)
from clothtrack_lab.graph_dynamics.mesh_prior import Springs
from clothtrack_lab.graph_dynamics.roll_outs import LEARNED_MESH


@dataclass(frozen=True)
class MeshDynamicsConfig:
    """The settings of predictions by the learned dynamics.

    Attributes:
        motion: motion of the tip; its time step is the model's.
        together: approximate number of candidates rolled out at once on a CPU, whose caches hold
            few; a GPU takes them all.
    """

    motion: MotionConfig = field(default_factory=lambda: MotionConfig(time_step_s=0.2))
    together: int = 10


class MeshDynamics:
    """The graph network as dynamics for a planner."""

    def __init__(
        self,
        network: MeshNetwork,
        config: MeshDynamicsConfig | None = None,
        *,
        device: str = "cpu",
    ) -> None:
        """Move the network to its device."""
        self.config = config or MeshDynamicsConfig()
        self.coarse = LEARNED_MESH
        if abs(self.config.motion.time_step_s - network.config.step_s) > 1e-9:
            raise InvalidConfigError(
                f"motion.time_step_s is {self.config.motion.time_step_s}, the network was trained "
                f"for {network.config.step_s}; set them equal"
            )
        self._network = network.to(device).eval()
        self._device = device
        self._mesh: ClothMesh | None = None
        self._springs: Springs | None = None

    def predict(
        self, cloth: PlannedCloth, actions: Sequence[PickPlace | None]
    ) -> Float[np.ndarray, "actions vertices 3"]:
        """Return the vertices [m] after each action and a rest.

        An action that grasps nothing leaves the cloth unchanged. These dynamics would let the cloth
        unfold on its own, and then doing nothing would have the highest predicted gain.
        """
        if not actions:
            return np.zeros((0, cloth.flat.vertex_count, 3))
        ends = np.repeat(self._placed(cloth)[None], len(actions), axis=0)
        held = HeldPaths.of(cloth, actions, self.config.motion)
        taken = np.flatnonzero(held.vertices >= 0)
        if len(taken):
            moved = held.of_candidates(taken)
            together = self.config.together if self._device == "cpu" else len(taken)
            for group in moved.batches(together):
                ends[taken[group]] = self._rolled(cloth, moved.of_candidates(group))
        return ends

    def _placed(self, cloth: PlannedCloth) -> np.ndarray:
        """Return the vertices [m], raised to the table's resting height where they are lower."""
        placed = np.array(cloth.positions, dtype=np.float64)
        lowest = cloth.table_height_m + RESTING_HEIGHT_M
        placed[:, 2] = np.maximum(placed[:, 2], lowest)
        return placed

    def _rolled(self, cloth: PlannedCloth, held: HeldPaths) -> np.ndarray:
        """Return the vertices [m] after some of the candidates."""
        config, device = self.config, self._device
        lowest = cloth.table_height_m + RESTING_HEIGHT_M
        start = torch.tensor(self._placed(cloth), dtype=torch.float32, device=device)
        ways = Ways(
            torch.tensor(held.vertices, device=device),
            torch.tensor(held.targets, dtype=torch.float32, device=device),
            torch.tensor(held.steps, device=device),
        )
        rest = math.ceil(config.motion.rest_s / config.motion.time_step_s)
        ends = roll_out(
            self._network,
            start.expand(len(ways.vertices), -1, -1).contiguous(),
            self._mesh_edges(cloth.flat),
            ways,
            steps=ways.places.shape[1] + rest,
            lowest_m=lowest,
        )
        return ends.cpu().numpy().astype(np.float64)

    def _mesh_edges(self, flat: ClothMesh) -> Springs:
        if self._springs is None or self._mesh is not flat:
            self._mesh, self._springs = flat, springs_of(flat).to(self._device)
        return self._springs


def springs_of(flat: ClothMesh) -> Springs:
    """Return the edges of a flat garment as the network's input."""
    edges, lengths = np.asarray(flat.edges), np.asarray(flat.edge_lengths, dtype=np.float64)
    graph = coo_matrix((lengths, edges.T), shape=(flat.vertex_count, flat.vertex_count))
    along = dijkstra(graph.tocsr(), directed=False)
    return Springs.of(
        torch.tensor(edges, dtype=torch.int64),
        torch.tensor(lengths, dtype=torch.float32),
        torch.tensor(along, dtype=torch.float32),
    )


def load_mesh_dynamics(path: Path, *, device: str = "cpu") -> MeshDynamics:
    """Return learned dynamics from a weights file; no code in it is executed."""
    weights = load_weights(path)
    known = {one.name for one in fields(MeshNetworkConfig)}
    if set(weights.network) != known:
        raise InvalidResultError(
            f"{path}: not weights of mesh dynamics; train some with clothtrack_lab.train_dynamics"
        )
    try:
        network = MeshNetwork(MeshNetworkConfig(**weights.network))
    except (InvalidConfigError, TypeError) as error:
        raise InvalidResultError(f"{path}: its sizes are damaged ({error})") from error
    weights.load_into(network)
    motion = MotionConfig(time_step_s=network.config.step_s)
    return MeshDynamics(network, MeshDynamicsConfig(motion=motion), device=device)
