import re
import xml.etree.ElementTree as ET

import numpy as np

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


def test_words_cannot_break_out_of_the_page():
    text = chart_html(Chart("a<b>&'", "'\"", (Line("<i>", np.ones(5)),)), FRAMES, ())
    assert ET.fromstring(text).find("figcaption/h3").text.startswith("a<b>&'")
