"""theta: what is calibrated per action, four properties of the cloth and how the tool holds it."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.parameters import ClothParameters

OF_THE_CLOTH = ("stretch_compliance", "bend_compliance", "table_friction", "particle_friction")
GRASP_OFFSET = ("grasp_offset_x_m", "grasp_offset_y_m", "grasp_offset_z_m")

PARAMETERS = (*OF_THE_CLOTH, "held_layers", *GRASP_OFFSET)
"""Everything that can be calibrated, in the order of a candidate's columns."""

Theta = Mapping[str, float]
"""A value for each of PARAMETERS."""


BEND_SPACING_M = 0.008
"""Spacing of the vertices [m] at which theta's bend compliance is that of the solver's pairs."""


def cloth_parameters(theta: Theta, mesh: ClothMesh) -> ClothParameters:
    """The solver's share of theta, for a cloth with the spacing of this mesh.

    Two triangles of edge L that are bent to a curvature k move their far corners together by a
    length in proportion to L^3 k^2. The energy of a spring of compliance c between them, per area,
    is so in proportion to L^4 k^4 / c: the same cloth with a coarser mesh needs a compliance that
    grows with the fourth power of its spacing.
    """
    values = {name: float(theta[name]) for name in OF_THE_CLOTH}
    values["bend_compliance"] *= (float(mesh.edge_lengths.mean()) / BEND_SPACING_M) ** 4
    return ClothParameters(**values)


def grasp_offset(theta: Theta) -> Float[np.ndarray, " 3"]:
    """The tool's share: from where the tip was commanded to where it holds the cloth [m]."""
    return np.array([theta[name] for name in GRASP_OFFSET])


def check_parameter(name: str, value: float) -> None:
    """Refuse a value that the named one of PARAMETERS cannot take.

    Raises:
        InvalidConfigError: with the name, the value and what is allowed.
    """
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not number or not abs(value) < math.inf:
        raise InvalidConfigError(f"{name} is {value!r:.80}; it must be a finite number")
    if not name.startswith("grasp_offset") and value < 0.0:
        raise InvalidConfigError(f"{name} is {value}; it must be 0 or more")
    if name == "held_layers" and value != int(value):
        raise InvalidConfigError(
            f"held_layers is {value}; it must be a whole number (0: the nearest vertices, whatever "
            "layer they are of)"
        )
