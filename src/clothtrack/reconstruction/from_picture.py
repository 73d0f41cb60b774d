"""One depth picture to one mesh: the network's reconstruction and its test-time fine-tuning.

`clothtrack reconstruct`, the tracker's first mesh and the experiments all come through here, so
that what is shown, tracked and measured is the same thing.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.reconstruction.canonical_frame import conventional
from clothtrack.reconstruction.refinement import (
    VISIBILITY_TOLERANCE_M,
    Refinement,
    RefinementConfig,
    Refiner,
)
from clothtrack.reconstruction.template_fit import TemplateFitConfig
from clothtrack.reconstruction.trust import agreement_of, distrust
from clothtrack.recordings.point_cloud import Observation, thin
from clothtrack.recordings.recording import Table
from clothtrack.simulation.untangling import Untangling, untangled

if TYPE_CHECKING:
    from clothtrack.reconstruction.cuts import KnownGarment
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.model import MeshReconstructor, Method, Reconstruction
    from clothtrack.reconstruction.search import Choice
    from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor

SPACING_M = 0.004
"""Side of the cubes [m] in which a picture's points are averaged, as the tracker does."""

LOOSE_FIT_M = 0.02
"""A mesh that is farther from its picture than this [m] is wrong: layers lie closer together."""

OTHER_SIZES = (0.75, 0.55, 0.4, 1.35)
"""By what a garment that the network does not know so large, or so small, is multiplied."""


RUNNERS_UP = 3
"""Choices of the search that are reported after the best one."""

