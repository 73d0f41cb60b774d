"""States as batches of the token network: rendered, measured, cropped and labeled together.

A whole batch is made at once on the network's device, which may be any PyTorch device, without
Warp. The content of a batch is a function of the states, the seed and the step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from clothtrack.reconstruction.data.batch_draws import draw_scenes
from clothtrack.reconstruction.data.batch_pictures import Cloths, measure
from clothtrack.reconstruction.data.batch_rows import joined_rows, on_device, rows_of
from clothtrack.reconstruction.data.batch_view import above, on_mesh
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.tokens.token_network import EMPTY, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_stage import TokenBatch
from clothtrack.reconstruction.tokens.token_states import TokenStates
from clothtrack.reconstruction.training.batches import Draw

PIXELS = 192
"""Number of pixels per example with a correspondence. With 512 a step took 1.1 times as long."""

CUT = 0.05
"""A pixel farther from the mesh than this, over the garment's size, has no correspondence."""

TABLE_ERROR = 0.008
"""Standard deviation of the table's height, over the garment's size, since planes are fitted."""

SIZE_ERROR = 0.02
"""Relative standard deviation of the size that the network is given, for measurement errors."""

_SPARE = 1.25
"""Ratio of drawn pixels to needed pixels; some drawn ones have no correspondence."""

_PART_PIXELS = {"cpu": 200_000, "cuda": 8_000_000}
"""Number of depth pixels that are rendered together: what fits a CPU's cache, and enough to keep a
GPU busy. Pictures of similar size are grouped, because larger groups need wider margins."""


class TokenPictures:
    """States as batches of the token network.

    Args:
        network: sizes of the network that the pictures are for.
    """

    def __init__(
        self,
        states: TokenStates,
        network: TokenNetworkConfig,
        *,
        rendering: RenderConfig | None = None,
        device: str = "cpu",
        seed: int = 0,
    ) -> None:
        self.network = network
        self.rendering = rendering or RenderConfig()
        self.device = device
        self.seed = seed
        self._low, self._high = states.low, states.high
        self._states = on_device(states, device)
        self._most = {name: int(getattr(states, name).max()) for name in ("vertices", "faces")}
        self._part_pixels = _PART_PIXELS[device.split(":", maxsplit=1)[0]]

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self._low)

    def __getitem__(self, draw: Draw) -> Draw:
        """Return the draw itself, because a state is rendered with its batch."""
        return draw

    def rendered(self, draws: Sequence[Draw]) -> TokenBatch:
        """Render the states of a batch; equal draws give equal pictures."""
        chosen = torch.tensor([index for index, _ in draws])
        return self.batch(chosen, [number for draw in draws for number in draw])

    def batch(self, chosen: Int[Tensor, " batch"], step: Sequence[int]) -> TokenBatch:
        """Render some states, mirrored and turned at random.

        A state with too little measured cloth is replaced by another one of the batch.
        """
        seeds = np.random.SeedSequence([self.seed, *step]).generate_state(2, np.uint64)
        draws = Generator().manual_seed(int(seeds[0] >> 1))
        noise = Generator(self.device).manual_seed(int(seeds[1] >> 1))
        scenes = draw_scenes(self._low[chosen], self._high[chosen], self.rendering, draws)
        world = on_device(_Worlds.drawn(len(chosen), draws), self.device)
        garments = _Garments.of(self._states, chosen.to(self.device), self._most)
        scenes = on_device(scenes, self.device)
        cloths = Cloths.before(garments.positions, garments.faces, scenes)
        parts, order = [], []
        for part in cloths.parts(self._part_pixels):
            parts.append(
                self._seen(*(rows_of(one, part) for one in (cloths, garments, world)), noise)
            )
            order.append(part)
        back = torch.cat(order).argsort()
        return _batch(garments, world, rows_of(joined_rows(parts), back))

    def _seen(
        self, cloths: Cloths, garments: "_Garments", world: "_Worlds", noise: Generator
    ) -> "_Seen":
        """Return the network's input of some cloths, with the correspondences of its pixels."""
        measured = measure(cloths, noise)
        views = above(measured, world.motion, self.network)
        blocks, sources, shown = _drawn_pixels(
            views.depth, self.network.output_stride, int(_SPARE * PIXELS), noise
        )
        found = on_mesh(views.points(sources), measured)
        known = shown & (found.apart <= CUT * garments.size_m[:, None])
        # Pixels with a correspondence come first; if there are too few, they repeat.
        first = torch.sort(known.byte(), dim=1, descending=True, stable=True).indices
        turn = torch.arange(PIXELS, device=known.device) % known.sum(1, keepdim=True).clamp_(1)
        taken = first.gather(1, turn)[..., None]
        corners = found.corners.gather(1, taken.expand(-1, -1, 3)) + garments.first[:, None, None]
        weights = found.weights.gather(1, taken.expand(-1, -1, 3))
        shares = self._states.vertex_shares[corners] * weights[..., None]
        size_m = garments.size_m * world.size_factor
        table_m = garments.size_m * world.table_shift
        above_m = views.position[:, 2] - table_m
        height = (above_m[:, None, None] - views.depth) / size_m[:, None, None]
        return _Seen(
            height=height.masked_fill_(views.depth <= 0.0, EMPTY),
            distance=above_m / size_m,
            pixels=blocks.gather(1, taken.expand(-1, -1, 2)),
            pixel_tokens=self._states.vertex_tokens[corners].flatten(2),
            pixel_shares=shares.flatten(2),
            origin=torch.stack([views.position[:, 0], views.position[:, 1], table_m], 1),
            size_m=size_m,
            is_cloth=views.is_cloth & known.any(1),
        )


