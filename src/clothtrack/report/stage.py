"""The upper part of a page: video, scene in three dimensions, time bar, decisions about labels."""

import base64
import json
import tempfile
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.evaluation.label_review import REVIEW_SUFFIX, LabelReview
from clothtrack.report.coloring import Coloring
from clothtrack.report.palette import HEAT, HIDDEN, INSIDE, OUTSIDE, UNKNOWN, hexadecimal
from clothtrack.report.scene_data import SceneConfig, SceneContents, packed
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

LARGEST_GAP_M = 0.12
"""So far can layers be shown apart [m]."""

KEYS = (
    "Keys: <kbd>←</kbd> <kbd>→</kbd> frame by frame, <kbd>↑</kbd> <kbd>↓</kbd> label by label, "
    "<kbd>a</kbd> accept, <kbd>r</kbd> reject, <kbd>o</kbd> leave open the highlighted label and "
    "go to the next one, <kbd>u</kbd> undo the last decision."
)


def stage(
    cards: Iterable[str], frames: Sequence[int], times_s: Sequence[float], *, wide: bool = False
) -> str:
    """Cards side by side or, when one is `wide`, below each other, and a time bar under them."""
    bar = (
        '<div class="clock"><button id="play" type="button">Play</button>'
        f'<input id="time" type="range" aria-label="Frame" min="0" max="{len(frames) - 1}" '
        'step="1" value="0"><output id="told"></output></div>'
        if len(frames) > 1
        else ""
    )
    seconds = [round(float(time), 4) for time in times_s]
    return (
        f'<div class="stage{" wide" if wide else ""}" data-frames="{list(frames)}" '
        f'data-times="{seconds}">{"".join(cards)}</div>{bar}'
    )


def video_card(
    title: str,
    legend: str,
    frames: Sequence[int],
    write: Callable[[Path], float],
) -> str:
    """A video inside the page; `write` writes it to a file and returns its frames per second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        rate = write(path)
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<section class="card"><header><b>{escape(title)}</b>{legend}</header>'
        f'<video controls muted playsinline preload="auto" data-rate="{rate:.6g}" '
        f'data-frames="{list(frames)}" src="data:video/mp4;base64,{data}"></video></section>'
    )


def scene_card(contents: SceneContents, config: SceneConfig | None = None) -> str:
    """The scene that one can orbit, with what it can be coloured by and how layers come apart."""
    header, data = packed(contents, config)
    cloth = len(contents.faces) > 0
    modes = [("sides", "outer and inner side", "", sides_legend())] if cloth else []
    if contents.visible is not None:
        legend = swatch(OUTSIDE, "visible") + swatch(HIDDEN, "hidden, believed")
        modes.append(("visible", "visible and hidden", "", legend))
    modes += [(one.key, one.title, one.note, scale_legend(one)) for one in contents.colorings]
    options = "".join(
        f'<option value="{key}" data-note="{escape(note, quote=True)}">{escape(title)}</option>'
        for key, title, note, _ in modes
    )
    legends = "".join(f'<template data-mode="{key}">{text}</template>' for key, *_, text in modes)
    hidden = "" if cloth else " hidden"
    points = _check("cloud", "observed points") if contents.clouds else ""
    return (
        '<section class="card scene"><header><b>In space</b><span class="meaning"></span></header>'
        '<canvas tabindex="0" role="application" aria-label="Scene in three dimensions; shift and '
        'arrow keys turn it, plus and minus come nearer, 0 returns"></canvas>'
        '<p class="no-webgl note" hidden>This browser shows no WebGL 2; the pictures need none.</p>'
        f'<div class="controls"><label{hidden}>Colours <select name="mode">{options}</select>'
        f"</label><label{hidden}>Opacity <input type='range' name='opacity' min='0.15' max='1' "
        f"step='0.05' value='1'></label><label{hidden}>Layers apart <input type='range' "
        f"name='gap' min='0' max='{LARGEST_GAP_M}' step='0.002' value='0'></label>"
        f"{points}{_check('lines', 'mesh lines') if cloth else ''}"
        '<p class="note"></p></div>'
        f"{legends}"
        f'<script type="application/json" class="scene-header">{_inline(header)}</script>'
        f'<script type="text/plain" class="scene-data">{data}</script></section>'
    )


def review_card(
    tracked: TrackedTrajectory, review: LabelReview, judged: Sequence[LabelQuality]
) -> str:
    """Accept and reject for each label, and the file to put beside the trajectory."""
    if not review.labels:
        return ""
    rows = []
    for label, action in zip(review.labels, tracked.actions, strict=True):
        text = quality_words(judged[label.action]) if judged else "not judged"
        rows.append(
            f'<tr data-action="{label.action}" data-first="{action.first_frame}">'
            f'<th><button type="button" class="jump">Label {label.action + 1}</button></th>'
            f"<td>frame {label.frame}</td><td>{escape(text)}</td>"
            '<td class="verdict"></td><td>'
            '<button type="button" data-decide="accepted">Accept</button> '
            '<button type="button" data-decide="rejected">Reject</button> '
            '<button type="button" data-decide="open">Open</button></td></tr>'
        )
    document = escape(json.dumps(review.as_document()), quote=True)
    name = escape(tracked.name + REVIEW_SUFFIX, quote=True)
    return (
        f'<section id="review" class="card" data-review="{document}" data-file="{name}">'
        "<header><b>Labels</b> the mesh at the end of each action; "
        '<span class="left"></span></header>'
        f"<table><tbody>{''.join(rows)}</tbody></table>"
        f'<p class="note"><button type="button" id="undo">Undo</button> {KEYS}</p>'
        '<p class="note" data-when="served"><output id="saved"></output></p>'
        '<p class="note" data-when="opened"><button type="button" id="save">Save the '
        f"review</button> as {name}; put it beside {escape(tracked.name)}.zarr, and "
        "<code>clothtrack label</code> leaves out what is rejected.</p></section>"
    )


def quality_words(judged: LabelQuality) -> str:
    """What is expected of a label, without the truth."""
    if not np.isfinite(judged.expected_error_mm):
        return "nothing was seen to judge it by"
    return f"expected error {judged.expected_error_mm:.1f} mm, quality {judged.label_quality:.2f}"


def swatch(color: tuple[float, float, float], words: str) -> str:
    """A spot of colour and what it means."""
    return f'<i class="swatch" style="background:{hexadecimal(color)}"></i>{escape(words)}'


def sides_legend() -> str:
    """The colours of the two sides."""
    return swatch(OUTSIDE, "outer side") + swatch(INSIDE, "inner side")


def scale_legend(coloring: Coloring) -> str:
    """The scale of a graded colouring."""
    stops = ", ".join(hexadecimal(tuple(stop)) for stop in HEAT.tolist())
    return (
        f'&ensp;0 <i class="ramp" style="background:linear-gradient(90deg, {stops})"></i> '
        f"{coloring.limit:g}+ mm{swatch(UNKNOWN, 'not known')}"
    )


def _check(name: str, words: str) -> str:
    return f'<label><input type="checkbox" name="{name}" checked> {escape(words)}</label>'


def _inline(text: str) -> str:
    """JSON that cannot end the script element it lies in."""
    return text.replace("<", "\\u003c")
