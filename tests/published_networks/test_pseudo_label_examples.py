"""Pseudo-labels as examples of the published network: of one kind, and where they lead."""

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording, projected_faces
from clothtrack_lab.published_networks.examples import ExampleConfig
from clothtrack_lab.published_networks.network_config import NetworkConfig
from clothtrack_lab.published_networks.state_examples import PseudoLabelExamples
from clothtrack_lab.published_networks.winding import WindingConfig

NETWORK = NetworkConfig()
CONFIG = ExampleConfig(surface_queries=2048, winding=WindingConfig(pool=2048))
POSE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.7], [0, 0, 0, 1]])
CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, POSE)
TOWEL = garment("towel", vertex_count=300, size_m=(0.2, 0.2))


def labeled():
    """Two pictures of a towel with their labels: flat, then its right half over its left one."""
    x, y, _ = np.asarray(TOWEL.vertices).T
    folded = np.column_stack([-np.abs(x), y, np.where(x > 0, 0.01, 0.004)])
    pictures = []
    flat = np.asarray(TOWEL.vertices) + (0.0, 0.0, 0.004)
    for positions in (flat, folded):
        drawn = Rasterizer(TOWEL.faces, CAMERA).render(positions)
        seen = drawn.faces >= 0
        depth = np.where(seen, drawn.depth, 0.7).astype(np.float32)
        shown = projected_faces(depth, seen, CAMERA, positions, TOWEL.faces, cut_m=0.02)
        pictures.append(LabeledPicture(depth, seen, CAMERA, shown, positions))
    return LabeledRecording("fold", "towel", TOWEL, (0, 1), tuple(pictures))


def test_labels_lead_from_pixels_to_the_tracked_material_point():
    examples = PseudoLabelExamples([labeled()], NETWORK, CONFIG)
    assert len(examples) == 2
    assert examples.groups == ["fold", "fold"]
    for index in range(2):
        example = examples[index, 3]
        known = example.labeled
        assert known.mean() > 0.95
        gaps = np.linalg.norm(example.unit[known][:, None] - example.surface[None], axis=2)
        way = np.linalg.norm(example.positions[gaps.argmin(axis=1)] - example.points[known], axis=1)
        assert np.median(way) < 0.006


def test_labels_of_two_kinds_are_refused():
    one = labeled()
    other = LabeledRecording("x", "tshirt", one.mesh, one.frames, one.pictures)
    with pytest.raises(InvalidResultError, match="towel, tshirt"):
        PseudoLabelExamples([one, other], NETWORK, CONFIG)
