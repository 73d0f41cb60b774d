"""How well a mesh explains a picture: closed forms of each term, and the truth against others."""

import numpy as np
import pytest
import seen_above as above

from clothtrack.garments.garment_meshes import garment, towel
from clothtrack.reconstruction.data.view import crop
from clothtrack.reconstruction.explanation import (
    Explainer,
)
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig

WIDTH_M, LENGTH_M = 0.4, 0.3


@pytest.fixture(scope="module")
def flat():
    return towel(WIDTH_M, LENGTH_M, 0.02)


@pytest.mark.parametrize("scale", [1.0, 0.7, 1.2])
def test_tension_is_the_relative_change_of_length(flat, scale):
    cloth = above.seen_from_above(flat.vertices + (0.0, 0.0, 0.003), flat.faces)
    found = Explainer(flat, cloth)(scale * np.asarray(flat.vertices, np.float64))
    assert found.tension == pytest.approx(abs(scale - 1.0), abs=1e-6)


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, 1.5, 3.0])
def test_a_straight_crease_bends_by_its_length_and_angle(flat, angle_rad):
    x, y, _ = np.asarray(flat.vertices, np.float64).T
    columns = np.unique(np.round(x, 9))
    crease = columns[len(columns) // 3]
    beyond = np.maximum(x - crease, 0.0)
    bent = np.column_stack([
        np.minimum(x, crease) + beyond * np.cos(angle_rad), y, 0.003 + beyond * np.sin(angle_rad)
    ])  # fmt: skip
    found = Explainer(flat, above.seen_from_above(bent, flat.faces))(bent)
    # Of 500 hinges that do not bend each is taken for one of 1e-4 of a half turn.
    assert found.bending == pytest.approx(LENGTH_M / WIDTH_M * angle_rad / np.pi, abs=5e-3)
    assert found.tension < 1e-6
    assert (found.outline, found.surface) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_where_nothing_could_be_seen_a_mesh_may_lie_or_not(flat):
    folded = above.half_folded(flat, at_m=0.05)
    cloth = above.seen_from_above(folded, flat.faces)
    half = cloth.seen.copy()
    half[:, 64:] = False
    depth = np.where(half, cloth.depth, 0.0)
    covered = SeenCloth(cloth.camera, depth, half, 0.0)
    hidden = SeenCloth(cloth.camera, depth, half | cloth.seen, 0.0)
    share = 1.0 - half.sum() / cloth.seen.sum()
    assert Explainer(flat, covered)(folded).outline == pytest.approx(share)
    assert Explainer(flat, hidden)(folded).outline == 0.0


def enlarged(vertices):
    middle = vertices.mean(axis=0) * (1.0, 1.0, 0.0)
    return middle + 1.2 * (vertices - middle)


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_truth_explains_its_picture_better_than_what_is_near_it(kind):
    rest = garment(kind, vertex_count=500, size_m=(0.4, 0.3))
    vertices = above.half_folded(rest, at_m=0.06)
    vertices[:, 2] += 0.002 * np.sign(rest.canonical[:, 2]) * (vertices[:, 2] < 0.005)
    picture = above.picture_of(vertices, rest.faces)
    view = crop(picture.depth_m, picture.mask, picture.camera, TokenNetworkConfig())
    explain = Explainer(rest, SeenCloth.of(view, picture, 0.0))
    truth = explain(vertices)
    rippled = vertices + np.outer(np.sin(150.0 * vertices[:, 1]), (0.0, 0.0, 0.004))
    for worse, term in (
        (vertices + (0.02, 0.0, 0.0), "outline"),
        (enlarged(vertices), "tension"),
        (rippled, "bending"),
        # The part that lies on top goes under the rest: the same silhouette, other layers.
        (vertices * (-1.0, 1.0, 1.0), "outline"),
    ):
        other = explain(worse)
        assert truth.score < other.score
        assert getattr(truth, term) < 0.5 * getattr(other, term)
