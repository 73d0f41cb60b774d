"""The two stages of training: canonicalisation of pixels, then completion of the cloth.

Which of a garment's symmetries is true cannot be seen (`first_mesh.symmetries`). Both stages use,
for each picture as a whole, the one that fits the canonicaliser's output. Errors are measured for
the symmetry as drawn, and up to symmetry, which is used for model selection.
"""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from clothtrack.reconstruction.alignment_frame import Alignment
from clothtrack.reconstruction.first_mesh import symmetries
from clothtrack.reconstruction.training.stage import Stage
from clothtrack_lab.published_networks.canonical_frame import (
    SHEETS,
    canonical_frame,
)
from clothtrack_lab.published_networks.canonicalisation import (
    Canonicaliser,
    canonical_loss,
    coordinates,
)
from clothtrack_lab.published_networks.completion import (
    RESIDUAL_M,
    Completion,
    ObservedPoints,
    WarpField,
    observe_pictures,
)
from clothtrack_lab.published_networks.examples import Batch
from clothtrack_lab.published_networks.network_config import NetworkConfig

_CLOSE = 0.05
"""Error below which a canonical coordinate counts as found [unit cube]."""


class CanonicalisationStage(Stage):
    """Stage 1: cross entropy of the bins, per picture the least over the symmetries."""

    name = "canonicalisation"
    # A network that predicts the mean of all poses minimizes the mean error but not the median.
    score = "median_error_mm"
    signs: Tensor

    def __init__(self, canonicaliser: Canonicaliser, kind: str) -> None:
        super().__init__()
        self.kind = kind
        self.network = canonicaliser.config
        self.canonicaliser = canonicaliser
        self.trained = nn.ModuleDict({"canonicaliser": canonicaliser})
        self.register_buffer("signs", _signs(kind), persistent=False)
        self._frame = canonical_frame(kind)

    def forward(self, batch: Batch) -> Mapping[str, Tensor]:
        """Return the loss [nat] of a batch, over the labeled pixels."""
        pixels, unit = batch.pixels[batch.labeled], batch.unit[batch.labeled]
        logits = self.canonicaliser.logits(self.canonicaliser(batch.depth), pixels)
        loss = canonical_loss(logits, unit, pixels[:, 0], self.signs, len(batch.depth))
        return {"loss": loss}

    def measure(self, batch: Batch) -> Mapping[str, Tensor]:
        """Return each picture's errors: median and mean [mm], share found; also as drawn."""
        pixels, unit = batch.pixels[batch.labeled], batch.unit[batch.labeled]
        logits = self.canonicaliser.logits(self.canonicaliser(batch.depth), pixels)
        found, _ = coordinates(logits, self.network.window)
        in_mm = 1e3 / self._frame.scale
        rows = []
        for image in range(len(batch.depth)):
            own = pixels[:, 0] == image
            errors = torch.stack(
                [(found[own] - _relabeled(unit[own], s)).norm(dim=1) for s in self.signs]
            )
            if errors.shape[1] == 0:
                # A picture without labels gets an error as large as the cube.
                errors = errors.new_ones(len(self.signs), 1)
            best = errors[errors.mean(dim=1).argmin()]
            rows.append(
                {
                    "median_error_mm": in_mm * best.median(),
                    "mean_error_mm": in_mm * best.mean(),
                    "median_error_as_drawn_mm": in_mm * errors[0].median(),
                    "mean_error_as_drawn_mm": in_mm * errors[0].mean(),
                    "share_found": (best < _CLOSE).float().mean(),
                }
            )
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}


