"""What knows the truth, or is only compared with: simulated world, benchmark, baselines.

This package imports `clothtrack`, which does not import it.
"""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack_lab.flattening import flatten, simulate
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = ["flatten", "simulate"]