@dataclass(frozen=True, eq=False)
class _Worlds:
    """Transformation of each example's world before the network sees it.

    Attributes:
        motion: turn about the vertical, after mirroring if the example is mirrored.
        size_factor: size that the network is given, over the true size.
        table_shift: table height that the network is given, over the size.
    """

    motion: Float[Tensor, "batch 3 3"]
    mirrored: Bool[Tensor, " batch"]
    size_factor: Float[Tensor, " batch"]
    table_shift: Float[Tensor, " batch"]

    @classmethod
    def drawn(cls, count: int, draws: Generator) -> "_Worlds":
        """Draw random worlds."""
        mirrored = torch.rand(count, generator=draws) < 0.5
        angle = 2.0 * torch.pi * torch.rand(count, generator=draws)
        errors = torch.randn(2, count, generator=draws)
        cosine, sine, zero = angle.cos(), angle.sin(), torch.zeros(count)
        sign = 1.0 - 2.0 * mirrored.float()
        rows = [sign * cosine, -sine, zero, sign * sine, cosine, zero, zero, zero, zero + 1.0]
        motion = torch.stack(rows, 1).view(count, 3, 3)
        return cls(motion, mirrored, (SIZE_ERROR * errors[0]).exp(), TABLE_ERROR * errors[1])


@dataclass(frozen=True, eq=False)
class _Garments:
    """States of a batch, and the network's input of their garments.

    Attributes:
        positions: vertices in the world [m]; those of a smaller garment are repeated.
        faces: vertices of each face, by corner; padding faces have vertex 0.
        first: index of each garment's first vertex among all.
        features, token_corners, token_blend, labelings, is_labeling, mirror, neighbors, size_m,
            layers: as in `TokenStates`.
    """

    positions: Float[Tensor, "batch vertices 3"]
    faces: Int[Tensor, "batch 3 faces"]
    first: Int[Tensor, " batch"]
    features: Float[Tensor, "batch tokens features"]
    token_corners: Int[Tensor, "batch tokens 3"]
    token_blend: Float[Tensor, "batch tokens 3"]
    labelings: Int[Tensor, "batch labelings tokens"]
    is_labeling: Bool[Tensor, "batch labelings"]
    mirror: Int[Tensor, "batch tokens"]
    neighbors: Int[Tensor, "batch tokens neighbors"]
    size_m: Float[Tensor, " batch"]
    layers: Int[Tensor, " batch"]

    @classmethod
    def of(
        cls, states: TokenStates, chosen: Int[Tensor, " batch"], most: Mapping[str, int]
    ) -> "_Garments":
        """Return the chosen states with their garments."""
        garment, vertices, faces = states.garment[chosen], states.vertices, states.faces
        vertex = torch.arange(most["vertices"], device=chosen.device) % vertices[garment, None]
        positions = states.positions[states.first[chosen, None] + vertex]
        face = torch.arange(most["faces"], device=chosen.device).expand(len(chosen), -1)
        is_face = face < faces[garment, None]
        begin = (faces.cumsum(0) - faces)[garment, None]
        corners = states.corners[(begin + face).clamp_(max=len(states.corners) - 1)]
        corners = corners * is_face[..., None]
        return cls(
            positions=positions,
            faces=corners.transpose(1, 2).contiguous(),
            first=(vertices.cumsum(0) - vertices)[garment],
            **{name: getattr(states, name)[garment] for name in _OF_GARMENTS},
        )

    def places(self) -> Float[Tensor, "batch tokens 3"]:
        """Return the token positions in the world [m]."""
        batch = len(self.positions)
        index = self.token_corners.reshape(batch, -1, 1).expand(-1, -1, 3)
        at = self.positions.gather(1, index).view(*self.token_corners.shape, 3)
        return (at * self.token_blend[..., None]).sum(2)