SEEN_MOBILITY = 0.1
"""Mobility of a vertex that is seen when a fine-tuned mesh is taken apart: what is seen is where it
was measured, and what is hidden was guessed."""


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
    """

    mesh: ClothMesh | None
    reconstruction: "Reconstruction"
    refinement: Refinement | None = None
    scale: float = 1.0
    expected_error_m: float | None = None
    spread_m: Float[np.ndarray, " vertices"] | None = None
    untangling: Untangling | None = None
    choices: "tuple[Choice, ...]" = ()


@dataclass(frozen=True, eq=False)
class _Answer:
    """What the published network makes of a picture.

    Attributes:
        reconstruction: its mesh.
        canonical: of the mesh's vertices, as the observed points are named; None without a mesh.
        scale: as in `NetworkMesh`.
    """

    reconstruction: "Reconstruction"
    canonical: Float[np.ndarray, "vertices 3"] | None
    scale: float = 1.0


def network_mesh(
    model: "MeshReconstructor | TokenReconstructor",
    picture: "DepthInput",
    kind: str,
    *,
    method: "Method" = "template",
    size_m: tuple[float, float] | None = None,
    template: ClothMesh | None = None,
    vertex_count: int = 1000,
    refinement: RefinementConfig | None = None,
    observation: Observation | None = None,
    untangle: bool = False,
    device: str = "cpu",
) -> NetworkMesh:
    """The full mesh behind a depth picture.

    Args:
        model: the network.
        picture: depth, mask, camera and table; world z up.
        kind: "towel" or "tshirt"; of the token network "trousers" too.
        method: "template" or "implicit" (`reconstruction.model: MeshReconstructor.reconstruct`);
            the token network knows the first one only.
        size_m: width and length of the garment when known [m]; else taken from the picture.
        template: the flat garment itself, canonical coordinates filled; instead of `size_m`.
        vertex_count: of a template that is made here, about.
        refinement: how to fine-tune the mesh; None leaves it as the network makes it.
        observation: what it is fine-tuned against; the picture's own points when None.
        untangle: take the mesh apart where it passes through itself, before it is fine-tuned and
            after; there what is seen moves little.
        device: of the fine-tuning; the networks compute where they are.

    Raises:
        InvalidConfigError: the networks are for another category, or make no mesh by this method.
        InvalidRecordingError: there is no cloth in the picture.
    """
    from clothtrack.reconstruction.cuts import KnownGarment, sized
    from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor

    if isinstance(model, TokenReconstructor):
        _require_template_method(method)
        known = None
        if template is not None:
            known = KnownGarment.of(template, device=device)
        elif size_m is not None:
            known = sized(kind, size_m, vertex_count, device=device)
        return _searched(
            model, picture, kind, known, vertex_count=vertex_count,
            finish=refinement is not None, device=device,
        )  # fmt: skip
    if template is None and size_m is not None and method == "template":
        template = garment(kind, vertex_count=vertex_count, size_m=size_m)
    answer = _by_published_network(
        model, picture, kind, template, method=method, vertex_count=vertex_count
    )
    reconstruction = answer.reconstruction
    result = NetworkMesh(reconstruction.mesh, reconstruction, scale=answer.scale)
    if reconstruction.mesh is None:
        return result
    if untangle:
        result = _taken_apart(result, picture, device)
    if refinement is not None:
        result = _fine_tuned(
            result, answer.canonical, observation or observation_of(picture), refinement,
            table=picture.table, device=device,
        )  # fmt: skip
        if untangle:
            result = _taken_apart(result, picture, device)
    return result


def _fine_tuned(
    result: NetworkMesh,
    canonical: Float[np.ndarray, "vertices 3"] | None,
    observation: Observation,
    refinement: RefinementConfig,
    *,
    table: Table | None,
    device: str,
) -> NetworkMesh:
    """The same, its mesh drawn to what was observed."""
    assert result.mesh is not None
    refiner = Refiner(
        replace(result.mesh, canonical=canonical),
        observation,
        refinement,
        rest=result.reconstruction.rest,
        table=table,
        device=device,
    )
    refined = refiner.refine(result.reconstruction.seen)
    mesh = result.mesh.with_vertices(refined.positions)
    return replace(result, mesh=mesh, refinement=refined)


def _taken_apart(result: NetworkMesh, picture: "DepthInput", device: str) -> NetworkMesh:
    """The same without passages through itself, as far as they can be undone."""
    mesh, rest = result.mesh, result.reconstruction.rest
    if mesh is None or rest is None:
        return result
    mobility = None
    if result.refinement is not None:
        camera = picture.camera.resized(RefinementConfig().visibility_width)
        visible = VisibilityCheck(
            mesh.faces, (camera,), tolerance_m=VISIBILITY_TOLERANCE_M, device=device
        )(mesh.vertices.astype(np.float64))
        mobility = np.where(visible, SEEN_MOBILITY, 1.0)
    apart = untangled(rest, mesh.vertices, mobility=mobility, table=picture.table, device=device)
    first = result.untangling or apart
    apart = replace(apart, crossings_before=first.crossings_before)
    return replace(result, mesh=mesh.with_vertices(apart.positions), untangling=apart)


def _require_template_method(method: str) -> None:
    if method != "template":
        raise InvalidConfigError(
            f"the token network makes no mesh by method {method!r}; take 'template', or name "
            "weights of the published network, which knows towels and T-shirts only"
        )


def _searched(
    model: "TokenReconstructor",
    picture: "DepthInput",
    kind: str,
    known: "KnownGarment | None",
    *,
    vertex_count: int,
    finish: bool,
    device: str,
) -> NetworkMesh:
    """The mesh of the token network's answer that explains the picture best."""
    from clothtrack.reconstruction.finished_fit import finished
    from clothtrack.reconstruction.model import Reconstruction
    from clothtrack.reconstruction.search import Search

    search = Search(model, picture, device=device)
    if known is None:
        best = search.best(kind, None, vertex_count=vertex_count)
    else:
        best = search.known(known)
    rest, answer, vertices, untangling = best.garment.mesh, best.answer, best.vertices, None
    if finish:
        untangling = finished(
            best.garment.fit, answer.guide, search.cloth, table=picture.table, device=device
        )
        vertices = untangling.positions
    mesh = rest.with_vertices(vertices)
    size = model.config.output_size
    canonical = np.full((size, size, 3), np.nan, np.float32)
    confidence = np.zeros((size, size), np.float32)
    rows, columns = answer.pixels.T
    canonical[rows, columns], confidence[rows, columns] = (
        answer.seen.canonical,
        answer.seen.confidence,
    )
    spread_m = answer.guide.spread_m
    return NetworkMesh(
        mesh,
        Reconstruction(
            mesh, "template", answer.view.camera, canonical, confidence, answer.seen, rest=rest
        ),
        expected_error_m=float(np.mean(spread_m)),
        spread_m=spread_m,
        untangling=untangling,
        choices=search.choices,
    )


