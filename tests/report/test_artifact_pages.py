import re
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.report.artifact_pages import (
    IndexEntry,
    summary_of,
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
    bare = tuple(replace(one, cloud=None) for one in clouds_only.frames)
    with pytest.raises(InvalidRecordingError, match="no cloth was found in any frame"):
        write_recording_page(replace(clouds_only, frames=bare), tmp_path / "r.html")


def test_a_mesh_is_colored_by_the_error_that_its_file_keeps(tracked, tmp_path):
    errors = np.linspace(0.0, 0.04, tracked.mesh.vertex_count)
    path = write_mesh_page(tracked.mesh, "m", tmp_path / "m.html", expected_error_m=errors)
    text = path.read_text(encoding="utf-8")
    assert '<option value="expected"' in text
    assert "20 <small>mm, mean</small>" in text


def test_an_index_begins_with_the_largest_expected_error(tracked, two_cameras, tmp_path):
    good = summary_of(tracked, two_cameras)
    assert good.thumbnail.startswith("data:image/jpeg;base64,")
    assert np.isfinite((good.expected_error_mm, good.rms_mm)).all()
    bad = replace(good, expected_error_mm=good.expected_error_mm + 5.0)
    unknown = replace(good, expected_error_mm=float("nan"))
    entries = [
        IndexEntry(name, None if name == "torn" else tmp_path / f"{name}.html", "", "", summary)
        for name, summary in (("torn", None), ("odd", unknown), ("good", good), ("bad", bad))
    ]
    text = write_index(entries, "all", tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.findall(r"<th>(?:<a[^>]*>)?(\w+)", text) == ["bad", "good", "odd", "torn"]
    assert text.count("data:image/jpeg") == 3
    assert f'data-word="{good.verdict.word}"' in text


def test_an_index_links_what_there_is(tmp_path):
    entries = [
        IndexEntry("a & b", tmp_path / "a & b.html", "6 frames", "1 accepted"),
        IndexEntry("c", None, "no report: <broken>"),
    ]
    text = write_index(entries, "all", tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'<a href="([^"]*)">([^<]*)</a>', text) == [("a%20%26%20b.html", "a &amp; b")]
    assert "no report: &lt;broken&gt;" in text
    assert "<script" not in text
