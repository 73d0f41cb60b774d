import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from clothtrack.report.curves import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    Chart,
    Line,
    chart_html,
)

FRAMES = np.arange(5)


def drawn(chart, frames=FRAMES, actions=()):
    return ET.fromstring(chart_html(chart, frames, actions)).find("svg")


def points(svg):
    path = next(p for p in svg.iter("path") if "line" in p.get("class"))
    pairs = re.findall(r"([ML])([-\d.]+) ([-\d.]+)", path.get("d"))
    return [(letter, float(x), float(y)) for letter, x, y in pairs]


def test_a_straight_line_is_drawn_straight_from_corner_to_corner():
    found = points(drawn(Chart("rise", "mm", (Line("", np.linspace(0.0, 4.0, 5)),))))
    assert [letter for letter, _, _ in found] == ["M", "L", "L", "L", "L"]
    x, y = np.array([(x, y) for _, x, y in found]).T
    np.testing.assert_allclose(x, np.linspace(LEFT, WIDTH - RIGHT, 5), atol=0.06)
    np.testing.assert_allclose(y, np.linspace(HEIGHT - BOTTOM, TOP, 5), atol=0.06)


def test_a_missing_value_leaves_a_gap():
    values = np.array([1.0, 2.0, np.nan, 3.0, 4.0])
    letters = [letter for letter, _, _ in points(drawn(Chart("gap", "", (Line("", values),))))]
    assert letters == ["M", "L", "M", "L"]


def test_nothing_known_is_an_empty_chart():
    nothing = Chart("unknown", "", (Line("", np.full(5, np.nan)),))
    assert points(drawn(nothing)) == []


def test_marks_stand_at_their_frames_and_bands_at_the_actions():
    chart = Chart("trials", "", (Line("", np.ones(5)),), marks=(4,), marks_label="dropped")
    svg = drawn(chart, actions=[(1, 3)])
    crosses = [p for p in svg.iter("path") if p.get("class") == "cross"]
    assert [cross.find("title").text for cross in crosses] == ["frame 4: dropped"]
    assert crosses[0].get("d").startswith(f"M{WIDTH - RIGHT - 3:.1f}")
    band = next(r for r in svg.iter("rect"))
    span = (WIDTH - LEFT - RIGHT) / 4
    assert float(band.get("x")) == pytest.approx(LEFT + span, abs=0.1)
    assert float(band.get("width")) == pytest.approx(2 * span, abs=0.1)


def test_words_cannot_break_out_of_the_page():
    text = chart_html(Chart("a<b>&'", "'\"", (Line("<i>", np.ones(5)),)), FRAMES, ())
    assert ET.fromstring(text).find("figcaption/h3").text.startswith("a<b>&'")


def test_a_single_frame_can_be_drawn():
    svg = drawn(Chart("one", "", (Line("", np.array([2.0])),)), np.array([7]))
    assert [c.get("class") for c in svg.iter("circle")] == ["tone0"]


def test_an_axis_of_nothing_but_zeros_ends_at_one():
    frames = np.arange(4)
    for values in (np.zeros(4), np.full(4, np.nan)):
        drawn = chart_html(Chart("Line search", "", (Line("", values),)), frames, ())
        assert ">1</text>" in drawn
        assert "e-" not in drawn
