import json
import re
from dataclasses import replace
from html import unescape
from itertools import pairwise

import pytest

from clothtrack.evaluation.label_review import LabelReview
from clothtrack.report.overlay import OverlayConfig
from clothtrack.report.page import ReportConfig, evenly, write_report
from clothtrack.tracking.tracked_trajectory import StepRecords

SMALL = ReportConfig(overlay=OverlayConfig(height=120))


@pytest.fixture(scope="module")
def page(tracked, two_cameras, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "fold.html"
    assert write_report(tracked, two_cameras, path, config=SMALL) == path
    return path.read_text(encoding="utf-8")


def test_nothing_in_the_page_points_outside(page):
    markup = re.sub(r"(?s)<script.*?</script>", "", page)
    sources = re.findall(r"(?<![\w-])(?:src|href|action|poster)\s*=\s*[\"']([^\"']{0,40})", markup)
    assert sources
    assert all(source.startswith(("data:", "#frame=")) for source in sources)
    assert not re.search(r"url\(\s*[\"']?(?!data:)(?:https?:)?//", markup)
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page).group(1)
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    assert "eval" not in policy
    assert "*" not in policy


def test_the_name_cannot_break_out_of_the_page(page):
    assert "<h1>fold &lt;in&gt; half</h1>" in page


def test_decisions_so_far_are_in_the_page(tracked, two_cameras, tmp_path):
    review = LabelReview.blank(tracked).decided(1, "rejected")
    path = write_report(tracked, two_cameras, tmp_path / "p.html", config=SMALL, review=review)
    found = re.search(r'data-review="([^"]+)"', path.read_text(encoding="utf-8")).group(1)
    assert json.loads(unescape(found)) == review.as_document()


def test_the_frames_of_labels_are_never_thinned_out(tracked, clouds_only, tmp_path):
    ends = [1, 4]
    actions = [
        replace(action, last_frame=end) for action, end in zip(tracked.actions, ends, strict=True)
    ]
    moved = replace(tracked, actions=tuple(actions))
    config = ReportConfig(video_frames=3, scene_vertices=3 * 169, overlay=SMALL.overlay)
    page = write_report(moved, clouds_only, tmp_path / "kept.html", config=config)
    assert page.read_text(encoding="utf-8").count('data-frames="[0, 1, 4, 5]"') == 1
    kept = evenly(2000, 180, always=[7, 1003])
    assert {0, 7, 1003, 1999} <= set(kept)
    assert 170 < len(kept) <= 180
    assert max(b - a for a, b in pairwise(kept)) < 15


def test_one_frame_without_actions_or_observation_is_a_page(tracked, clouds_only, tmp_path):
    single = replace(
        tracked,
        frames=tracked.frames[:1],
        time_s=tracked.time_s[:1],
        positions=tracked.positions[:1],
        visible=tracked.visible[:1],
        actions=(),
        steps=StepRecords.empty(1),
    )
    path = write_report(
        single,
        replace(clouds_only, frames=tuple(replace(one, cloud=None) for one in clouds_only.frames)),
        tmp_path / "one.html",
        config=SMALL,
    )
    assert "no action" in path.read_text(encoding="utf-8")
