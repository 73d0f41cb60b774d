"""The upper part of a page: video, 3D scene, and their common time bar."""

import base64
import json
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from clothtrack.report.coloring import Coloring
from clothtrack.report.palette import HEAT, HIDDEN, INSIDE, OUTSIDE, UNKNOWN, hexadecimal
from clothtrack.report.scene_data import SceneContents, packed

LARGEST_GAP_M = 0.04
"""Largest distance between separated layers [m]; above it, a shirt is unrecognizable."""

_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)

_APART_HELP = (
    "Lifts each vertex by the number of layers under it. Only the drawing changes: it shows what "
    "lies between layers. Page up and Page down move it, too."
)


def stage(
    cards: Iterable[str],
    frames: Sequence[int],
    times_s: Sequence[float],
    *,
    wide: bool = False,
    actions: Sequence[tuple[int, int]] = (),
) -> str:
    """Return cards side by side or, if `wide`, below each other, with a time bar under them.

    `actions` are (first, last) frames; each is a band on the bar with a mark at its end, the frame
    of its label.
    """
    bar = ""
    if len(frames) > 1:
        speeds = "".join(
            f'<option value="{speed}"{" selected" if speed == 1 else ""}>{speed:g} x</option>'
            for speed in _SPEEDS
        )
        bar = (
            '<div class="clock"><button id="play" type="button" title="Space">Play</button>'
            f'<div class="track"><div class="marks">{_marks(frames, actions)}</div>'
            f'<input id="time" type="range" aria-label="Frame" min="0" max="{len(frames) - 1}" '
            'step="1" value="0"></div><label title="Speed of playing; 1 x is the speed of the '
            f'recording"><select id="speed" aria-label="Speed">{speeds}</select></label>'
            '<output id="told" title="Number of the frame in the recording, and its time. The '
            'address of this page leads to the frame that is shown."></output></div>'
        )
    seconds = [round(float(time), 4) for time in times_s]
    return (
        f'<div class="stage{" wide" if wide else ""}" data-frames="{list(frames)}" '
        f'data-times="{seconds}">{"".join(cards)}</div>{bar}'
    )


def _marks(frames: Sequence[int], actions: Sequence[tuple[int, int]]) -> str:
    """Return bands and marks on the time bar, placed in per cent of its length."""
    numbers = np.asarray(frames)

    def place(frame: int) -> float:
        return 100.0 * int(np.abs(numbers - frame).argmin()) / (len(frames) - 1)

    parts = []
    for number, (first, last) in enumerate(actions):
        left, right = place(first), place(last)
        words = f"Action {number + 1}, frames {first} to {last}"
        parts.append(
            f'<i class="band" style="left:{left:.2f}%;width:{right - left:.2f}%" '
            f'title="{words}"></i>'
        )
    for number, (_, last) in enumerate(actions):
        parts.append(
            f'<button type="button" class="flag" data-mark="{number}" tabindex="-1" '
            f'style="left:{place(last):.2f}%" title="Label {number + 1}, frame {last}" '
            f'aria-label="Label {number + 1}"></button>'
        )
    return "".join(parts)


@dataclass(frozen=True)
class Pictures:
    """Contents of a page's video.

    Attributes:
        write: function that writes the video to a file and returns its frames per second.
        size: width and height of the displayed part [pixels].
        parts: names of the parts stacked vertically in the video; one of them is displayed.
    """

    frames: Sequence[int]
    write: Callable[[Path], float]
    size: tuple[int, int]
    parts: Sequence[str] = ("Picture",)
    words: Sequence[str] = ()
    words_title: str = ""


