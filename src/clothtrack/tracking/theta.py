"""theta: the parameters that are calibrated per action, of the cloth and of the grasp."""

import math
from dataclasses import dataclass, fields

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.parameters import ClothParameters

BEND_SPACING_M = 0.008
"""Vertex spacing [m] at which theta's bend compliance equals that of the solver's pairs."""


@dataclass(frozen=True)
class Theta:
    """Parameters of one action.

    Attributes:
        stretch_compliance: compliance of an edge in tension [m/N].
        bend_compliance: compliance of the cloth in bending [m/N], at `BEND_SPACING_M`.
        held_layers: number of layers the picker holds, counted from above; 0: the nearest
            vertices, whatever layer they belong to (the paper).
        grasp_offset_z_m: height of the grasp above the commanded tip [m].
    """

    stretch_compliance: float
    bend_compliance: float
    table_friction: float
    particle_friction: float
    held_layers: int
    grasp_offset_z_m: float = 0.0

    def cloth_parameters(self, mesh: ClothMesh) -> ClothParameters:
        """Return the solver's parameters for a cloth with the spacing of this mesh.

        When two triangles of edge length L are bent to a curvature k, the distance between their
        opposite corners shrinks by a length proportional to L^3 k^2. The energy per area of a
        spring of compliance c between them is proportional to L^4 k^4 / c. The compliance
        therefore scales with the fourth power of the mesh spacing.
        """
        bend = self.bend_compliance * (float(mesh.edge_lengths.mean()) / BEND_SPACING_M) ** 4
        return ClothParameters(
            stretch_compliance=self.stretch_compliance,
            bend_compliance=bend,
            table_friction=self.table_friction,
            particle_friction=self.particle_friction,
        )


PARAMETERS = tuple(field.name for field in fields(Theta))
"""Names of all parameters that can be calibrated."""


def check_parameter(name: str, value: float | int) -> None:
    """Reject a value that the named parameter cannot have."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not number or not abs(value) < math.inf:
        raise InvalidConfigError(f"{name} is {value!r:.80}; it must be a finite number")
    if name != "grasp_offset_z_m" and value < 0.0:
        raise InvalidConfigError(f"{name} is {value}; it must be 0 or more")
    if name == "held_layers" and value != int(value):
        raise InvalidConfigError(
            f"held_layers is {value}; it must be a whole number (0: the nearest vertices, whatever "
            "layer they are of)"
        )
