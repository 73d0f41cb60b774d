"""The result for one depth picture: a mesh, how it was made, and its agreement with the picture.

Every network returns these types (`design.Reconstructor`), so that display, tracking and evaluation
use the same data.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float, Float32

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.agreement import Agreement
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings.point_cloud import Observation, thin
from clothtrack.simulation.untangling import Untangling

if TYPE_CHECKING:
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.search import Choice

Method = Literal["template", "implicit"]
"""How a mesh is made: the garment's own mesh fitted to the picture, or the surface of a predicted
field."""

_SPACING_M = 0.004
"""Side of the cubes [m] in which a picture's points are averaged, as in the tracker."""

LOOSE_FIT_M = 0.02
"""A mesh farther from its picture than this [m] is wrong, because layers lie closer together."""

BOUND = 3.0
"""Ratio of actual to predicted vertex error that nine of ten vertices stay below."""

_RUNNERS_UP = 3
"""Number of search choices that are reported after the best one."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Reconstruction of one depth picture by a network.

    Attributes:
        mesh: the garment in the world [m], canonical coordinates filled; None if there is none.
        status: "template", "surface", or why there is no mesh.
        canonical_image: canonical position [m] of each pixel of cloth; NaN elsewhere.
        confidence: confidence of that position, of its least certain axis, 0 to 1; 0 where there is
            no cloth.
        seen: measured points with their canonical positions.
        rest: flat garment with the same vertices as the mesh; None for a surface.
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
        """Mean confidence over pixels of cloth, 0 to 1; 0 if there are none."""
        known = self.confidence[self.confidence > 0]
        return float(known.mean()) if known.size else 0.0

    def scaled(self, factor: float) -> "Reconstruction":
        """Return the same reconstruction in a world that is larger by a factor."""
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
    """Result of fine-tuning a mesh.

    Attributes:
        positions: vertices in the world [m], from the start or the round nearest to the cloud.
        chamfer_m2: Chamfer distance between visible vertices and the cloud, both directions [m^2],
            at the start and after each round.
        chosen: index of the round that the positions are from; 0 is the start.
    """

    positions: Float[np.ndarray, "vertices 3"]
    chamfer_m2: tuple[float, ...]
    chosen: int


@dataclass(frozen=True, eq=False)
class NetworkMesh:
    """Complete result for one picture.

    Attributes:
        mesh: the garment in the world [m], canonical coordinates filled; None if there is none.
        reconstruction: the network's part: the mesh before fine-tuning, canonical picture, status.
        refinement: the fine-tuning; None if it was not requested, or there was no mesh.
        scale: factor on the world before the network; 1 unless the mesh of the unscaled picture
            does not fit.
        expected_error_m: mean distance of the vertices from their true positions that the network
            predicts [m]; None if the network predicts none.
        spread_m: the same for each vertex [m].
        spread_over_turns: mean distance of the mesh from the answers in other turns of the picture,
            over the longer side (`search.Search.spread_over_turns`); None for other networks.
        untangling: removal of self-intersections, with the crossings of the network's answer and at
            the end; None if it was not requested, or the flat garment is not known.
        choices: garments and turns of the picture that the token network was queried with, best
            explanation first; the first one has this mesh. Empty for other networks.
        opposite: function that computes the refined vertices [m] with the layers in the opposite
            order, which depth can hardly distinguish; None if the mesh is not refined, or for
            networks other than the token network.
    """

    mesh: ClothMesh | None
    reconstruction: Reconstruction
    refinement: Refinement | None = None
    scale: float = 1.0
    expected_error_m: float | None = None
    spread_m: Float[np.ndarray, " vertices"] | None = None
    spread_over_turns: float | None = None
    untangling: Untangling | None = None
    choices: "tuple[Choice, ...]" = ()
    opposite: Callable[[], Float[np.ndarray, "vertices 3"]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without `opposite`, which other processes cannot compute."""
        return {**self.__dict__, "opposite": None}

    @property
    def vertex_bounds_m(self) -> Float[np.ndarray, " vertices"] | None:
        """Bound on the error of each vertex that holds in nine of ten cases [m].

        None if the network does not predict its error.
        """
        return None if self.spread_m is None else BOUND * self.spread_m


def observation_of(picture: "DepthInput") -> Observation:
    """Return the cloud of one picture, in the form that the tracker's alignment uses."""
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
    """Return the root mean square distance of the picture's points from the mesh [m].

    It can show that a mesh is wrong but never that it is right, because it ignores hidden cloth and
    correspondences.
    """
    return distance_from_cloud(mesh, observation_of(picture).points)


def distance_from_cloud(mesh: ClothMesh, points: Float[np.ndarray, "points 3"]) -> float:
    """Return the root mean square distance of points from the mesh [m]."""
    vertices = mesh.vertices.astype(np.float64)
    return float(np.sqrt(np.square(distance_to_mesh(points, vertices, mesh.faces)).mean()))


def figures_of(
    result: NetworkMesh, mesh: ClothMesh, picture: "DepthInput", agreement: Agreement
) -> dict[str, Any]:
    """Return the reported figures of a reconstruction, ready for JSON."""
    reconstruction, refinement = result.reconstruction, result.refinement
    chamfer_m2 = () if refinement is None else refinement.chamfer_m2
    return {
        "status": reconstruction.status,
        "cloud_to_mesh_m": distance_from_picture(mesh, picture),
        "scale": result.scale,
        "vertices": mesh.vertex_count,
        "confidence": reconstruction.mean_confidence,
        # NaN if nothing of the mesh was visible; JSON has no NaN.
        "chamfer_m2": [None if np.isnan(value) else value for value in chamfer_m2],
        "silhouette_iou": agreement.iou,
        "visible_chamfer_m2": agreement.chamfer_m2,
        "expected_error_m": result.expected_error_m,
        "spread_over_turns": result.spread_over_turns,
        "garment": _named(result.choices[:1]),
        "runners_up": _named(result.choices[1 : 1 + _RUNNERS_UP]),
    }


def _named(choices: "tuple[Choice, ...]") -> list[dict[str, Any]]:
    """Return garments and turns that were tried, ready for JSON; lower scores are better."""
    return [
        {
            "cut": one.cut,
            "size_m": list(one.size_m),
            "turn_deg": one.turn_deg,
            "score": one.explanation.score,
        }
        for one in choices
    ]
