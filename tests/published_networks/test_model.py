from dataclasses import replace

import numpy as np
import pytest
import torch

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import edge_strain
from clothtrack.reconstruction.data.view import crop
from clothtrack_lab.published_networks.model import MeshReconstructor
from clothtrack_lab.published_networks.network_config import preset

SMALL = preset("small")


@pytest.fixture(scope="module")
def untrained():
    torch.manual_seed(0)
    return {kind: MeshReconstructor(SMALL, kind).eval() for kind in ("towel", "tshirt")}


def test_even_an_untrained_network_gives_a_cloth_on_the_table(untrained, folded):
    network = untrained[folded.kind]
    (found,) = network.reconstruct([folded.depth], folded.camera, folded.kind)
    assert found.status == "template"
    assert isinstance(found.mesh, ClothMesh)
    assert found.mesh.canonical is not None
    assert np.isfinite(found.mesh.vertices).all()
    assert found.mesh.vertices[:, 2].min() > -0.005
    flat = np.ptp(found.mesh.canonical, axis=0)
    assert 0.1 < flat[0] < 1.3


def test_the_known_template_keeps_its_vertices_and_lengths(untrained, folded):
    (found,) = untrained[folded.kind].reconstruct(
        [folded.depth], folded.camera, folded.kind, template=folded.flat
    )
    np.testing.assert_array_equal(found.mesh.faces, folded.flat.faces)
    assert edge_strain(folded.flat, found.mesh.vertices) < 0.2


def test_the_canonical_image_covers_the_cloth_and_nothing_else(untrained, folded):
    network = untrained[folded.kind]
    (found,) = network.reconstruct([folded.depth], [folded.camera], folded.kind)
    view = crop(folded.depth, None, folded.camera, SMALL)
    cloth = view.mask.reshape(64, 2, 64, 2).any(axis=(1, 3))
    np.testing.assert_array_equal(np.isfinite(found.canonical_image).all(axis=-1), cloth)
    np.testing.assert_array_equal(found.confidence > 0, cloth)
    assert found.confidence.max() <= 1.0 + 1e-6
    unit = network.frame.to_unit(found.canonical_image[cloth])
    assert unit.min() >= 0
    assert unit.max() <= 1
    np.testing.assert_allclose(
        found.camera.world_from_camera, view.camera.world_from_camera, atol=1e-12
    )


def test_other_garments_and_counts_are_refused(untrained, folded_towel):
    network = untrained["towel"]
    with pytest.raises(InvalidConfigError, match="weights are for 'towel'"):
        network.reconstruct([folded_towel.depth], folded_towel.camera, "tshirt")
    with pytest.raises(InvalidRecordingError, match="1 depth pictures, 2 cameras"):
        network.reconstruct([folded_towel.depth], [folded_towel.camera] * 2, "towel")
    with pytest.raises(InvalidConfigError, match="sock"):
        MeshReconstructor(SMALL, "sock")
    assert network.reconstruct([], folded_towel.camera, "towel") == ()


def test_a_known_towel_may_have_its_longer_side_along_y(untrained, folded_towel):
    """What comes back has the template's own canonical coordinates, and fits as well."""
    network = untrained["towel"]
    wide = garment("towel", vertex_count=300, size_m=(0.3, 0.25))
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    long = replace(wide, vertices=wide.vertices @ turn, canonical=wide.canonical @ turn)
    first, second = (
        network.reconstruct([folded_towel.depth], folded_towel.camera, "towel", template=one)[0]
        for one in (wide, long)
    )
    np.testing.assert_array_equal(second.mesh.canonical, long.canonical)
    np.testing.assert_allclose(second.mesh.vertices, first.mesh.vertices, atol=1e-3)
