from dataclasses import replace

import numpy as np
import pytest

from clothtrack.report.sections import actions_html, charts, edge_strains, settings_html
from clothtrack.tracking.tracked_trajectory import Calibration


def test_each_action_shows_its_chosen_parameters_and_marks_one_candidate(tracked, two_cameras):
    html = actions_html(tracked, two_cameras)
    assert html.count("<article") == 2
    assert html.count('class="best"') == 2
    assert html.count('class="rest"') == 2 * 3
    for action in tracked.actions:
        assert f"{action.parameters['table_friction']:.4g}" in html


def test_an_action_without_calibration_says_so(tracked, two_cameras):
    nothing = Calibration("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)
    action = replace(tracked.actions[0], calibration=nothing, held_vertices={})
    assert "Not calibrated" in actions_html(replace(tracked, actions=(action,)), two_cameras)


def test_settings_are_shown_as_they_are_and_cannot_break_out(tracked, two_cameras):
    html = settings_html(replace(tracked, config={"<script>": 1}), two_cameras)
    assert "&lt;script&gt;" in html
    assert "<script>" not in html


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.2])
def test_strain_is_the_change_of_scale(tracked, scale):
    grown = replace(tracked, positions=np.repeat(scale * tracked.mesh.vertices[None], 6, axis=0))
    np.testing.assert_allclose(edge_strains(grown), abs(scale - 1), atol=1e-6)


def test_dropped_corrections_are_marked(tracked):
    search = next(c for c in charts(tracked, np.zeros(6), np.zeros(6)) if c.title == "Line search")
    assert search.marks == (3,)
