"""Neat folds: laws that hold for any garment, thickness and fold."""

from collections.abc import Callable

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import garment, shirt
from clothtrack.garments.outlines import ShirtOutline
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings, edge_strain
from clothtrack.reconstruction.data.folding import NEAT, NeatFolds
from clothtrack.reconstruction.data.layers import Layers, Line
from clothtrack.reconstruction.data.wrinkles import wrinkled

THIN_M = 0.001


def towel(vertex_count: int = 600) -> ClothMesh:
    return garment("towel", vertex_count=vertex_count, size_m=(0.5, 0.4), pattern="random")


def sweater() -> ClothMesh:
    outline = ShirtOutline(sleeve=0.6, sleeve_angle_rad=0.7, cuff=0.13)
    return shirt(outline, 0.6, vertex_count=900)


def on_table(layers: Layers) -> np.ndarray:
    return layers.pressed(np.array(layers.mesh.vertices))


def folded_half(layers: Layers) -> np.ndarray:
    return layers.wrapped(on_table(layers), Line.at(0.0, 0.0))


@pytest.mark.parametrize("thickness_m", [0.0005, 0.002, 0.006])
def test_layers_lie_a_thickness_apart_and_the_lowest_on_the_table(thickness_m: float) -> None:
    layers = Layers(towel(), thickness_m)
    folded = folded_half(layers)
    inner = (np.abs(layers.mesh.vertices[:, 0]) > 0.08) & (folded[:, 0] > -0.22)
    moved = layers.mesh.vertices[:, 0] > 0.0
    assert folded[:, 2].min() == pytest.approx(0.5 * thickness_m)
    np.testing.assert_allclose(folded[inner & ~moved, 2], 0.5 * thickness_m, rtol=0.05)
    np.testing.assert_allclose(folded[inner & moved, 2], 1.5 * thickness_m, rtol=0.05)
    assert layers.most(folded) == pytest.approx(2.0, abs=0.1)


def test_a_half_fold_aligns_edges_and_halves_the_area() -> None:
    layers = Layers(towel(), THIN_M)
    folded = folded_half(layers)
    flat = layers.mesh.vertices
    bend_m = 0.5 * np.pi * THIN_M
    assert folded[flat[:, 0] > 0.249, 0] == pytest.approx(-0.25 + bend_m, abs=1e-6)
    np.testing.assert_allclose(folded[:, 1], flat[:, 1])
    covered = projected_area(folded, layers.mesh.faces)
    assert covered == pytest.approx(0.5 * 0.5 * 0.4, rel=0.02)
    assert crossings(folded, layers.mesh.faces) == 0


@pytest.mark.parametrize("make", [towel, sweater])
def test_whatever_is_done_layers_stay_above_the_table_and_hardly_cross(
    make: Callable[[], ClothMesh],
) -> None:
    rng = np.random.default_rng(5)
    for recipe in NEAT:
        # The solver unwinds rolls, at the distance that contact keeps.
        thickness_m = 0.005 if recipe == "roll" else THIN_M
        folds = NeatFolds(make(), thickness_m)
        done, points = folds.fold(recipe, on_table(folds.layers), rng)
        mesh = folds.layers.mesh
        assert np.isfinite(points).all()
        assert points[:, 2].min() > 0.49 * thickness_m
        assert done == recipe or recipe in ("fold_sleeves", "fold_top")
        assert crossings(points, mesh.faces) < 0.06 * len(mesh.edges)
        assert edge_strain(mesh, points) < 0.06


def test_wrinkles_are_a_few_millimeters_and_keep_lengths_and_order() -> None:
    mesh = towel(1000)
    layers = Layers(mesh, 0.002)
    folded = folded_half(layers)
    for seed in range(6):
        fine = wrinkled(
            folded, edge_m=layers.edge_m, stacked_m=0.002, rng=np.random.default_rng(seed)
        )
        rise = fine[:, 2] - folded[:, 2]
        assert rise.min() >= 0.0
        assert 0.0002 < rise.max() < 0.03
        assert edge_strain(mesh, fine) < edge_strain(mesh, folded) + 0.005
        assert crossings(fine, mesh.faces) <= 0.01 * len(mesh.edges)
