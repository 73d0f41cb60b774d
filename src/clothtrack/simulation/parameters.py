"""Material parameters of a cloth, and settings of the solver."""

import math
from dataclasses import dataclass
from typing import Annotated

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Bounds, Checked, NotNegative, Positive, Share
from clothtrack.recordings.recording import Table

ELASTIC_SUBSTEPS = 3
"""Elastic substeps per substep; stretch and bend are solved once in each. The sag of a hanging
cloth decreases with the square of their number."""

THICKNESS_M = 0.003
"""Default distance between layers [m]."""

RESTING_HEIGHT_M = 0.5 * THICKNESS_M
"""Height of the vertices of such a cloth at rest above the table [m]."""

SETTLE_IN_S = 1e-3
"""Duration [s] of the first step, in which contact stores the sides of a flat garment's layers."""

CONTACT_TOLERANCE = 0.15
"""Distance outside a triangle at which a vertex still touches it, in barycentric units."""


@dataclass(frozen=True)
class ClothParameters(Checked):
    """Material of one cloth, which a calibration searches; one value per environment.

    Attributes:
        stretch_compliance: inverse stiffness of an edge [m/N]; 0: the edge does not stretch.
        bend_compliance: inverse stiffness between the two vertices opposite each other across an
            edge [m/N].
    """

    stretch_compliance: NotNegative = 0.0
    bend_compliance: NotNegative = 10.0
    table_friction: NotNegative = 0.75
    particle_friction: NotNegative = 0.5


def _is_finite(value: object) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)


@dataclass(frozen=True, eq=False)
class SolverConfig(Checked):
    """Settings of the solver; they are the same for all environments.

    Attributes:
        thickness_m: distance between layers [m]; a vertex rests half of it above the table.
        substep_s: longest substep [s]; contacts and the table are solved once per substep.
        area_density: mass per area [kg/m^2].
        gravity: acceleration of the whole scene [m/s^2]; add a draft or a tilted camera here.
        damping: rate at which a free vertex loses speed to the air [1/s].
        sleep_speed: a vertex that recently touched something and is slower than this [m/s] does not
            move (FleX's sleep threshold, only for vertices that are supported and not pulled).
        speed_limit: highest speed of a vertex after a substep [m/s].
        table: the plane under the cloth, or None.
        rebuild_s: time between two searches for contact candidates [s].
        contact_margin_m: candidates are kept up to this far beyond the contact distance [m].
        contact_depth_m: deepest crossing that a contact can still undo [m].
        edge_contact: whether creased edges are also in contact with other edges.
        push_out_speed: highest speed at which a crossed layer is pushed back [m/s]; a layer that is
            still on its own side is kept there without a limit.
        bend_limit: share of the rest length below which a bend pair has no compliance.
        buckling: ratio of an edge's compliance in compression to that in tension. Real cloth
            buckles between the vertices of a coarse mesh; with 1 the edges act as struts. It
            multiplies the stretch compliance, so an edge that does not stretch is always a strut.
    """

    thickness_m: Positive = THICKNESS_M
    substep_s: Positive = 1.1e-3
    area_density: Positive = 0.2
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    damping: NotNegative = 1.0
    sleep_speed: NotNegative = 0.02
    speed_limit: Positive = 3.0
    table: Table | None = None
    rebuild_s: Positive = 0.01
    contact_margin_m: NotNegative = 0.0025
    contact_depth_m: Positive = 0.007
    edge_contact: bool = True
    push_out_speed: NotNegative = 0.6
    bend_limit: Share = 0.55
    buckling: Annotated[float, Bounds(least=1)] = 1.0

    def __post_init__(self) -> None:
        """Reject settings that cannot be computed.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        if len(self.gravity) != 3 or not all(map(_is_finite, self.gravity)):
            raise InvalidConfigError(
                f"solver.gravity is {self.gravity!s:.80}; it must be three finite numbers"
            )
        if self.contact_depth_m < self.thickness_m:
            raise InvalidConfigError(
                f"solver.contact_depth_m is {self.contact_depth_m}; it must be at least "
                f"thickness_m ({self.thickness_m})"
            )

    @property
    def resting_height_m(self) -> float:
        """Height of a vertex above the table when the cloth lies on it [m]."""
        return 0.5 * self.thickness_m
