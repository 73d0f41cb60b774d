import numpy as np

from clothtrack.report.lettering import caption, heat_legend, text_width
from clothtrack.report.palette import heat


def dark_columns(strip):
    return np.flatnonzero((strip.max(axis=2) < 130).any(axis=0))


def test_words_stand_at_both_ends_of_a_caption():
    columns = dark_columns(caption(400, "frame 3", "60 % visible"))
    assert columns.min() < 20
    assert columns.max() > 380
    gap = np.diff(columns).max()
    assert gap > 400 - 2 * 10 - text_width("frame 3" + "60 % visible", height_px=10.8) - 40


def test_a_full_caption_drops_its_right_end():
    both, left = (caption(120, "frame 3  1.20 s", right) for right in ("60 % visible", ""))
    np.testing.assert_array_equal(both, left)


def test_the_legend_shows_the_scale_it_explains():
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    heat_legend(image, "mm", 4.0)
    expected = np.rint(255 * heat(np.linspace(0, 1, 80), 1.0)).astype(np.uint8)
    rows = [row for row in image if (row[14:94] == expected).all()]
    assert len(rows) >= 6
