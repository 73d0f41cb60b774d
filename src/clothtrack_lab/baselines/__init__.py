"""Baselines for comparison, which are not part of the method."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack_lab.baselines.coherent_point_drift import PeerConfig, drifted, follow
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = ["PeerConfig", "drifted", "follow"]
