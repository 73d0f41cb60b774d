"""What a notebook shows of a public object is short: a line or a few, or a small table."""

import inspect
import re
import sys
from dataclasses import fields, is_dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import clothtrack as ct
import clothtrack_capture as capture
import clothtrack_lab as lab
from clothtrack.api import reconstructed_mesh  # noqa: F401
from clothtrack.evaluation.verdict import Verdict
from clothtrack_capture.importing import import_report  # noqa: F401

FRONTS = (ct, capture, lab)


def public_dataclasses():
    """The dataclasses among the public names, and those that public functions return."""
    public = [getattr(front, name) for front in FRONTS for name in front.__all__]
    returned = {
        word
        for one in public
        if inspect.isfunction(one)
        for word in re.findall(r"\w+", str(inspect.signature(one).return_annotation))
    }
    ours = [one for name, one in list(sys.modules.items()) if name.startswith("clothtrack")]
    some = {one for module in ours for one in vars(module).values() if inspect.isclass(one)}
    found = {one for one in some if one in public or one.__name__ in returned} | {Verdict}
    return sorted(filter(is_dataclass, found), key=lambda one: one.__name__)


def large(kind, annotation):
    """A value of a field that would fill a screen."""
    words = str(annotation)
    axes = re.search(r"ndarray, '([^']*)'", words)
    sizes = [int(axis) if axis.isdigit() else 60 for axis in axes[1].split()] if axes else []
    inner = np.zeros(sizes) if axes else "a long line of text"
    if "Mapping" in words or "dict" in words:
        return {str(number): inner for number in range(100)}
    if "tuple" in words or "Sequence" in words:
        return (inner,) * 100
    if axes:
        return inner
    known = {"float": 1.0, "int": 7, "str": "many\nlines" * 9, "bool": True, "Path": Path("a")}
    return next((value for name, value in known.items() if name in words), None)


@pytest.mark.parametrize("kind", public_dataclasses(), ids=lambda kind: kind.__name__)
def test_a_public_object_is_shown_in_at_most_five_lines(kind):
    filled = object.__new__(kind)
    vars(filled).update({one.name: large(kind, one.type) for one in fields(kind)})
    if kind is ct.Recording:
        frame = ct.read_recording(ct.shipped_recording()).frames[0]
        vars(filled).update(folder=Path("a"), frames=(frame,) * 5000, cloth=ct.ClothDescription())
        vars(filled).update(cameras=())
    assert repr(filled).count("\n") < 5
    assert repr(filled).startswith(f"{kind.__name__}(")


def test_the_results_of_a_real_run_are_short(run, recording):
    things = (run, run.labels[0], run.actions[0], run.steps, run.verdict, recording)
    more = (ct.evaluate(run), ct.judge_labels(run, recording), ct.inspect_recording(recording))
    for thing in (*things, recording.frames[0], ct.observe(recording, recording.frames[0]), *more):
        assert len(repr(thing)) < 500
        assert "\n" not in repr(thing)


class Cells(HTMLParser):
    """The texts of a table."""

    def __init__(self):
        super().__init__()
        self.texts, self.tags = [], set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)

    def handle_data(self, data):
        self.texts.append(data)


def test_a_notebook_shows_small_tables_with_escaped_text(run, recording):
    evil = "<script>alert(1)</script>"
    shown = {
        "Run": replace(run, name=evil),
        "Recording": replace(recording, folder=Path("<script>alert(1)<script>")),
        "Verdict": replace(run.verdict, reason=evil),
    }
    for name, thing in shown.items():
        cells = Cells()
        cells.feed(thing._repr_html_())
        assert cells.tags == {"table", "caption", "tr", "th", "td"}, name
        assert "<script>" in " ".join(cells.texts)
        assert len(cells.texts) < 60
    assert str(run.verdict) in texts_of(run)
    assert "top 320 x 240" in texts_of(recording)


def texts_of(thing):
    cells = Cells()
    cells.feed(thing._repr_html_())
    return cells.texts
