"""The graph network that predicts accelerations on a coarse mesh (VCD and MEDOR, our own code).

Inputs and sizes are those of the reference (method notes, Sec. 6.1). Rest lengths are those of the
flat garment, not of the first frame. A batch is dense: every cloth has the same mesh and differs
only in its positions.
"""

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor, nn

from clothtrack.files.bounds import Bounds, Checked, NotNegative, Positive, Share
from clothtrack_lab.graph_dynamics.mesh_prior import (
    Springs,
    above,
    contacts,
    dragged,
    nearer_to_rest,
    tethered,
)

# Weights files state the size of their network. The bounds keep a malicious one from using up all
# memory.
_Steps = Annotated[int, Bounds(least=1, most=64)]
_StepsOrNone = Annotated[int, Bounds(least=0, most=64)]


@dataclass(frozen=True)
class MeshNetworkConfig(Checked):
    """The sizes and units of the graph network.

    Attributes:
        width: width of all hidden layers and latents.
        message_steps: number of rounds of message passing.
        history: number of past velocities per vertex; the reference has 5 of 0.05 s.
        step_s: time step of the model [s]; with the reference's 0.05 planning takes four times as
            long.
        collision_radius_m: distance below which vertices that share no edge get a collision edge,
            recomputed in every step [m]; the reference has 0.036, VCD 0.045, with the same 0.025
            spacing.
        length_scale_m: divisor of lengths [m].
        velocity_scale: divisor of velocities [m/s].
        acceleration_scale: factor on the output [m/s^2].
        kept_velocity: share of its velocity that a vertex keeps without the network's output.
        gravity: acceleration of its fall then [m/s^2]; less than the earth's, because cloth floats.
        parts: number of parts of a step; the gripper moves in each, and the cloth follows.
        dragging: number of times per part that nearby vertices are dragged along (`dragged`).
        projections: number of projections of the edges towards their rest lengths per part
            (position-based dynamics, Jacobi). 0, with kept_velocity 1, gravity 0 and no dragging,
            leaves everything to the network, as in the reference; then minutes of training do not
            suffice.
        tethered: whether to limit each vertex's distance to the held one to that along the cloth
            (long range attachments, Kim et al. 2012, DOI 10.2312/SCA/SCA12/305-310). Messages and
            projections carry a pull only a few edges per step, but the gripper pulls the whole
            cloth along.
        unfolding: correction of edges that are too short, relative to that of edges that are too
            long; a fold shortens the edges across it.
    """

    width: Annotated[int, Bounds(least=1, most=1024)] = 128
    message_steps: _Steps = 10
    history: _Steps = 2
    step_s: Positive = 0.2
    collision_radius_m: Positive = 0.03
    length_scale_m: Positive = 0.025
    velocity_scale: Positive = 0.25
    acceleration_scale: Positive = 2.0
    kept_velocity: Share = 0.5
    gravity: NotNegative = 3.0
    parts: _Steps = 12
    dragging: _StepsOrNone = 2
    projections: _StepsOrNone = 5
    tethered: bool = True
    unfolding: Share = 1.0


@dataclass(frozen=True, eq=False)
class Ways:
    """The grasp of each cloth in a batch.

    Attributes:
        vertices: held vertex per cloth (B); -1 for none.
        places: its position after each step (B, steps, 3) [m].
        steps: number of steps until its release (B).
    """

    vertices: Tensor
    places: Tensor
    steps: Tensor


def mlp(inputs: int, width: int, outputs: int, *, zero_output: bool = False) -> nn.Sequential:
    """Return an MLP with two hidden layers; `zero_output` initializes the last layer to 0."""
    last = nn.Linear(width, outputs)
    if zero_output:
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
    return nn.Sequential(
        nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), last
    )


