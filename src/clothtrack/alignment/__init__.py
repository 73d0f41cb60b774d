"""Alignment of a mesh to a cloud: test-time optimization, nearest points, outlines."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.alignment.aligner import Alignment, AlignmentConfig, CloudAligner
    from clothtrack.alignment.nearest import Matcher, MovingGrid
    from clothtrack.alignment.silhouette import silhouette_gap, slide_to_outline
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "Alignment",
    "AlignmentConfig",
    "CloudAligner",
    "Matcher",
    "MovingGrid",
    "silhouette_gap",
    "slide_to_outline",
]
