"""Training examples of the published networks: a picture, its canonical labels, and the cloth.

Simulated states and pseudo-labels become examples by the same code and with the same augmentation.
The camera and the cloth are mirrored and rotated together about the vertical, so that picture,
canonical coordinates and points always agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from torch import Tensor

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count, Positive
from clothtrack.geometry.closest_point import interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture, faces_of_points
from clothtrack.reconstruction.data.view import cloth_pixels, crop, points_of
from clothtrack_lab.published_networks.canonical_frame import (
    canonical_frame,
    check_canonical,
    conventional,
)
from clothtrack_lab.published_networks.network_config import NetworkConfig
from clothtrack_lab.published_networks.winding import WindingConfig, WindingPool, winding_pool


@dataclass(frozen=True)
class ExampleConfig(Checked):
    """The configuration of drawing an example from a labeled picture.

    Attributes:
        surface_queries: number of material points per example whose position is a target, uniform
            over the cloth's area.
        volume_queries: number of points in the unit cube per example whose winding number is a
            target.
        cut_m: distance from the mesh beyond which a pixel has no canonical label [m].
        turn: whether to rotate camera and cloth about the vertical by any angle.
        mirror: whether to mirror camera and cloth, one time out of two.
        winding: points where winding numbers are known.
    """

    surface_queries: Count = 1024
    volume_queries: Count = 1024
    cut_m: Positive = 0.02
    turn: bool = True
    mirror: bool = True
    winding: WindingConfig = field(default_factory=WindingConfig)

    def __post_init__(self) -> None:
        """Refuse an impossible configuration.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        if self.volume_queries > self.winding.pool:
            raise InvalidConfigError(
                f"volume_queries is {self.volume_queries}, more than winding.pool "
                f"({self.winding.pool}); lower it"
            )


@dataclass(frozen=True, eq=False)
class Garment:
    """The common data of all states of one garment; a towel's longer side is along x.

    Attributes:
        unit: canonical coordinates of the vertices [unit cube].
        face_shares: share of each face in the area of the flat cloth.
        pool: winding numbers of the canonical pose.
    """

    kind: str
    faces: Int[np.ndarray, "faces 3"]
    unit: Float[np.ndarray, "vertices 3"]
    face_shares: Float[np.ndarray, " faces"]
    pool: WindingPool

    @classmethod
    def of(cls, mesh: ClothMesh, kind: str, config: WindingConfig, *, seed: int) -> "Garment":
        """Return the garment of a flat mesh.

        Args:
            mesh: mesh at rest, with canonical coordinates [m].
        """
        if mesh.canonical is None:
            raise InvalidConfigError(
                "the mesh has no canonical coordinates, so that nothing says which point is "
                "which; track with a template or first mesh that has them"
            )
        canonical = conventional(np.asarray(mesh.canonical, np.float64), kind)
        check_canonical(canonical, kind)
        unit = canonical_frame(kind).to_unit(canonical)
        corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(normals, axis=1)
        pool = winding_pool(unit, mesh.faces, config, seed=seed)
        return cls(kind, mesh.faces, unit, areas / areas.sum(), pool)


@dataclass(frozen=True, eq=False)
class Example:
    """One picture of one cloth, as the networks' input.

    Attributes:
        depth: network's picture [m]; 0 is background.
        pixels: row and column of each pixel of cloth, in the canonical picture.
        points: measured position of each pixel in the world [m].
        unit: its canonical coordinates [unit cube]; 0 where unknown.
        surface: canonical coordinates of material points [unit cube].
        positions: positions of these points in the world [m].
        winding: winding number of the canonical garment there.
    """

    depth: Float32[np.ndarray, "height width"]
    pixels: Int[np.ndarray, "pixels 2"]
    points: Float32[np.ndarray, "pixels 3"]
    unit: Float32[np.ndarray, "pixels 3"]
    labeled: Bool[np.ndarray, " pixels"]
    surface: Float32[np.ndarray, "surface 3"]
    positions: Float32[np.ndarray, "surface 3"]
    volume: Float32[np.ndarray, "volume 3"]
    winding: Float32[np.ndarray, " volume"]