class _MessageStep(nn.Module):
    """One round of messages: vertices to edges, edges to vertices, vertices to the whole cloth."""

    def __init__(self, width: int) -> None:
        """Allocate layers; the edges' first layer is split to multiply each vertex only once."""
        super().__init__()
        self.of_edge = nn.Linear(width, width)
        self.of_sender = nn.Linear(width, width, bias=False)
        self.of_receiver = nn.Linear(width, width, bias=False)
        self.of_whole = nn.Linear(width, width, bias=False)
        # The residuals are initially zero, because deep sums over many edges would dominate the
        # input.
        self.edge = nn.Sequential(nn.ReLU(), *list(mlp(width, width, width, zero_output=True))[2:])
        self.node = mlp(3 * width, width, width, zero_output=True)
        self.whole = mlp(3 * width, width, width, zero_output=True)

    def forward(
        self, nodes: Tensor, edges: Tensor, whole: Tensor, links: tuple[Tensor, Tensor, Tensor]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return new latents of vertices (B * V), edges (E) and cloths (B)."""
        sender, receiver, cloth_of_edge = links
        cloths, width = whole.shape
        hidden = (
            self.of_edge(edges)
            + self.of_sender(nodes)[sender]
            + self.of_receiver(nodes)[receiver]
            + self.of_whole(whole)[cloth_of_edge]
        )
        edges = edges + self.edge(hidden)
        heard = torch.zeros_like(nodes).index_add(0, receiver, edges)
        per_cloth = nodes.shape[0] // cloths
        spread = whole.repeat_interleave(per_cloth, dim=0)
        nodes = nodes + self.node(torch.cat([nodes, heard, spread], dim=1))
        mean_nodes = nodes.reshape(cloths, per_cloth, width).mean(dim=1)
        mean_heard = heard.reshape(cloths, per_cloth, width).mean(dim=1)
        whole = whole + self.whole(torch.cat([whole, mean_nodes, mean_heard], dim=1))
        return nodes, edges, whole


class MeshNetwork(nn.Module):
    """A network for the vertex accelerations of many cloths with one mesh."""

    def __init__(self, config: MeshNetworkConfig) -> None:
        """Allocate the layers."""
        super().__init__()
        self.config = config
        width = config.width
        self.encode_node = mlp(3 * config.history + 3, width, width)
        self.encode_edge = mlp(7, width, width)
        self.steps = nn.ModuleList(_MessageStep(width) for _ in range(config.message_steps))
        # The untrained network predicts zero acceleration.
        self.decode = mlp(width, width, 3, zero_output=True)

    def forward(
        self,
        positions: Tensor,
        velocities: Tensor,
        height: Tensor,
        held: Tensor,
        near: Tensor,
        *,
        springs: Springs,
    ) -> Tensor:
        """Return accelerations (B, V, 3) [m/s^2].

        Args:
            positions: vertices (B, V, 3) [m].
            velocities: past velocities (B, V, history, 3), the latest last [m/s].
            height: height of the vertices above the table (B, V) [m].
        """
        config = self.config
        cloths, vertices, _ = positions.shape
        free = torch.stack([~held, held], dim=-1).to(positions.dtype)
        nodes = self.encode_node(
            torch.cat(
                [
                    velocities.flatten(2) / config.velocity_scale,
                    height[..., None] / config.length_scale_m,
                    free,
                ],
                dim=-1,
            ).reshape(cloths * vertices, -1)
        )
        sender, receiver, rest = self._edges(positions, near, springs)
        flat = positions.reshape(-1, 3)
        gap = flat[receiver] - flat[sender]
        length = gap.norm(dim=1, keepdim=True)
        is_mesh = (rest > 0.0).to(positions.dtype)[:, None]
        strain = (length - rest[:, None]) * is_mesh
        features = torch.cat(
            [torch.cat([gap, length, strain], 1) / config.length_scale_m, 1.0 - is_mesh, is_mesh],
            dim=1,
        )
        edges = self.encode_edge(features)
        whole = positions.new_zeros(cloths, config.width)
        links = sender, receiver, torch.div(receiver, vertices, rounding_mode="floor")
        for step in self.steps:
            nodes, edges, whole = step(nodes, edges, whole, links)
        return config.acceleration_scale * self.decode(nodes).reshape(cloths, vertices, 3)

    def _edges(
        self, positions: Tensor, near: Tensor, springs: Springs
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the mesh and collision edges of all cloths, as indices into B * V.

        The rest length of a collision edge is 0.
        """
        cloths, vertices, _ = positions.shape
        shift = vertices * torch.arange(cloths, device=positions.device)[:, None]
        cloth, first, second = (near & ~springs.joined).nonzero(as_tuple=True)
        sender = torch.cat([(springs.sender + shift).flatten(), first + vertices * cloth])
        receiver = torch.cat([(springs.receiver + shift).flatten(), second + vertices * cloth])
        rest = torch.cat([springs.rest.repeat(cloths), positions.new_zeros(len(cloth))])
        return sender, receiver, rest


def advance(
    network: MeshNetwork,
    positions: Tensor,
    velocities: Tensor,
    held: Tensor,
    springs: Springs,
    *,
    targets: Tensor,
    lowest_m: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Return the state after one semi-implicit Euler step, with held vertices at their targets.

    Args:
        positions: vertices (B, V, 3) [m].
        velocities: past velocities (B, V, history, 3) [m/s].
        targets: positions of held vertices after the step (B, V, 3) [m].
        lowest_m: least height of a vertex [m].
    """
    config, step_s = network.config, network.config.step_s
    near = contacts(positions, config.collision_radius_m)
    height = positions[..., 2] - lowest_m
    # The input includes the coming velocity of held vertices, not only their past ones.
    coming = torch.where(held[..., None], (targets - positions) / step_s, velocities[:, :, -1])
    text = torch.cat([velocities[:, :, :-1], coming[:, :, None]], dim=2)
    change = network(positions, text, height, held, near, springs=springs)
    down = positions.new_tensor([0.0, 0.0, -config.gravity])
    kept = config.kept_velocity * velocities[:, :, -1]
    after = above(positions + step_s * (kept + step_s * (change + down)), lowest_m)
    for part in range(1, config.parts + 1):
        on_the_way = positions + (targets - positions) * (part / config.parts)
        after = torch.where(held[..., None], on_the_way, after)
        if config.tethered:
            after = tethered(after, held, springs)
        after = dragged(positions, after, near, held, times=config.dragging)
        for _ in range(config.projections):
            after = nearer_to_rest(after, held, springs, unfolding=config.unfolding)
        after = above(after, lowest_m)
    latest = (after - positions) / step_s
    return after, torch.cat([velocities[:, :, 1:], latest[:, :, None]], dim=2)


def roll_out(
    network: MeshNetwork,
    positions: Tensor,
    springs: Springs,
    ways: Ways,
    *,
    steps: int,
    lowest_m: float = 0.0,
) -> Tensor:
    """Return the vertices after steps of the model from rest (B, V, 3) [m], without gradients.

    Args:
        positions: vertices at the start (B, V, 3) [m].
        lowest_m: least height of a vertex [m].
    """
    every = torch.arange(len(positions), device=positions.device)
    velocities = positions.new_zeros(*positions.shape[:2], network.config.history, 3)
    with torch.no_grad():
        for step in range(steps):
            held = torch.zeros(positions.shape[:2], dtype=torch.bool, device=positions.device)
            held[every, ways.vertices.clamp_min(0)] = (step < ways.steps) & (ways.vertices >= 0)
            targets = positions.clone()
            if step < ways.places.shape[1]:
                targets[every, ways.vertices.clamp_min(0)] = ways.places[:, step]
            positions, velocities = advance(
                network, positions, velocities, held, springs, targets=targets, lowest_m=lowest_m
            )
    return positions
