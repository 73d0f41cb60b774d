import numpy as np

from clothtrack.report.palette import heat, hexadecimal


def test_heat_runs_from_calm_to_red_and_stays_there():
    colors = heat(np.array([-1.0, 0.0, 5.0, 10.0, 99.0, np.nan]), 10.0)
    np.testing.assert_array_equal(colors[0], colors[1])
    np.testing.assert_array_equal(colors[3], colors[4])
    np.testing.assert_array_equal(colors[5], colors[1])
    assert colors[1, 2] > colors[1, 0]
    assert colors[3, 0] > colors[3, 2]


def test_style_sheets_read_the_colors():
    assert hexadecimal((1.0, 0.0, 0.502)) == "#ff0080"
