"""How well a mesh explains a picture: closed forms of each term, and the truth against others."""

import numpy as np
import pytest
import seen_above as above
from scipy.stats import spearmanr

from clothtrack.garments.garment_meshes import garment, towel
from clothtrack.reconstruction.data.view import crop
from clothtrack.reconstruction.explanation import (
    BENDING,
    CELLS,
    LAYERS,
    OUTLINE,
    SURFACE,
    TENSION,
    Explainer,
    Explanation,
)
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig

WIDTH_M, LENGTH_M = 0.4, 0.3


@pytest.fixture(scope="module")
def flat():
    return towel(WIDTH_M, LENGTH_M, 0.02)


@pytest.fixture(scope="module")
def folded(flat):
    return above.half_folded(flat, at_m=0.05)


def explained(rest, cloth, vertices):
    return Explainer(rest, cloth)(np.asarray(vertices, np.float64))


def test_a_mesh_explains_its_own_picture_without_a_rest(flat, folded):
    found = explained(flat, above.seen_from_above(folded, flat.faces), folded)
    assert found.outline == 0.0
    assert found.surface < 1e-9


def test_the_score_is_the_weighted_sum():
    one = Explanation(outline=0.1, surface=0.2, tension=0.3, layers=0.4, bending=0.5)
    terms = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    assert one.score == pytest.approx(terms @ [OUTLINE, SURFACE, TENSION, LAYERS, BENDING])


@pytest.mark.parametrize("scale", [1.0, 0.7, 1.2])
def test_tension_is_the_relative_change_of_length(flat, scale):
    cloth = above.seen_from_above(flat.vertices + (0.0, 0.0, 0.003), flat.faces)
    found = explained(flat, cloth, scale * np.asarray(flat.vertices, np.float64))
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
    found = explained(flat, above.seen_from_above(bent, flat.faces), bent)
    # Of 500 hinges that do not bend each is taken for one of 1e-4 of a half turn.
    assert found.bending == pytest.approx(LENGTH_M / WIDTH_M * angle_rad / np.pi, abs=5e-3)
    assert found.tension < 1e-6


def layers_in_cells(vertices, faces, camera):
    """Area of the triangles in each cell by the cell of their middle, one after the other [m^2]."""
    layers = np.zeros((CELLS, CELLS))
    for a, b, c in vertices[faces]:
        (u, v), (s, t) = (b - a)[:2], (c - a)[:2]
        (pixel,), _ = camera.project(((a + b + c) / 3.0)[None])
        column, row = np.floor(pixel * CELLS / camera.width).astype(int)
        layers[row, column] += 0.5 * abs(u * t - v * s)
    return layers


def with_heights(heights_m, camera):
    """A cloth that is seen everywhere, as high in each cell as is said [m]."""
    side = camera.width // CELLS
    depth = camera.position[2] - np.kron(heights_m, np.ones((side, side)))
    return SeenCloth(camera, depth, np.ones(depth.shape, bool), 0.0)


def test_layers_are_ranked_as_the_heights_are(flat, folded, rng):
    camera = above.camera_above()
    # No two cells have the same share of layers.
    folded = folded + rng.uniform(-0.002, 0.002, folded.shape) * (1.0, 1.0, 0.0)
    layers = layers_in_cells(folded, flat.faces, camera)
    for heights_m, expected in [(layers, 0.0), (layers**2, 0.0), (layers.max() - layers, 2.0)]:
        # Some 2 cm at most: what is higher would be seen in other cells.
        cloth = with_heights(0.02 * heights_m / heights_m.max(), camera)
        assert explained(flat, cloth, folded).layers == pytest.approx(expected, abs=1e-9)
    heights_m = 0.02 * rng.random((CELLS, CELLS))
    found = explained(flat, with_heights(heights_m, camera), folded).layers
    assert found == pytest.approx(1.0 - spearmanr(layers.ravel(), heights_m.ravel())[0], abs=1e-9)


def test_a_cloth_of_one_height_says_nothing_of_layers(flat, folded):
    cloth = with_heights(np.full((CELLS, CELLS), 0.01), above.camera_above())
    assert explained(flat, cloth, folded).layers == 1.0


def test_where_nothing_could_be_seen_a_mesh_may_lie_or_not(flat, folded):
    cloth = above.seen_from_above(folded, flat.faces)
    half = cloth.seen.copy()
    half[:, 64:] = False
    depth = np.where(half, cloth.depth, 0.0)
    covered = SeenCloth(cloth.camera, depth, half, 0.0)
    hidden = SeenCloth(cloth.camera, depth, half | cloth.seen, 0.0)
    share = 1.0 - half.sum() / cloth.seen.sum()
    assert explained(flat, covered, folded).outline == pytest.approx(share)
    assert explained(flat, hidden, folded).outline == 0.0


def moved(vertices):
    return vertices + (0.02, 0.0, 0.0)


def enlarged(vertices):
    middle = vertices.mean(axis=0) * (1.0, 1.0, 0.0)
    return middle + 1.2 * (vertices - middle)


def rippled(vertices):
    return vertices + np.outer(np.sin(150.0 * vertices[:, 1]), (0.0, 0.0, 0.004))


def turned_over(vertices):
    """The part that lies on top goes under the rest: the same silhouette, other layers."""
    return vertices * (-1.0, 1.0, 1.0)


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
@pytest.mark.parametrize(
    ("worse", "term"),
    [(moved, "outline"), (enlarged, "tension"), (rippled, "bending"), (turned_over, "outline")],
)
def test_the_truth_explains_its_picture_better_than_what_is_near_it(kind, worse, term):
    rest = garment(kind, vertex_count=500, size_m=(0.4, 0.3))
    vertices = above.half_folded(rest, at_m=0.06)
    vertices[:, 2] += 0.002 * np.sign(rest.canonical[:, 2]) * (vertices[:, 2] < 0.005)
    picture = above.picture_of(vertices, rest.faces)
    view = crop(picture.depth_m, picture.mask, picture.camera, TokenNetworkConfig())
    explain = Explainer(rest, SeenCloth.of(view, picture, 0.0))
    truth, other = explain(vertices), explain(worse(vertices))
    assert truth.score < other.score
    assert getattr(truth, term) < 0.5 * getattr(other, term)
