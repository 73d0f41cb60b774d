"""What becomes of one depth picture: a mesh, how it came about, and how it agrees with the picture.

Every network answers in these terms (`design.Reconstructor`), so that what is shown, tracked and
measured is the same thing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float, Float32

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.mesh_distance import distance_to_mesh
from clothtrack.reconstruction.agreement import Agreement
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings.point_cloud import Observation, thin
from clothtrack.simulation.untangling import Untangling

if TYPE_CHECKING:
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.search import Choice

Method = Literal["template", "implicit"]
"""How a mesh is made: the garment's own mesh laid into the picture, or the surface of a predicted
field."""

_SPACING_M = 0.004
"""Side of the cubes [m] in which a picture's points are averaged, as the tracker does."""

LOOSE_FIT_M = 0.02
"""A mesh that is farther from its picture than this [m] is wrong: layers lie closer together."""

BOUND = 3.0
"""Of a vertex's error over what the network expects of it, nine of ten are below."""

_RUNNERS_UP = 3
"""Choices of the search that are reported after the best one."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What one depth picture became.

    Attributes:
        mesh: the garment in the world [m], canonical coordinates filled; None without one.
        status: "template", "surface", or why there is no mesh.
        camera: the virtual camera of the network's picture.
        canonical_image: canonical position [m] of each pixel of cloth; not a number elsewhere.
        confidence: of that position, the least sure axis, 0 to 1; 0 where no cloth is.
        seen: the measured points with their canonical positions.
        rest: the flat garment that was carried, vertex by vertex the mesh's; None for a surface.
    """

    mesh: ClothMesh | None
    status: str
    camera: Camera
    canonical_image: Float32[np.ndarray, "size size 3"]
    confidence: Float32[np.ndarray, "size size"]
    seen: SeenPoints
    rest: ClothMesh | None = None

    @property
    def mean_confidence(self) -> float:
        """Mean confidence where cloth is, 0 to 1; 0 where no pixel is."""
        known = self.confidence[self.confidence > 0]
        return float(known.mean()) if known.size else 0.0

    def scaled(self, factor: float) -> "Reconstruction":
        """The same in a world that is larger by a factor."""
        return Reconstruction(
            None if self.mesh is None else self.mesh.scaled(factor),
            self.status,
            self.camera.scaled(factor),
            self.canonical_image * np.float32(factor),
            self.confidence,
            self.seen.scaled(factor),
            None if self.rest is None else self.rest.scaled(factor),
        )


@dataclass(frozen=True, eq=False)
class Refinement:
    """What fine-tuning made of a mesh.

    Attributes:
        positions: vertices in the world [m]: of the start and all rounds, those nearest to the
            cloud.
        chamfer_m2: visible vertices against the cloud, both directions [m^2], at the start and
            after each round.
        chosen: whose positions these are; 0 is the start.
    """

    positions: Float[np.ndarray, "vertices 3"]
    chamfer_m2: tuple[float, ...]
    chosen: int


@dataclass(frozen=True, eq=False)
class NetworkMesh:
    """What became of one picture.

    Attributes:
        mesh: the garment in the world [m], canonical coordinates filled; None without one.
        reconstruction: the network's part: the mesh before fine-tuning, canonical picture, status.
        refinement: the fine-tuning; None when it was not asked for, or there was no mesh.
        scale: what the world was multiplied by before the network saw it; 1 unless the mesh of
            the picture as it is does not fit.
        expected_error_m: mean distance of the vertices from their true places that the network
            expects [m]; None from a network that does not say.
        spread_m: the same of each vertex [m].
        untangling: how the mesh was taken out of itself: crossings as the network's answer had them
            and at the end; None when it was not asked for, or the flat garment is not known.
        choices: garments that the token network was asked about and turns of the picture, best
            explanation first: the first is the one whose mesh this is; none of another network.
        opposite: computes the refined vertices [m] with the layers in the opposite order, which
            depth tells hardly; None of a mesh that is not refined, or of another network than the
            token network.
    """

    mesh: ClothMesh | None
    reconstruction: Reconstruction
    refinement: Refinement | None = None
    scale: float = 1.0
    expected_error_m: float | None = None
    spread_m: Float[np.ndarray, " vertices"] | None = None
    untangling: Untangling | None = None
    choices: "tuple[Choice, ...]" = ()
    opposite: Callable[[], Float[np.ndarray, "vertices 3"]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process is sent: it cannot compute the opposite order."""
        return {**self.__dict__, "opposite": None}

    @property
    def vertex_bounds_m(self) -> Float[np.ndarray, " vertices"] | None:
        """How far off each vertex is at most, in nine of ten cases [m].

        None from a network that does not say how far off it may be.
        """
        return None if self.spread_m is None else BOUND * self.spread_m


def observation_of(picture: "DepthInput") -> Observation:
    """The cloud of one picture, as the tracker's alignment takes it."""
    camera = picture.camera
    shown = picture.mask & (picture.depth_m > 0)
    return Observation(
        points=thin(camera.back_project(picture.depth_m, shown), _SPACING_M),
        cameras=(camera,),
        hidden={camera.name: picture.depth_m <= 0},
        lowest_height_m=None,
        tool_positions=np.zeros((0, 3)),
        tool_clearance_m=0.0,
    )


def distance_from_picture(mesh: ClothMesh, picture: "DepthInput") -> float:
    """Distance of the picture's points from the mesh, root of the mean square [m].

    It says that a mesh is wrong, never that it is right: what is hidden does not count, and names
    do not either.
    """
    return distance_from_cloud(mesh, observation_of(picture).points)


def distance_from_cloud(mesh: ClothMesh, points: Float[np.ndarray, "points 3"]) -> float:
    """Distance of points from the mesh, root of the mean square [m]."""
    vertices = mesh.vertices.astype(np.float64)
    return float(np.sqrt(np.square(distance_to_mesh(points, vertices, mesh.faces)).mean()))


def figures_of(
    result: NetworkMesh, mesh: ClothMesh, picture: "DepthInput", agreement: Agreement
) -> dict[str, Any]:
    """Return what is reported of a reconstruction, ready for JSON.

    Args:
        result: the reconstruction.
        mesh: its mesh.
        picture: what it was made from.
        agreement: of the mesh with the picture.
    """
    reconstruction, refinement = result.reconstruction, result.refinement
    chamfer_m2 = () if refinement is None else refinement.chamfer_m2
    return {
        "status": reconstruction.status,
        "cloud_to_mesh_m": distance_from_picture(mesh, picture),
        "scale": result.scale,
        "vertices": mesh.vertex_count,
        "confidence": reconstruction.mean_confidence,
        # Not a number where nothing of the mesh was seen, which JSON cannot say.
        "chamfer_m2": [None if np.isnan(value) else value for value in chamfer_m2],
        "silhouette_iou": agreement.iou,
        "visible_chamfer_m2": agreement.chamfer_m2,
        "expected_error_m": result.expected_error_m,
        "garment": _named(result.choices[:1]),
        "runners_up": _named(result.choices[1 : 1 + _RUNNERS_UP]),
    }


def _named(choices: "tuple[Choice, ...]") -> list[dict[str, Any]]:
    """Garments and turns of the picture that were tried, ready for JSON; less is a better score."""
    return [
        {
            "cut": one.cut,
            "size_m": list(one.size_m),
            "turn_deg": one.turn_deg,
            "score": one.explanation.score,
        }
        for one in choices
    ]
