"""One depth picture to one mesh: the network's reconstruction and its test-time fine-tuning.

`clothtrack reconstruct`, the tracker's first mesh and the experiments all come through here, so
that what is shown, tracked and measured is the same thing.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.alignment_frame import align
from clothtrack.reconstruction.canonical_frame import conventional
from clothtrack.reconstruction.template_fit import TemplateFitConfig
from clothtrack.recordings.point_cloud import Observation, thin
from clothtrack.recordings.recording import Table
from clothtrack.simulation.garments import garment
from clothtrack.tracking.refinement import Refinement, RefinementConfig, Refiner

if TYPE_CHECKING:
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.model import MeshReconstructor, Method, Reconstruction

SPACING_M = 0.004
"""Side of the cubes [m] in which a picture's points are averaged, as the tracker does."""


@dataclass(frozen=True, eq=False)
class NetworkMesh:
    """What became of one picture.

    Attributes:
        mesh: the garment in the world [m], canonical coordinates filled; None without one.
        reconstruction: the network's part: the mesh before fine-tuning, canonical picture, status.
        refinement: the fine-tuning; None when it was not asked for, or there was no mesh.
    """

    mesh: ClothMesh | None
    reconstruction: "Reconstruction"
    refinement: Refinement | None = None


def network_mesh(
    model: "MeshReconstructor",
    picture: "DepthInput",
    kind: str,
    *,
    method: "Method" = "template",
    size_m: tuple[float, float] | None = None,
    vertex_count: int = 1000,
    refinement: RefinementConfig | None = None,
    observation: Observation | None = None,
    device: str = "cpu",
) -> NetworkMesh:
    """The full mesh behind a depth picture.

    Args:
        model: the networks of the category.
        picture: depth, mask, camera and table; world z up.
        kind: "towel" or "tshirt".
        method: "template" or "implicit" (`reconstruction.model: MeshReconstructor.reconstruct`).
        size_m: width and length of the garment when known [m]; else taken from the picture.
        vertex_count: of a template, about.
        refinement: how to fine-tune the mesh; None leaves it as the network makes it.
        observation: what it is fine-tuned against; the picture's own points when None.
        device: of the fine-tuning; the networks compute where they are.

    Raises:
        InvalidConfigError: the networks are for another category.
        InvalidRecordingError: there is no cloth in the picture.
    """
    template = None
    if size_m is not None and method == "template":
        template = garment(kind, vertex_count=vertex_count, size_m=size_m)
    (found,) = model.reconstruct(
        [picture.depth_m],
        picture.camera,
        kind,
        masks=[picture.mask],
        method=method,
        template=template,
        table=picture.table,
        fit=TemplateFitConfig(vertex_count=vertex_count),
    )
    if found.mesh is None or refinement is None:
        return NetworkMesh(found.mesh, found)
    named = found.mesh
    if named.canonical is not None:
        # Observed coordinates follow the convention of the networks, the garment's its own.
        named = replace(named, canonical=conventional(named.canonical, kind))
    refiner = Refiner(
        named,
        observation or observation_of(picture),
        refinement,
        rest=found.rest,
        table=picture.table,
        device=device,
    )
    refined = refiner.refine(found.seen)
    return NetworkMesh(found.mesh.with_vertices(refined.positions), found, refined)


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


def laid_flat(
    rest: ClothMesh, positions: Float[np.ndarray, "vertices 3"], table: Table, height_m: float
) -> ClothMesh:
    """The flat garment on the table about where the cloth is: its rest shape in the world.

    Args:
        rest: the flat garment in its own frame [m].
        positions: where its vertices are in the world [m].
        table: horizontal.
        height_m: of its lowest vertices above the table [m].
    """
    flat = rest.vertices.astype(np.float64)
    placed = align(positions.astype(np.float64), flat, rest.vertex_areas).to_world(flat)
    placed[:, 2] += table.point[2] + height_m - placed[:, 2].min()
    return rest.with_vertices(placed)
