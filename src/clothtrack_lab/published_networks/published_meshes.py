"""Meshes from pictures by the published network at the best-fitting size, with fine-tuning."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidResultError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.from_picture import (
    LOOSE_FIT_M,
    Method,
    NetworkMesh,
    Reconstruction,
    distance_from_picture,
    observation_of,
)
from clothtrack.reconstruction.training.checkpoint import Weights
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Table
from clothtrack.simulation.untangling import untangled
from clothtrack_lab.published_networks.canonical_frame import conventional
from clothtrack_lab.published_networks.model import MeshReconstructor, network_of
from clothtrack_lab.published_networks.refinement import (
    VISIBILITY_TOLERANCE_M,
    VISIBILITY_WIDTH,
    RefinementConfig,
    Refiner,
)
from clothtrack_lab.published_networks.template_fit import TemplateFitConfig

_OTHER_SIZES = (0.75, 0.55, 0.4, 1.35)
"""Scale factors tried for garments larger or smaller than those that the network was trained on."""

SEEN_MOBILITY = 0.1
"""Mobility of a visible vertex while self-intersections of a fine-tuned mesh are resolved. Visible
vertices were measured, and hidden ones were guessed."""


class PublishedMeshes:
    """A reconstructor of meshes by a published network (`design.Reconstructor`).

    Attributes:
        states_error: false, because the network does not predict the error of its vertices.

    Args:
        refinement: configuration of fine-tuning a mesh to its picture.
    """

    states_error = False

    def __init__(
        self, network: MeshReconstructor, refinement: RefinementConfig | None = None
    ) -> None:
        self.network, self.refinement = network, refinement or RefinementConfig()

    @classmethod
    def load(cls, weights: Weights, kind: str, *, device: str = "cpu") -> "PublishedMeshes":
        """Return the reconstructor for weights that were read."""
        if weights.kind != kind:
            raise InvalidResultError(
                f"{weights.path} is for {weights.kind!r:.80}, the picture shows {kind!r}; give "
                f"weights for that, or --garment {weights.kind!s:.80} if it shows one"
            )
        model = MeshReconstructor(network_of(weights), kind)
        weights.load_into(model)
        return cls(model.to(device).eval())

    def mesh(
        self,
        picture: DepthInput,
        kind: str,
        *,
        method: Method = "template",
        size_m: tuple[float, float] | None = None,
        template: ClothMesh | None = None,
        vertex_count: int = 1000,
        refined: bool = False,
        untangle: bool = False,
        observation: Observation | None = None,
        device: str = "cpu",
    ) -> NetworkMesh:
        """Return the mesh from canonical coordinates, completion and warp field.

        Arguments and errors are those of `design.Reconstructor.mesh`. `device` is used for
        fine-tuning; the networks compute on their own device.
        """
        if template is None and size_m is not None and method == "template":
            template = garment(kind, vertex_count=vertex_count, size_m=size_m)
        answer = _answer(
            self.network, picture, kind, template, method=method, vertex_count=vertex_count
        )
        reconstruction = answer.reconstruction
        result = NetworkMesh(reconstruction.mesh, reconstruction, scale=answer.scale)
        if reconstruction.mesh is None:
            return result
        if untangle:
            result = _taken_apart(result, picture, device)
        if refined:
            result = _fine_tuned(
                result, answer.canonical, observation or observation_of(picture), self.refinement,
                table=picture.table, device=device,
            )  # fmt: skip
            if untangle:
                result = _taken_apart(result, picture, device)
        return result


@dataclass(frozen=True, eq=False)
class _Answer:
    """The published network's output for a picture.

    Attributes:
        canonical: canonical coordinates of the mesh's vertices, in the convention of the observed
            points; None without a mesh.
    """

    reconstruction: Reconstruction
    canonical: Float[np.ndarray, "vertices 3"] | None
    scale: float = 1.0


def _fine_tuned(
    result: NetworkMesh,
    canonical: Float[np.ndarray, "vertices 3"] | None,
    observation: Observation,
    refinement: RefinementConfig,
    *,
    table: Table | None,
    device: str,
) -> NetworkMesh:
    """Return the answer with its mesh fine-tuned to the observation."""
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


def _taken_apart(result: NetworkMesh, picture: DepthInput, device: str) -> NetworkMesh:
    """Return the mesh with self-intersections resolved as far as possible."""
    mesh, rest = result.mesh, result.reconstruction.rest
    if mesh is None or rest is None:
        return result
    mobility = None
    if result.refinement is not None:
        camera = picture.camera.resized(VISIBILITY_WIDTH)
        visible = VisibilityCheck(
            mesh.faces, (camera,), tolerance_m=VISIBILITY_TOLERANCE_M, device=device
        )(mesh.vertices.astype(np.float64))
        mobility = np.where(visible, SEEN_MOBILITY, 1.0)
    apart = untangled(rest, mesh.vertices, mobility=mobility, table=picture.table, device=device)
    first = result.untangling or apart
    apart = replace(apart, crossings_before=first.crossings_before)
    return replace(result, mesh=mesh.with_vertices(apart.positions), untangling=apart)


def _answer(
    model: MeshReconstructor,
    picture: DepthInput,
    kind: str,
    template: ClothMesh | None,
    *,
    method: Method,
    vertex_count: int,
) -> _Answer:
    """Return the network's mesh, trying other sizes if the picture does not fit."""

    def seen_as(scale: float) -> Reconstruction:
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
    # Observed coordinates follow the networks' convention; the garment's must be converted.
    return _Answer(reconstruction, conventional(mesh.canonical, kind), scale)


def _best_size(
    seen_as: Callable[[float], Reconstruction], picture: DepthInput
) -> tuple[Reconstruction, float]:
    """Return the mesh at the picture's scale, or, if that fits badly, at the best-fitting scale.

    The network takes a garment of a size that it was not trained on for a crumpled one of a size
    that it was. Folds look much alike at all sizes.
    """
    found = seen_as(1.0)
    if found.mesh is None or distance_from_picture(found.mesh, picture) <= LOOSE_FIT_M:
        return found, 1.0
    tried = [(found, 1.0), *((seen_as(scale), scale) for scale in _OTHER_SIZES)]
    apart = [
        np.inf if one.mesh is None else distance_from_picture(one.mesh, picture) for one, _ in tried
    ]
    # Require half the distance, because otherwise it is not another size but another bad fit.
    best = int(np.argmin(apart))
    return tried[best if apart[best] < 0.5 * apart[0] else 0]
