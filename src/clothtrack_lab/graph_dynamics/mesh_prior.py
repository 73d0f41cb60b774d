"""Prior knowledge of cloth motion that is not learned: tethers, contact, edges and table.

A step of the learned mesh dynamics (`mesh_network.advance`) ends with these corrections, so the
graph network only has to learn the remainder. Minutes of training do not teach it that edges keep
their length.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Springs:
    """The edges of a mesh, each in both directions.

    Attributes:
        rest: length in the flat garment [m].
        joined: matrix of the vertex pairs that share an edge or are the same.
        count: number of edges of each vertex, at least one.
        along: distance between each pair of vertices along the edges of the flat garment [m].
    """

    sender: Tensor
    receiver: Tensor
    rest: Tensor
    joined: Tensor
    count: Tensor
    along: Tensor

    @classmethod
    def of(cls, edges: Tensor, rest: Tensor, along: Tensor) -> "Springs":
        """Return springs with both directions of each edge (edges, 2), `rest` and `along` [m]."""
        vertices = len(along)
        sender = torch.cat([edges[:, 0], edges[:, 1]])
        receiver = torch.cat([edges[:, 1], edges[:, 0]])
        joined = torch.eye(vertices, dtype=torch.bool, device=edges.device)
        joined[sender, receiver] = True
        count = torch.bincount(receiver, minlength=vertices).clamp_min(1)
        return cls(sender, receiver, torch.cat([rest, rest]), joined, count, along)

    def to(self, device: str) -> "Springs":
        """Return a copy on a device."""
        return Springs(*(one.to(device) for one in vars(self).values()))


def nearer_to_rest(
    positions: Tensor, held: Tensor, springs: Springs, *, unfolding: float
) -> Tensor:
    """Return positions (B, V, 3) [m] with edges nearer to their rest lengths; held ones stay.

    Args:
        positions: vertices (B, V, 3) [m].
    """
    gap = positions[:, springs.sender] - positions[:, springs.receiver]
    length = gap.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    excess = length - springs.rest[:, None]
    excess = torch.where(excess > 0.0, excess, unfolding * excess)
    # Correct the whole excess if the other end is held, else half of it.
    share = torch.where(held[:, springs.sender], 1.0, 0.5)[..., None]
    pull = share * gap * (excess / length)
    total = torch.zeros_like(positions).index_add(1, springs.receiver, pull)
    # The mean of the edges' corrections is stable; 1.5 times the mean converges faster.
    moved = positions + 1.5 * total / springs.count[:, None]
    return torch.where(held[..., None], positions, moved)


def tethered(positions: Tensor, held: Tensor, springs: Springs) -> Tensor:
    """Return positions (B, V, 3) [m], at most as far from the held vertex as along the edges."""
    one = held.to(torch.uint8).argmax(dim=1)
    anchor = positions[torch.arange(len(one), device=one.device), one][:, None]
    gap = positions - anchor
    length = gap.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    share = (springs.along[one][..., None] / length).clamp_max(1.0)
    return torch.where(held.any(dim=1)[:, None, None], anchor + share * gap, positions)


def contacts(positions: Tensor, radius_m: float) -> Tensor:
    """Return which vertices (B, V, 3) [m] are within a radius, including themselves (B, V, V)."""
    here = positions.detach()
    return torch.cdist(here, here) < radius_m


def dragged(before: Tensor, after: Tensor, near: Tensor, held: Tensor, *, times: int) -> Tensor:
    """Return positions (B, V, 3) [m] after friction between layers in contact.

    Every vertex moves by the mean motion of the vertices near it, so a crumpled cloth moves as one
    clump.

    Args:
        before: vertices at the start of the step (B, V, 3) [m].
        after: vertices after the step without friction (B, V, 3) [m].
    """
    moved = after - before
    share = near.to(moved.dtype)
    share = share / share.sum(dim=2, keepdim=True)
    for _ in range(times):
        moved = torch.where(held[..., None], moved, share @ moved)
    return before + moved


def above(positions: Tensor, lowest_m: float) -> Tensor:
    """Return the vertices (B, V, 3) [m], raised to a least height."""
    height = positions[..., 2].clamp_min(lowest_m)
    return torch.cat([positions[..., :2], height[..., None]], dim=-1)