def _by_published_network(
    model: "MeshReconstructor",
    picture: "DepthInput",
    kind: str,
    template: ClothMesh | None,
    *,
    method: "Method",
    vertex_count: int,
) -> _Answer:
    """Canonical coordinates, then completion; at other sizes where the picture does not fit."""

    def seen_as(scale: float) -> "Reconstruction":
        shown = picture.scaled(scale)
        (result,) = model.reconstruct(
            [shown.depth_m],
            shown.camera,
            kind,
            masks=[shown.mask],
            method=method,
            template=None if template is None else template.scaled(scale),
            table=shown.table,
            fit=TemplateFitConfig(vertex_count=vertex_count),
        )
        return result.scaled(1.0 / scale)

    reconstruction, scale = _best_size(seen_as, picture)
    mesh = reconstruction.mesh
    if mesh is None or mesh.canonical is None:
        return _Answer(reconstruction, None, scale)
    # Observed coordinates follow the convention of the networks, the garment's its own.
    return _Answer(reconstruction, conventional(mesh.canonical, kind), scale)


def _best_size(
    seen_as: "Callable[[float], Reconstruction]", picture: "DepthInput"
) -> "tuple[Reconstruction, float]":
    """The picture as it is; or, where that fits badly, at the size that fits best.

    The network knows garments of the sizes that it was trained on, and takes another for a crumpled
    one of its own. Folds look much alike at all sizes.
    """
    found = seen_as(1.0)
    if found.mesh is None or distance_from_picture(found.mesh, picture) <= LOOSE_FIT_M:
        return found, 1.0
    tried = [(found, 1.0), *((seen_as(scale), scale) for scale in OTHER_SIZES)]
    apart = [
        np.inf if one.mesh is None else distance_from_picture(one.mesh, picture) for one, _ in tried
    ]
    # Half as far, or else it is no other size but another bad guess.
    best = int(np.argmin(apart))
    return tried[best if apart[best] < 0.5 * apart[0] else 0]


def observation_of(picture: "DepthInput") -> Observation:
    """The cloud of one picture, as the tracker's alignment takes it."""
    camera = picture.camera
    shown = picture.mask & (picture.depth_m > 0)
    return Observation(
        points=thin(camera.back_project(picture.depth_m, shown), SPACING_M),
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


def figures_of(result: NetworkMesh, mesh: ClothMesh, picture: "DepthInput") -> dict[str, Any]:
    """What is reported of a reconstruction, ready for JSON.

    Args:
        result: the reconstruction.
        mesh: its mesh.
        picture: what it was made from.
    """
    reconstruction, refinement = result.reconstruction, result.refinement
    chamfer_m2 = () if refinement is None else refinement.chamfer_m2
    agreement = agreement_of(mesh, picture)
    reason = distrust(agreement, result.expected_error_m, mesh)
    return {
        "status": reconstruction.status,
        "cloud_to_mesh_m": distance_from_picture(mesh, picture),
        "scale": result.scale,
        "vertices": mesh.vertex_count,
        "confidence": float(reconstruction.confidence[reconstruction.confidence > 0].mean()),
        # Not a number where nothing of the mesh was seen, which JSON cannot say.
        "chamfer_m2": [None if np.isnan(value) else value for value in chamfer_m2],
        "silhouette_iou": agreement.iou,
        "visible_chamfer_m2": agreement.chamfer_m2,
        "expected_error_m": result.expected_error_m,
        "trusted": not reason,
        "why_not": reason,
        "garment": _named(result.choices[:1]),
        "runners_up": _named(result.choices[1 : 1 + RUNNERS_UP]),
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