_OF_GARMENTS = (
    "features", "token_corners", "token_blend", "labelings", "is_labeling", "mirror", "neighbors",
    "size_m", "layers",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Seen:
    """Observed part of the examples; lengths in units of the garment's size, but `origin` [m].

    Attributes:
        height, distance, pixels, pixel_tokens, pixel_shares, size_m: as in `TokenExample`, before
            tokens are mirrored.
        origin: origin of the picture's frame, in the transformed world.
        is_cloth: whether enough of the cloth was measured.
    """

    height: Float[Tensor, "batch size size"]
    distance: Float[Tensor, " batch"]
    pixels: Int[Tensor, "batch asked 2"]
    pixel_tokens: Int[Tensor, "batch asked named"]
    pixel_shares: Float[Tensor, "batch asked named"]
    origin: Float[Tensor, "batch 3"]
    size_m: Float[Tensor, " batch"]
    is_cloth: Bool[Tensor, " batch"]


def _drawn_pixels(
    depth: Float[Tensor, "batch size size"], stride: int, count: int, noise: Generator
) -> tuple[Int[Tensor, "batch drawn 2"], Int[Tensor, "batch drawn 2"], Bool[Tensor, "batch drawn"]]:
    """Draw random pixels of cloth (`view.py: cloth_pixels`).

    Args:
        depth: the network's pictures [m]; 0 where there is no cloth.
    """
    batch, size = depth.shape[:2]
    blocks = size // stride
    parts = depth.view(batch, blocks, stride, blocks, stride).transpose(2, 3)
    parts = parts.reshape(batch, blocks * blocks, stride * stride)
    nearest, within = torch.where(parts > 0.0, parts, torch.inf).min(2)
    is_cloth = torch.isfinite(nearest)
    order = torch.rand(nearest.shape, generator=noise, device=depth.device)
    drawn = torch.where(is_cloth, order, -1.0).topk(min(count, blocks * blocks)).indices
    within = within.gather(1, drawn)
    rows, columns = torch.div(drawn, blocks, rounding_mode="floor"), drawn % blocks
    pixels = torch.stack([rows, columns], 2)
    inner = torch.stack([torch.div(within, stride, rounding_mode="floor"), within % stride], 2)
    return pixels, pixels * stride + inner, is_cloth.gather(1, drawn)


def _batch(garments: _Garments, world: _Worlds, seen: _Seen) -> TokenBatch:
    """Return the batch that the network learns from."""
    count = len(seen.height)
    places = garments.places() @ world.motion.transpose(1, 2)
    places = (places - seen.origin[:, None]) / seen.size_m[:, None, None]
    # The mirror image of a garment is a garment of the same kind with mirrored tokens.
    same = torch.arange(garments.mirror.shape[1], device=places.device)
    name = torch.where(world.mirrored[:, None], garments.mirror, same)
    places = places.gather(1, name[..., None].expand(-1, -1, 3))
    tokens = name.gather(1, seen.pixel_tokens.flatten(1)).view_as(seen.pixel_tokens)
    batch = TokenBatch(
        height=seen.height,
        distance=seen.distance,
        features=garments.features,
        pixels=seen.pixels,
        pixel_tokens=tokens,
        pixel_shares=seen.pixel_shares,
        places=places,
        labelings=garments.labelings,
        is_labeling=garments.is_labeling,
        neighbors=garments.neighbors,
        conventional=_conventional(places, garments),
        size_m=seen.size_m,
        weight=seen.is_cloth.any().float().expand(count),
    )
    # Replace an example without cloth by the first one that has cloth.
    number = torch.arange(count, device=places.device)
    source = torch.where(seen.is_cloth, number, seen.is_cloth.byte().argmax())
    return rows_of(batch, source)


def _conventional(
    places: Float[Tensor, "batch tokens 3"], garments: _Garments
) -> Float[Tensor, "batch labelings"]:
    """Return how well each cloth's pose agrees with the flat garment's under each symmetry.

    A single sheet has its x to the right and its y up; a garment of two layers has its front above
    its back.
    """
    level = (garments.layers == 1).float()
    axes = torch.stack([level, level, 1.0 - level], 1)
    shown = (places - places.mean(1, keepdim=True)) * axes[:, None]
    lying = garments.features[:, :, :3].flatten(1)
    names = garments.labelings
    index = names[..., None] * 3 + torch.arange(3, device=names.device)
    lying = lying.gather(1, index.flatten(1)).view(*names.shape, 3)
    return (lying * shown[:, None]).sum((2, 3))
