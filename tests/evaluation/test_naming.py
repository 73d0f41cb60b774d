"""Corners that were named by a guess are compared as the truth names them, and no others."""

import numpy as np
import pytest

from clothtrack.evaluation.naming import true_places
from clothtrack.evaluation.truth import Truth, material_points
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.tracking.tracked_trajectory import StepRecords, TrackedTrajectory

OBLONG, SQUARE = (0.24, 0.16), (0.2, 0.2)
HALF_TURN = np.array([-1.0, -1.0, 1.0])


def folded(flat):
    """The right half laid over the left: no longer like anything turned."""
    x, y, z = flat.T
    return np.column_stack([-np.abs(x), y, z + np.where(x > 1e-9, 0.01, 0.0)])


def known(size_m):
    """A flat towel and its fold, on a fine mesh."""
    fine = towel(*size_m, 0.01)
    flat = np.asarray(fine.vertices, float)
    return Truth(np.stack([flat, folded(flat)]), fine.faces, np.arange(2), fine.canonical)


def run(size_m, *, rename, source):
    """The same cloth without a fault, named otherwise."""
    mesh = towel(*size_m, 0.02)
    flat = np.asarray(mesh.vertices, float)
    named = ClothMesh(flat, mesh.faces, rename(np.asarray(mesh.canonical, float)))
    return trajectory(named, np.stack([flat, folded(flat)]), source)


def trajectory(mesh, positions, source):
    provenance = {} if source is None else {"initial_state": {"source": source}}
    count = len(positions)
    return TrackedTrajectory(
        name="fold", mesh=mesh, frames=np.arange(count), time_s=0.1 * np.arange(count),
        positions=positions, visible=np.ones(positions.shape[:2], bool), actions=(),
        steps=StepRecords.empty(count), config={}, provenance=provenance,
    )  # fmt: skip


def worst_mm(tracked, truth):
    where = true_places(tracked, truth)
    apart = tracked.positions[1] - material_points(truth.at(1), truth.faces, where)
    return 1e3 * np.median(np.linalg.norm(apart, axis=1))


@pytest.mark.parametrize("source", ["flat", "network", "file"])
@pytest.mark.parametrize(
    ("size_m", "rename"),
    [
        (OBLONG, lambda c: c * HALF_TURN),
        (OBLONG, lambda c: c * [1.0, -1.0, 1.0]),
        (OBLONG, lambda c: c[:, [1, 0, 2]]),
        (SQUARE, lambda c: c[:, [1, 0, 2]]),
        (SQUARE, lambda c: c[:, [1, 0, 2]] * HALF_TURN),
        (OBLONG, lambda c: c + [0.5, 0.2, 0.0]),
    ],
)
def test_a_guessed_name_is_no_error(size_m, rename, source):
    assert worst_mm(run(size_m, rename=rename, source=source), known(size_m)) < 0.1


@pytest.mark.parametrize("source", [None, "template"])
def test_the_names_of_a_template_count(source):
    turned = run(OBLONG, rename=lambda c: c * HALF_TURN, source=source)
    assert worst_mm(turned, known(OBLONG)) > 50.0


def test_cloth_that_went_wrong_later_stays_wrong():
    """The naming is chosen once, at the first frame: a fold to the wrong side is an error."""
    tracked = run(OBLONG, rename=lambda c: c, source="flat")
    tracked.positions[1] = tracked.positions[1] * HALF_TURN
    assert worst_mm(tracked, known(OBLONG)) > 50.0
