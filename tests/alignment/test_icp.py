"""Alternating least squares: its steps do not take each other back, and it ends by itself."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.alignment.aligner import AlignmentConfig, CloudAligner, Marks
from clothtrack.garments.garment_meshes import towel

ICP = AlignmentConfig(solver="icp", iterations=12, icp_momentum=0.4)
RADIUS = 0.07


@pytest.fixture(scope="module")
def sheet():
    return towel(0.14, 0.14, 0.01)


@pytest.fixture(scope="module")
def rolled(sheet):
    """The sheet round a pole: every edge has to turn."""
    x, y, _ = (sheet.vertices - sheet.vertices.mean(axis=0)).T
    return np.stack([RADIUS * np.sin(x / RADIUS), y, RADIUS * (1 - np.cos(x / RADIUS))], axis=1)


@pytest.fixture(scope="module")
def align(sheet, rolled):
    """From flat to rolled, told by the cloud and by the marks of every so many vertices."""
    seen = np.ones(sheet.vertex_count, bool)
    flat = sheet.vertices - sheet.vertices.mean(axis=0)

    def aligned(every=5, **settings):
        marks = Marks(rolled, (np.arange(sheet.vertex_count) % every == 0).astype(float))
        aligner = CloudAligner(sheet, replace(ICP, **settings))
        return aligner.align(flat, rolled, seen, marks=marks)

    return aligned


def rises(losses):
    """All that was lost again after the first long steps, over what is left at the end."""
    return np.maximum(np.diff(losses[3:]), 0.0).sum() / losses[-1]


def test_damped_steps_do_not_take_each_other_back(align):
    """Vertices that run after their nearest points find others there, and would run back."""
    lost = {
        damping: np.mean(
            [rises(align(every, icp_damping=damping).losses) for every in (3, 4, 5, 7)]
        )
        for damping in (0.0, 0.2)
    }
    assert lost[0.2] < 0.25 * lost[0.0]


def test_it_ends_where_it_gets_no_farther(align):
    whole, ended = align(iterations=60), align(iterations=60, icp_tolerance=0.02)
    assert (whole.iterations, whole.reason) == (60, "iterations")
    assert ended.reason == "tolerance"
    assert 3 <= ended.iterations < 30
    assert ended.losses.shape == (ended.iterations + 1,)
    # The last evaluation is that of the result; the rule saw those before.
    np.testing.assert_array_equal(ended.losses[:-1], whole.losses[: ended.iterations])
    gained = ended.losses[2:-1] / ended.losses[:-3]
    assert gained[-1] > 0.98
    assert (gained[:-1] <= 0.98).all()
    assert ended.losses[-1] < 1.1 * whole.losses[-1]
