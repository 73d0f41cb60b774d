"""Other first meshes for a recording: coarser or finer, nearer to or farther from the truth."""

from dataclasses import replace

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.truth import Truth, material_map, material_points
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Recording


def resampled(recording: Recording, vertex_count: int) -> Recording:
    """Return the recording with its template drawn on another triangulation of the same garment.

    Every new vertex lies on the template's own surface, at the material point of its canonical
    coordinates: misplacement, scale and noise stay what they were, and no truth is asked.
    """
    template = _template(recording)
    cloth = recording.cloth
    fine = garment(cloth.kind, vertex_count=vertex_count, size_m=cloth.size_m)
    canonical = np.asarray(fine.canonical, np.float64)
    where = material_map(np.asarray(template.canonical, np.float64), template.faces, canonical)
    vertices = material_points(template.vertices.astype(np.float64), template.faces, where)
    return _with(recording, ClothMesh(vertices, fine.faces, canonical))


def with_first_mesh_error(recording: Recording, truth: Truth, factor: float) -> Recording:
    """Return the recording with its template this many times as far from the truth; 0 is the truth.

    This is a control, because it reads the truth. It measures the effect of a better or worse first
    mesh.
    """
    template = _template(recording)
    canonical = np.asarray(template.canonical, np.float64)
    where = material_map(truth.canonical, truth.faces, canonical)
    points = material_points(truth.positions[0], truth.faces, where)
    vertices = points + factor * (template.vertices - points)
    return _with(recording, ClothMesh(vertices, template.faces, canonical))


def _template(recording: Recording) -> ClothMesh:
    template = recording.cloth.template
    if template is None or template.canonical is None:
        raise InvalidConfigError(
            f"{recording.folder}: another first mesh needs a template with canonical coordinates"
        )
    return template


def _with(recording: Recording, mesh: ClothMesh) -> Recording:
    # Held vertices are named by number, and the numbers are other ones now.
    return replace(recording, cloth=replace(recording.cloth, template=mesh, held_vertices={}))
