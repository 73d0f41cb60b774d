import re
from dataclasses import replace

import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.report.artefact_pages import (
    IndexEntry,
    write_index,
    write_mesh_page,
    write_recording_page,
)


@pytest.mark.parametrize("name", ["two_cameras", "clouds_only"])
def test_a_recording_has_a_page_before_it_is_tracked(name, request, tmp_path):
    recording = request.getfixturevalue(name)
    text = write_recording_page(recording, tmp_path / "r.html").read_text(encoding="utf-8")
    assert re.search(r'<div class="stage" data-frames="\[0, 1, 2, 3, 4, 5\]"', text)
    assert "nothing of it is tracked yet" in text
    assert "data:video/mp4" in text
    assert 'id="review"' not in text


def test_a_recording_without_cloth_is_refused(clouds_only, tmp_path):
    with pytest.raises(InvalidRecordingError, match="no cloth was found in any frame"):
        write_recording_page(replace(clouds_only), tmp_path / "r.html", observer=lambda *_: None)


def test_a_mesh_has_a_page(tracked, tmp_path):
    path = write_mesh_page(tracked.mesh, "<towel>.obj", tmp_path / "m.html")
    text = path.read_text(encoding="utf-8")
    assert "<h1>&lt;towel&gt;.obj</h1>" in text
    assert "30.0 by 30.0 by 0.0" in text


def test_an_index_links_what_there_is(tmp_path):
    entries = [
        IndexEntry("a & b", tmp_path / "a & b.html", "6 frames", "1 accepted"),
        IndexEntry("c", None, "no report: <broken>"),
    ]
    text = write_index(entries, "all", tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'<a href="([^"]*)">([^<]*)</a>', text) == [("a%20%26%20b.html", "a &amp; b")]
    assert "no report: &lt;broken&gt;" in text
    assert "<script" not in text