def draw_example(
    picture: LabeledPicture,
    garment: Garment,
    network: NetworkConfig,
    config: ExampleConfig,
    rng: np.random.Generator,
) -> Example:
    """Augment a labeled picture, crop it for the network, and draw queries."""
    mirror = config.mirror and rng.random() < 0.5
    if mirror:
        picture = picture.mirrored()
    if config.turn:
        picture = picture.turned(rng.uniform(-np.pi, np.pi))
    view = crop(picture.depth_m, picture.mask, picture.camera, network)
    chosen = cloth_pixels(view.depth, network)
    points = points_of(view.depth, view.camera, chosen.sources)
    unit, labeled = _canonical_of_points(points, picture, garment, cut_m=config.cut_m)
    face = rng.choice(len(garment.faces), config.surface_queries, p=garment.face_shares)
    within = rng.dirichlet(np.ones(3), config.surface_queries)
    surface = interpolate(within, garment.unit[garment.faces[face]])
    positions = interpolate(within, picture.positions[garment.faces[face]])
    asked = rng.integers(len(garment.pool.points), size=config.volume_queries)
    volume = garment.pool.points[asked].copy()
    if mirror:
        # The mirror image of a garment is of the same kind, so mirror its labels too.
        for one in (unit, surface, volume):
            one[:, 0] = 1.0 - one[:, 0]
    unit[~labeled] = 0.0
    return Example(
        depth=view.depth,
        pixels=chosen.pixels,
        points=points.astype(np.float32),
        unit=unit.astype(np.float32),
        labeled=labeled,
        surface=surface.astype(np.float32),
        positions=positions.astype(np.float32),
        volume=volume,
        winding=garment.pool.values[asked],
    )


def _canonical_of_points(
    points: Float[np.ndarray, "points 3"],
    picture: LabeledPicture,
    garment: Garment,
    *,
    cut_m: float,
) -> tuple[Float[np.ndarray, "points 3"], Bool[np.ndarray, " points"]]:
    """Return canonical coordinates [unit cube] of measured points, by projection to the mesh.

    Args:
        points: points on the surface measured by the picture's pixels, in the world [m].
        cut_m: distance from the mesh beyond which points get none [m].
    """
    face, weights, near = faces_of_points(points, picture, garment.faces, cut_m=cut_m)
    unit = interpolate(weights, garment.unit[garment.faces[face]])
    return unit, near


@dataclass(frozen=True, eq=False)
class Batch:
    """A batch of concatenated examples.

    Attributes:
        depth: pictures [m].
        pixels: picture, row and column of every pixel of cloth.
        points: measured position of each pixel in the world [m].
        unit: its canonical coordinates [unit cube]; 0 where unknown.
        surface: canonical coordinates of material points [unit cube].
        positions: positions of these points in the world [m].
    """

    depth: Float[Tensor, "batch 1 height width"]
    pixels: Int[Tensor, "pixels 3"]
    points: Float[Tensor, "pixels 3"]
    unit: Float[Tensor, "pixels 3"]
    labeled: Bool[Tensor, " pixels"]
    surface: Float[Tensor, "batch surface 3"]
    positions: Float[Tensor, "batch surface 3"]
    volume: Float[Tensor, "batch volume 3"]
    winding: Float[Tensor, "batch volume"]

    def to(self, device: str) -> "Batch":
        """Return a copy on another device."""
        parts = {one.name: getattr(self, one.name).to(device) for one in fields(self)}
        return Batch(**parts)


def collate(examples: Sequence[Example]) -> Batch:
    """Return examples as one batch; every picture keeps its own number of pixels."""

    def stacked(name: str) -> Tensor:
        return torch.from_numpy(np.stack([getattr(one, name) for one in examples]))

    def joined(name: str) -> Tensor:
        return torch.from_numpy(np.concatenate([getattr(one, name) for one in examples]))

    numbers = [np.full((len(one.pixels), 1), index) for index, one in enumerate(examples)]
    pixels = torch.from_numpy(np.concatenate(numbers))
    return Batch(
        depth=stacked("depth")[:, None],
        pixels=torch.cat([pixels, joined("pixels")], dim=1),
        points=joined("points"),
        unit=joined("unit"),
        labeled=joined("labeled"),
        surface=stacked("surface"),
        positions=stacked("positions"),
        volume=stacked("volume"),
        winding=stacked("winding"),
    )
