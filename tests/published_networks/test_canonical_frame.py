import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.first_mesh import symmetries
from clothtrack_lab.published_networks.canonical_frame import (
    LARGEST_SIZE_M,
    canonical_frame,
    check_canonical,
    conventional,
)
from clothtrack_lab.world.bench import Ranges

KINDS = tuple(LARGEST_SIZE_M)


@pytest.mark.parametrize("kind", KINDS)
def test_the_largest_garment_lies_inside_the_cube_with_a_margin(kind):
    mesh = garment(kind, vertex_count=600, size_m=LARGEST_SIZE_M[kind])
    unit = canonical_frame(kind).to_unit(mesh.canonical)
    assert unit.min() > 0.05
    assert unit.max() < 0.95
    half = np.array(canonical_frame(kind).half_m)
    np.testing.assert_allclose(np.abs(mesh.canonical).max(axis=0), half, rtol=0.02, atol=1e-9)


def test_the_cube_has_room_for_every_garment_of_the_benchmark():
    ranges = Ranges()
    assert max(ranges.towel_side_m) <= min(LARGEST_SIZE_M["towel"])
    assert ranges.tshirt_width_m[1] <= LARGEST_SIZE_M["tshirt"][0]
    assert ranges.tshirt_length_m[1] <= LARGEST_SIZE_M["tshirt"][1]


@pytest.mark.parametrize("kind", KINDS)
def test_symmetries_are_a_group_of_turns(kind):
    signs = symmetries(kind)
    assert (signs[0] == 1).all()
    assert (signs.prod(axis=1) == 1).all()
    members = {tuple(one) for one in signs}
    assert {tuple(a * b) for a in signs for b in signs} == members


@pytest.mark.parametrize("kind", KINDS)
def test_a_symmetry_maps_the_outline_of_the_garment_onto_itself(kind):
    mesh = garment(kind, vertex_count=600)
    for signs in symmetries(kind):
        moved = mesh.canonical * signs
        np.testing.assert_allclose(moved.min(axis=0), mesh.canonical.min(axis=0), atol=2e-3)
        np.testing.assert_allclose(moved.max(axis=0), mesh.canonical.max(axis=0), atol=2e-3)


def test_a_towel_has_its_longer_side_along_x_and_keeps_its_face():
    mesh = garment("towel", vertex_count=300, size_m=(0.22, 0.31))
    turned = conventional(mesh.canonical, "towel")
    np.testing.assert_allclose(np.ptp(turned, axis=0), (0.31, 0.22, 0.0), atol=1e-9)
    a, b, c = np.moveaxis(turned[mesh.faces], 1, 0)
    before = np.moveaxis(mesh.canonical[mesh.faces], 1, 0)
    up = np.cross(before[1] - before[0], before[2] - before[0])
    np.testing.assert_allclose(np.cross(b - a, c - a), up, atol=1e-12)
    np.testing.assert_array_equal(conventional(turned, "towel"), turned)


def test_a_pose_that_the_cube_cannot_hold_or_tell_apart_is_refused():
    towel, shirt = (garment(kind, vertex_count=600).canonical for kind in ("towel", "tshirt"))
    check_canonical(towel, "towel")
    check_canonical(shirt, "tshirt")
    for wrong in (1e3 * towel, towel + (0.4, 0.0, 0.0)):
        with pytest.raises(InvalidConfigError, match="in meters about the origin"):
            check_canonical(wrong, "towel")
    with pytest.raises(InvalidConfigError, match="front and back are one place"):
        check_canonical(shirt * (1.0, 1.0, 0.03), "tshirt")
