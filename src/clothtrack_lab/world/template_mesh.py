"""The flat garment, its initial pose, and the first mesh given to a tracker.

That mesh has another triangulation than the world's cloth and is misplaced, mis-scaled and noisy,
like a first mesh measured by hand.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Bounds, Checked, Count
from clothtrack.garments.garment_meshes import GarmentKind, garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.template_file import read_template
from clothtrack_lab.world.flex import CONTACT_RADIUS_M

Error = Annotated[float, Bounds(least=0, most=1)]
"""Size of an error [m]."""


@dataclass(frozen=True)
class TemplateConfig(Checked):
    """The first mesh of a recording, and its errors.

    Attributes:
        vertex_count: approximate number of vertices.
        shift_m: length of its displacement in the table's plane [m].
        turn_deg: standard deviation of its rotation about the vertical [deg].
        scale: standard deviation of its relative size error.
        noise_m: standard deviation of independent noise of each vertex along x and along y [m].
    """

    vertex_count: Count = 1500
    shift_m: Error = 0.002
    turn_deg: Annotated[float, Bounds(least=0, most=180)] = 0.6
    scale: Annotated[float, Bounds(least=0, most=0.2)] = 0.005
    noise_m: Error = 0.0005


@runtime_checkable
class GivenGarment(Protocol):
    """A garment that does not depend on the seed of the recording (`world.one_garment`)."""

    @property
    def label(self) -> str:
        """Prefix of the names of its recordings."""
        ...

    @property
    def seed(self) -> int:
        """Seed that it is drawn from."""
        ...

    def flat(self, *, vertex_count: int, again: bool = False) -> ClothMesh:
        """Return the garment at rest, around the origin; `again` in another triangulation."""
        ...


@dataclass(frozen=True)
class SeededGarment:
    """The garment of one recording or episode, with a usual cut or from a template file.

    Attributes:
        file: file of the template (`clothtrack garment`), which has its own size; empty for none.
        size_m: width and length [m]; the usual size of its kind when None.
    """

    kind: GarmentKind
    file: str
    size_m: tuple[float, float] | None
    seed: int

    @property
    def label(self) -> str:
        """Prefix of the names of its recordings."""
        return self.kind

    def flat(self, *, vertex_count: int, again: bool = False) -> ClothMesh:
        """Return the garment at rest, around the origin; `again` in another triangulation."""
        if not self.file:
            return garment(
                self.kind, vertex_count=vertex_count, size_m=self.size_m,
                pattern="alternating" if again else "random", seed=2 * self.seed + again,
            )  # fmt: skip
        mesh = read_template(Path(self.file))
        if mesh.canonical is None:
            raise InvalidConfigError(
                f"{self.file}: it has no canonical coordinates; make it with: clothtrack garment"
            )
        found = "tshirt" if np.ptp(np.asarray(mesh.canonical)[:, 2]) > 0.0 else "towel"
        if found != self.kind:
            layers = "two layers" if found == "tshirt" else "one layer"
            raise InvalidConfigError(
                f"{self.file}: the template has {layers}, and the garment is {self.kind!r}; say "
                f"{found!r}"
            )
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        return mesh.with_vertices(mesh.vertices - 0.5 * (low + high) * (1.0, 1.0, 0.0))


def size_of(flat: ClothMesh) -> tuple[float, float]:
    """Return the width and length of a flat garment [m]."""
    width, length = np.ptp(flat.vertices[:, :2], axis=0)
    return float(width), float(length)


def random_pose(rng: np.random.Generator) -> Float[np.ndarray, "2 3"]:
    """Return a random rotation about the vertical and position [m] near the picture's middle."""
    angle = np.radians(rng.uniform(-12.0, 12.0))
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = rng.uniform(-0.02, 0.02, 2)
    return np.array([[cosine, -sine, x], [sine, cosine, y]])


def laid_down(
    mesh: ClothMesh, pose: Float[np.ndarray, "2 3"], height_m: float = CONTACT_RADIUS_M
) -> ClothMesh:
    """Return the flat garment at rest on the table, with its lowest vertex at this height [m]."""
    vertices = np.empty(mesh.vertices.shape)
    vertices[:, :2] = mesh.vertices[:, :2] @ pose[:, :2].T + pose[:, 2]
    vertices[:, 2] = mesh.vertices[:, 2] - mesh.vertices[:, 2].min() + height_m
    return mesh.with_vertices(vertices)


def misjudged(
    mesh: ClothMesh,
    wrong: TemplateConfig,
    *,
    laid: Callable[[ClothMesh], ClothMesh],
    rng: np.random.Generator,
) -> ClothMesh:
    """Return the tracker's first mesh: a flat garment on the table with these errors."""
    vertices = laid(mesh).vertices
    angle = np.radians(wrong.turn_deg) * rng.standard_normal()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    scale = 1.0 + wrong.scale * rng.standard_normal()
    heading = rng.uniform(0.0, 2.0 * np.pi)
    shift = wrong.shift_m * np.array([np.cos(heading), np.sin(heading)])
    middle = vertices[:, :2].mean(axis=0)
    noise = wrong.noise_m * rng.standard_normal((len(vertices), 2))
    vertices[:, :2] = scale * (vertices[:, :2] - middle) @ turn.T + middle + shift + noise
    return mesh.with_vertices(vertices)
