"""The lab: simulated world and benchmark, which may use the ground truth.

This package imports `clothtrack`, which does not import it.
"""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack_lab.api.dynamics import train_dynamics
    from clothtrack_lab.api.flattening import flatten_many
    from clothtrack_lab.api.simulation import simulate
    from clothtrack_lab.flattening import flatten
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "flatten",
    "flatten_many",
    "simulate",
    "train_dynamics",
]
