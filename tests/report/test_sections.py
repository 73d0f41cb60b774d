from dataclasses import replace

import numpy as np

from clothtrack.report.evidence import ObservedSteps
from clothtrack.report.sections import actions_html, figures_of, lead_line, settings_html
from clothtrack.tracking.tracked_trajectory import Calibration


def test_the_facts_are_in_one_line(tracked, two_cameras, clouds_only):
    line = lead_line(tracked, two_cameras)
    for fact in ("6 frames in 0.5 s", "2 actions", "2 cameras", "towel", "169 vertices"):
        assert fact in line
    assert "point clouds only" in lead_line(tracked, clouds_only)


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


def test_an_unknown_distance_is_left_out(tracked):
    nothing = ObservedSteps([], np.full(6, np.nan), np.full(6, np.nan))
    shown = figures_of(tracked, nothing, np.full(6, 0.01))
    figures = {one.name: one.value for one in shown}
    assert figures["Distance to cloud, median"] == ""
    assert figures["Edge strain, mean"] == "1.00"
    assert figures["Corrections dropped"] == "1"
