"""Cloth that has passed through itself comes apart; what has not stays where it is."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import tshirt
from clothtrack.geometry.intersections import SelfIntersection
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings
from clothtrack.recordings.recording import Table
from clothtrack.simulation.untangling import Untangler, untangled

SIDE, COUNT = 0.3, 16


def sheet():
    line = np.linspace(-SIDE / 2, SIDE / 2, COUNT)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    corner = (np.arange(COUNT - 1)[:, None] * COUNT + np.arange(COUNT - 1)).ravel()
    one = np.stack([corner, corner + COUNT, corner + 1], 1)
    other = np.stack([corner + 1, corner + COUNT, corner + COUNT + 1], 1)
    return vertices, np.concatenate([one, other])


FLAT, FACES = sheet()
TWO = ClothMesh(
    np.concatenate([FLAT, FLAT + (0.0, 0.0, 1.0)]), np.concatenate([FACES, FACES + len(FLAT)])
)


def turned(axis, degrees):
    axis = np.array(axis, float) / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), axis)
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


PUSHED = {
    "an edge, upright, 6 cm deep": ((1, 0.03, 0), 90, (0.011, 0.013, 0.093)),
    "an edge at 60 degrees": ((1, 0.1, 0), 60, (0.0, 0.02, 0.10)),
    "an edge at 15 degrees": ((1, 0.1, 0), 15, (0.01, 0.03, 0.03)),
    "a corner": ((1, 1, 0), 50, (0.01, 0.02, 0.12)),
    "half beside the other": ((1, 0.03, 0), 80, (0.17, 0.01, 0.11)),
    "nearly flat": ((1, 0.3, 0), 5, (0.1, 0.08, 0.002)),
}


def pushed(name):
    axis, degrees, shift = PUSHED[name]
    return np.concatenate([FLAT, FLAT @ turned(axis, degrees).T + shift])


def strains(mesh, positions):
    ends = positions[mesh.edges]
    return np.abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / mesh.edge_lengths - 1.0)


@pytest.mark.parametrize("name", PUSHED)
def test_two_sheets_pushed_through_each_other_come_apart(name):
    given = pushed(name)
    result = untangled(TWO, given)
    assert result.crossings_before == crossings(given, TWO.faces) > 15
    assert result.crossings_after == crossings(result.positions, TWO.faces) == 0
    assert 0 < result.rounds < 20
    strain = strains(TWO, result.positions)
    assert strain.mean() < 0.01
    assert np.quantile(strain, 0.95) < 0.05
    # Apart, and not far away.
    assert np.linalg.norm(result.positions - given, axis=1).max() < 0.07


def bulged():
    """A sheet under another that it comes through in the middle, and ends within."""
    under = FLAT * (0.8, 0.8, 1.0) + (0.007, 0.0043, -0.008)
    away = np.square(FLAT[:, :2] - (0.02, -0.013)).sum(axis=1)
    under[:, 2] += 0.03 * np.exp(-away / 0.03**2)
    return np.concatenate([FLAT, under])


def test_a_bulge_goes_back_through_its_closed_contour():
    given = bulged()
    mesh = ClothMesh(given, TWO.faces)
    found = SelfIntersection(mesh).contours(given)
    assert found.count == 1
    # Closed: no edge at a rim ends it.
    assert (SelfIntersection(mesh).edge_faces[found.edges] >= 0).all()
    result = untangled(mesh, given)
    assert result.crossings_before > 10
    assert result.crossings_after == 0
    assert strains(mesh, result.positions).max() < 0.05


def folded_through(flat, fold):
    """A flat cloth folded over along x = `fold`, its end bent down through what it lies on."""
    bend, up, down = 0.05, np.radians(20.0), np.radians(50.0)
    beyond = np.maximum(flat[:, 0] - fold, 0.0)
    risen = np.minimum(beyond, bend)
    sunk = beyond - risen
    given = flat.copy()
    given[:, 0] = np.minimum(flat[:, 0], fold) - risen * np.cos(up) - sunk * np.cos(down)
    turn = np.where(beyond > 0.0, -1.0, 1.0)
    given[:, 2] = turn * flat[:, 2] + risen * np.sin(up) - sunk * np.sin(down)
    return given


@pytest.mark.parametrize(("degrees", "fold"), [(3, 0.02), (20, 0.05), (40, 0.06)])
def test_a_folded_sheet_comes_out_of_itself(degrees, fold):
    turn = turned((0, 0, 1), degrees)
    mesh = ClothMesh(FLAT @ turn.T, FACES)
    result = untangled(mesh, folded_through(mesh.vertices, fold))
    assert result.crossings_before > 10
    assert result.crossings_after == 0
    assert np.quantile(strains(mesh, result.positions), 0.95) < 0.05


def test_a_sleeve_comes_out_of_the_body():
    shirt = tshirt(spacing_m=0.015)
    given = folded_through(np.asarray(shirt.vertices, np.float64), 0.13)
    result = untangled(shirt, given)
    assert result.crossings_before > 40
    assert result.crossings_after == crossings(result.positions, shirt.faces) == 0
    strain = strains(shirt, result.positions)
    assert strain.mean() < 0.02
    # It came out; it was not torn out.
    assert np.linalg.norm(result.positions - given, axis=1).max() < 0.1


def test_a_mesh_without_crossings_keeps_its_bits():
    rng = np.random.default_rng(0)
    given = TWO.vertices + 1e-3 * rng.normal(size=TWO.vertices.shape)
    result = untangled(TWO, given)
    assert result.crossings_before == result.rounds == 0
    assert result.positions.dtype == given.dtype
    assert result.positions.tobytes() == given.tobytes()


def test_vertices_far_from_a_crossing_keep_their_bits():
    given = pushed("a corner")
    result = untangled(TWO, given)
    moved = (result.positions != given).any(axis=1)
    assert moved.any()
    search = SelfIntersection(TWO)
    places = given[search.edges[search.contours(given).edges]].mean(axis=1)
    apart = np.linalg.norm(given[:, None] - places, axis=2).min(axis=1)
    assert not moved[apart > 0.16].any()
    assert (apart > 0.16).sum() > 50


def test_what_came_before_on_the_same_cloth_does_not_matter():
    given = pushed("an edge at 60 degrees")
    untangle = Untangler(TWO)
    assert untangle(TWO.vertices).rounds == 0
    assert untangle(pushed("a corner")).rounds > 0
    assert untangle(given).positions.tobytes() == untangled(TWO, given).positions.tobytes()


def test_nothing_is_pushed_into_the_table():
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    given = bulged() + (0.0, 0.0, 0.0095)
    mesh = ClothMesh(given, TWO.faces)
    free = untangled(mesh, given)
    result = untangled(mesh, given, table=table)
    lowest = np.minimum(given[:, 2], 0.0015)
    assert (free.positions[:, 2] < lowest - 1e-4).any()
    assert (result.positions[:, 2] >= lowest - 1e-6).all()
    assert result.crossings_after == 0


def test_a_vertex_without_mobility_stays():
    given = pushed("an edge at 60 degrees")
    mobility = np.repeat([0.0, 1.0], len(FLAT))
    result = untangled(TWO, given, mobility=mobility)
    assert result.crossings_after == 0
    assert result.positions[: len(FLAT)].tobytes() == given[: len(FLAT)].tobytes()
    assert (result.positions[len(FLAT) :] != given[len(FLAT) :]).any()


def test_a_failure_is_recorded():
    given = pushed("an edge, upright, 6 cm deep")
    result = untangled(TWO, given, rounds=1)
    assert result.rounds == 1
    assert result.crossings_after == crossings(result.positions, TWO.faces) > 0
    none = untangled(TWO, given, rounds=0)
    assert none.positions.tobytes() == given.tobytes()
    assert none.crossings_after == none.crossings_before
