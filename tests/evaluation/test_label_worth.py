"""A label is learned from only where it is expected to be nearer to the truth than the network."""

from pathlib import Path

import pytest

from clothtrack.evaluation.label_worth import (
    better_than_network,
    network_error_mm,
    with_first_mesh,
)


@pytest.mark.parametrize(
    ("label_mm", "network_mm", "better"),
    [(5.0, 9.0, True), (9.0, 5.0, False), (5.0, 5.0, False), (40.0, None, True)],
)
def test_the_smaller_expected_error_decides(label_mm, network_mm, better):
    assert better_than_network(label_mm, network_mm) is better


def test_a_label_is_no_better_than_the_mesh_that_it_began_with():
    assert with_first_mesh(6.0, {"source": "template"}) == 6.0
    assert with_first_mesh(6.0, {"source": "network", "expected_error_m": None}) == 6.0
    assert with_first_mesh(6.0, {"source": "network", "expected_error_m": 0.008}) == 10.0


def test_a_network_that_states_no_error_is_not_asked():
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    from clothtrack_lab.published_networks.model import MeshReconstructor
    from clothtrack_lab.published_networks.network_config import TINY_NETWORK
    from clothtrack_lab.published_networks.published_meshes import PublishedMeshes

    model = PublishedMeshes(MeshReconstructor(TINY_NETWORK, "towel"))
    assert network_error_mm(model, Path("no recording"), 0, kind="towel") is None