class CompletionStage(Stage):
    """Stage 2: winding number and displacement of the whole garment, with frozen canonicalisation.

    The loss is the mean squared error of the winding number plus that of the displacement in units
    of `RESIDUAL_M`.

    Args:
        canonicaliser: trained and frozen network of stage 1.
    """

    name = "completion"
    score = "vertex_error_mm"
    signs: Tensor

    def __init__(
        self, canonicaliser: Canonicaliser, completion: Completion, warp: WarpField, kind: str
    ) -> None:
        super().__init__()
        self.kind = kind
        self.network = completion.config
        self.canonicaliser = canonicaliser.requires_grad_(requires_grad=False)
        self.completion, self.warp = completion, warp
        self.trained = nn.ModuleDict({"completion": completion, "warp": warp})
        self.register_buffer("signs", _signs(kind), persistent=False)
        self._frame = canonical_frame(kind)
        self._is_sheet = kind in SHEETS

    def train(self, mode: bool = True) -> "CompletionStage":
        """Set the mode, but keep the canonicaliser's statistics fixed."""
        super().train(mode)
        self.canonicaliser.eval()
        return self

    def forward(self, batch: Batch) -> Mapping[str, Tensor]:
        """Return the loss of a batch and its two parts."""
        seen, alignments = self._observed(batch)
        chosen = nearest_labeling(seen, batch, self.signs)
        volume = self.completion(seen)
        signs = self.signs[chosen][:, None]
        winding = batch.winding * (signs[..., 2] if self._is_sheet else 1.0)
        found = self.completion.winding(volume, _relabeled(batch.volume, signs))
        surface = _relabeled(batch.surface, signs)
        wanted = self._aligned_positions(batch, alignments) - self._meters(surface)
        moved = self.warp(volume, surface)
        of_winding = ((found - winding) ** 2).mean(dim=1)
        of_warp = (((moved - wanted) / RESIDUAL_M) ** 2).sum(dim=2).mean(dim=1)
        winding_loss, warp_loss = of_winding.mean(), of_warp.mean()
        return {
            "loss": winding_loss + warp_loss,
            "winding_loss": winding_loss,
            "warp_loss": warp_loss,
        }

    def measure(self, batch: Batch) -> Mapping[str, Tensor]:
        """Return the distance [mm] of material points to the truth, and the field's RMS error."""
        seen, alignments = self._observed(batch)
        volume = self.completion(seen)
        positions = self._aligned_positions(batch, alignments)
        errors, fields = [], []
        for signs in self.signs:
            surface = _relabeled(batch.surface, signs)
            moved = self._meters(surface) + self.warp(volume, surface)
            # Alignment is rigid, so distances in its frame equal those in the world.
            errors.append(1e3 * (moved - positions).norm(dim=2).mean(dim=1))
            winding = batch.winding * (signs[2] if self._is_sheet else 1.0)
            found = self.completion.winding(volume, _relabeled(batch.volume, signs))
            fields.append(((found - winding) ** 2).mean(dim=1).sqrt())
        table = torch.stack(errors)
        best = table.argmin(dim=0, keepdim=True)
        return {
            "vertex_error_mm": table.gather(0, best)[0],
            "vertex_error_as_drawn_mm": table[0],
            "winding_error": torch.stack(fields).gather(0, best)[0],
        }

    def _observed(self, batch: Batch) -> tuple[ObservedPoints, list[Alignment]]:
        """Return the visible points as input of the completion, and each picture's alignment."""
        observed = observe_pictures(
            self.canonicaliser,
            self._frame,
            batch.depth,
            batch.pixels,
            batch.points.double().cpu().numpy(),
        )
        return observed.points, observed.alignments

    def _aligned_positions(
        self, batch: Batch, alignments: list[Alignment]
    ) -> Float[Tensor, "batch surface 3"]:
        """Return the positions [m] of the material points in the frame of the observation."""
        placed = [
            alignment.to_canonical(positions)
            for alignment, positions in zip(
                alignments, batch.positions.double().cpu().numpy(), strict=True
            )
        ]
        return torch.from_numpy(np.stack(placed)).to(batch.positions)

    def _meters(self, unit: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 3"]:
        """Return positions in the unit cube as canonical positions [m]."""
        return (unit - 0.5) / self._frame.scale


def nearest_labeling(
    seen: ObservedPoints, batch: Batch, signs: Float[Tensor, "symmetries 3"]
) -> Int[Tensor, " batch"]:
    """Return, for each picture, the symmetry that the canonicaliser has chosen."""
    image, unit = seen.image[batch.labeled], batch.unit[batch.labeled]
    errors = []
    for one in signs:
        gaps = (seen.unit[batch.labeled] - _relabeled(unit, one)).norm(dim=1)
        errors.append(gaps.new_zeros(seen.images).index_add(0, image, gaps))
    return torch.stack(errors).argmin(dim=0)


def canonicalisation_stage(
    network: NetworkConfig, kind: str, *, seed: int = 0
) -> CanonicalisationStage:
    """Return stage 1 with fresh weights."""
    torch.manual_seed(seed)
    return CanonicalisationStage(Canonicaliser(network), kind)


def completion_stage(canonicaliser: Canonicaliser, kind: str, *, seed: int = 0) -> CompletionStage:
    """Return stage 2 with fresh weights after a trained canonicaliser."""
    torch.manual_seed(seed)
    network = canonicaliser.config
    completion = Completion(network, canonicaliser.channels)
    return CompletionStage(canonicaliser, completion, WarpField(network), kind)


def _relabeled(
    unit: Float[Tensor, "*points 3"], signs: Float[Tensor, "*#points 3"]
) -> Float[Tensor, "*points 3"]:
    return 0.5 + (unit - 0.5) * signs


def _signs(kind: str) -> Float[Tensor, "symmetries 3"]:
    return torch.from_numpy(symmetries(kind)).float()