def video_card(title: str, legend: str, pictures: Pictures) -> str:
    """Return an embedded video, with a switch if it has several parts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        rate = pictures.write(path)
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    (width, height), parts = pictures.size, pictures.parts
    switch = "".join(
        f'<button type="button" data-part="{number}" aria-pressed="{str(not number).lower()}" '
        f'title="Key v changes between them">{escape(part)}</button>'
        for number, part in enumerate(parts)
    )
    switch = f'<span class="switch">{switch}</span>' if len(parts) > 1 else ""
    words = escape(json.dumps(list(pictures.words)), quote=True)
    return (
        f'<section class="card film"><header><b>{escape(title)}</b>{legend}</header>'
        f'<div class="picture" style="--aspect:{width / height:.5f};--parts:{len(parts)}">'
        f'<video muted playsinline preload="auto" data-rate="{rate:.6g}" '
        f'data-frames="{list(pictures.frames)}" src="data:video/mp4;base64,{data}"></video></div>'
        f'<div class="controls">{switch}<span class="words" data-words="{words}" '
        f'title="{escape(pictures.words_title, quote=True)}"></span></div></section>'
    )


def scene_card(contents: SceneContents) -> str:
    """Return the interactive 3D scene, with its colorings and controls."""
    header, data = packed(contents)
    modes = _modes(contents)
    options = "".join(
        f'<option value="{key}" data-note="{escape(note, quote=True)}">{escape(title)}</option>'
        for key, title, note, _ in modes
    )
    legends = "".join(f'<template data-mode="{key}">{text}</template>' for key, *_, text in modes)
    return (
        '<section class="card scene"><header><b>In space</b><span class="meaning"></span></header>'
        '<div class="picture"><canvas tabindex="0" role="application" aria-label="Scene in three '
        "dimensions; shift and arrow keys turn it, plus and minus come nearer, 0 returns"
        '"></canvas><div class="hover" hidden></div></div>'
        '<p class="no-webgl note" hidden>This browser shows no WebGL 2; the pictures need none.</p>'
        f'<div class="controls">{_switches(contents, options)}<p class="note"></p></div>'
        f"{legends}"
        f'<script type="application/json" class="scene-header">{_inline(header)}</script>'
        f'<script type="text/plain" class="scene-data">{data}</script></section>'
    )


def _modes(contents: SceneContents) -> list[tuple[str, str, str, str]]:
    """Return the color modes of the cloth: key, title, note, legend."""
    modes = []
    if len(contents.faces):
        modes.append(("sides", "outer and inner side", "", _sides_legend()))
    if contents.visible is not None:
        legend = swatch(OUTSIDE, "visible") + swatch(HIDDEN, "hidden, believed")
        modes.append(("visible", "visible and hidden", "", legend))
    if contents.film is not None:
        note = "The mean color of each vertex in the frames that show it."
        modes.append(("film", "colors of the film", note, ""))
    return modes + [(o.key, o.title, o.note, _scale_legend(o)) for o in contents.colorings]


def _switches(contents: SceneContents, options: str) -> str:
    """Return the controls of a scene for which there is data."""
    cloth = len(contents.faces) > 0
    views = "".join(
        f'<option value="{number}">from camera {escape(view.camera.name)}</option>'
        for number, view in enumerate(contents.views)
    )
    parts = []
    if cloth:
        parts.append(f'<label>Colors <select name="mode">{options}</select></label>')
    if views:
        parts.append(
            '<label title="Key c changes between them">View <select name="view">'
            f'<option value="">free</option>{views}</select></label>'
        )
    if cloth:
        parts.append(
            '<label title="The cloth becomes transparent: what lies under it is seen through it">'
            'Opacity <input type="range" name="opacity" min="0.15" max="1" step="0.05" value="1">'
            f'</label><label title="{_APART_HELP}">Layers apart <input type="range" name="gap" '
            f'min="0" max="{LARGEST_GAP_M}" step="0.001" value="0"></label>'
        )
    if contents.clouds:
        words = "What the cameras measured of the cloth in this frame"
        parts.append(_check("cloud", "observed points", words))
    if contents.pickers and len(contents.frames) > 1:
        words = "The way of the tip: red while it holds, faint where it goes later"
        parts.append(_check("path", "picker's path", words))
    if cloth:
        parts.append(_check("lines", "mesh lines", "The edges of the triangles", checked=False))
    parts.append(
        '<span class="tools"><button type="button" id="home" title="Key 0 in the scene; a double '
        'click does it too">Fit</button> <button type="button" id="shot" title="Save the scene as '
        'it is shown as PNG">PNG</button>'
    )
    if cloth:
        parts.append(
            ' <button type="button" id="ply" title="Save the mesh of this frame with its colors '
            'as PLY">PLY</button>'
        )
    parts.append(
        ' <button type="button" id="full" title="The scene on the whole screen; Escape returns">'
        "Full screen</button></span>"
    )
    return "".join(parts)


def swatch(color: tuple[float, float, float], words: str) -> str:
    """Return a color swatch with its meaning."""
    return f'<i class="swatch" style="background:{hexadecimal(color)}"></i>{escape(words)}'


def _sides_legend() -> str:
    """Return the legend of the two sides."""
    return swatch(OUTSIDE, "outer side") + swatch(INSIDE, "inner side")


def _scale_legend(coloring: Coloring) -> str:
    """Return the legend of a graded coloring."""
    stops = ", ".join(hexadecimal(tuple(stop)) for stop in HEAT.tolist())
    return (
        f'&ensp;0 <i class="ramp" style="background:linear-gradient(90deg, {stops})"></i> '
        f"{coloring.limit:g}+ mm{swatch(UNKNOWN, 'not known')}"
    )


def _check(name: str, words: str, title: str, *, checked: bool = True) -> str:
    state = " checked" if checked else ""
    return (
        f'<label title="{escape(title, quote=True)}"><input type="checkbox" name="{name}"{state}> '
        f"{escape(words)}</label>"
    )


def _inline(text: str) -> str:
    """Return JSON escaped so that it cannot end its script element."""
    return text.replace("<", "\\u003c")
