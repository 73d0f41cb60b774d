"""Garments as meshes: outlines, templates from pictures, triangulation."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.garments.garment_meshes import garment, shirt, towel, trousers, tshirt
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = ["garment", "shirt", "towel", "trousers", "tshirt"]
