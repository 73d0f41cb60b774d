"""Output of the canonicaliser for a batch of pictures, shared by training and inference.

Each pixel gets a canonical position, and each picture's points are rotated into the canonical
frame. This is the input of the completion.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from clothtrack.reconstruction.alignment_frame import Alignment, align
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack_lab.published_networks.canonical_frame import CanonicalFrame
from clothtrack_lab.published_networks.canonicalisation import Canonicaliser, coordinates
from clothtrack_lab.published_networks.completion import ObservedPoints


class ObservedPictures(NamedTuple):
    """The canonicaliser's output for a batch of pictures.

    Attributes:
        points: points of all pictures, as input of the completion.
        seen: points of each picture, in meters.
        alignments: transform of each picture between the world and the canonical frame.
    """

    points: ObservedPoints
    seen: list[SeenPoints]
    alignments: list[Alignment]


@torch.no_grad()
def observe_pictures(
    canonicaliser: Canonicaliser,
    frame: CanonicalFrame,
    depth: Float[Tensor, "batch 1 h w"],
    pixels: Int[Tensor, "pixels 3"],
    points: Float[np.ndarray, "pixels 3"],
) -> ObservedPictures:
    """Return canonical positions of chosen pixels, and each picture's alignment with the world.

    Args:
        depth: input pictures of the networks [m]; 0 is background.
        points: measured position of each pixel [m], world, z up.
    """
    maps = canonicaliser(depth)
    features = canonicaliser.pixel_features(maps, pixels)
    unit, confidence = coordinates(canonicaliser.logits(maps, pixels), canonicaliser.config.window)
    canonical = frame.to_meters(unit.double().cpu().numpy())
    sure = confidence.double().cpu().numpy().prod(axis=1)
    picture = pixels[:, 0].cpu().numpy()
    aligned = np.empty_like(points)
    seen, alignments = [], []
    for number in range(len(depth)):
        own = picture == number
        one = SeenPoints(points[own], canonical[own], sure[own])
        alignment = align(one.points, one.canonical, one.confidence)
        aligned[own] = alignment.to_canonical(one.points)
        seen.append(one)
        alignments.append(alignment)
    of_batch = ObservedPoints(
        features=features,
        unit=unit,
        confidence=confidence,
        aligned=torch.from_numpy(aligned).to(unit) * frame.scale,
        image=pixels[:, 0],
        images=len(depth),
    )
    return ObservedPictures(of_batch, seen, alignments)
