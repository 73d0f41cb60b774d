"""Line charts over time in inline SVG; a page's script adds the cursor."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

WIDTH, HEIGHT = 420, 170
LEFT, RIGHT, TOP, BOTTOM = 46, 10, 8, 22


@dataclass(frozen=True, eq=False)
class Line:
    """Line of a chart.

    Attributes:
        label: name of the line; empty if the chart's title says it.
        values: one value per frame; NaN leaves a gap.
        tone: index of the page's line color, 0 the strongest.
    """

    label: str
    values: Float[np.ndarray, " frames"]
    tone: int = 0


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart over the frames of a trajectory.

    Attributes:
        note: one sentence of help under the title.
        least_top: least upper end of the vertical axis.
        marks: frames to mark with a cross at the bottom.
    """

    title: str
    unit: str
    lines: tuple[Line, ...]
    note: str = ""
    least_top: float = 0.0
    marks: tuple[int, ...] = ()
    marks_label: str = ""


def chart_html(
    chart: Chart, frames: Int[np.ndarray, " frames"], actions: Sequence[tuple[int, int]]
) -> str:
    """Return a figure element: title, legend with the values at the cursor, and the drawing.

    `actions` are (first, last) frames; they are drawn as bands.
    """
    axis = _axis(chart)
    data = {
        "frames": [int(frame) for frame in frames],
        "lines": [[_number(float(value)) for value in line.values] for line in chart.lines],
        "left": LEFT,
        "right": WIDTH - RIGHT,
    }
    legend = "".join(
        f'<span class="key tone{line.tone}" title="{escape(_help(chart, line), quote=True)}">'
        f'<i></i>{escape(line.label)} <b class="now"></b></span>'
        for line in chart.lines
    )
    if chart.marks:
        words = escape(f"Frames with a cross: {chart.marks_label}", quote=True)
        legend += (
            f'<span class="key mark" title="{words}"><i></i>{escape(chart.marks_label)}</span>'
        )
    unit = f' <span class="unit">{escape(chart.unit)}</span>' if chart.unit else ""
    note = f'<p class="note">{escape(chart.note)}</p>' if chart.note else ""
    return (
        f"<figure class='chart' data-chart='{escape(json.dumps(data), quote=True)}'>"
        f"<figcaption><h3>{escape(chart.title)}{unit}</h3>{note}"
        f'<div class="legend">{legend}</div></figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(chart.title)}">'
        f"{_bands(frames, actions)}{axis.drawn()}{_frame_ticks(frames)}"
        f"{''.join(_polyline(line, frames, axis) for line in chart.lines)}"
        f"{_crosses(chart, frames)}"
        f'<line class="cursor" x1="{LEFT}" x2="{LEFT}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>'
        "</svg></figure>"
    )


def _help(chart: Chart, line: Line) -> str:
    unit = f" [{chart.unit}]" if chart.unit else ""
    return f"{line.label or chart.title}{unit} in the frame that is shown. {chart.note}"


class _Axis(NamedTuple):
    """Vertical axis with its lowest and highest value."""

    low: float
    high: float

    def y(self, values: Float[np.ndarray, " values"]) -> Float[np.ndarray, " values"]:
        """Return the vertical positions of values in the drawing."""
        share = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)
        return TOP + (1.0 - share) * (HEIGHT - TOP - BOTTOM)

    def drawn(self) -> str:
        """Return horizontal lines with their values."""
        step = _round_step(self.high - self.low)
        ticks = np.arange(self.low, self.high + step / 2, step)
        names = [f"{tick:.6g}".replace("-", "\N{MINUS SIGN}") for tick in ticks]
        return "".join(
            f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text class="tick" x="{LEFT - 6}" y="{y + 3.5:.1f}" text-anchor="end">{name}</text>'
            for y, name in zip(self.y(ticks), names, strict=True)
        )


def _axis(chart: Chart) -> _Axis:
    """Return the axis that shows every finite value of a chart."""
    values = np.concatenate([np.ravel(line.values) for line in chart.lines]).astype(np.float64)
    values = values[np.isfinite(values)]
    low = min(0.0, float(values.min(initial=0.0)))
    high = max(float(values.max()) if len(values) else 0.0, chart.least_top)
    if high - low < 1e-9:
        high = low + 1.0
    step = _round_step(high - low)
    return _Axis(np.floor(low / step) * step, np.ceil(high / step - 1e-9) * step)


def _round_step(span: float) -> float:
    """Return a tick step of 1, 2 or 5 times a power of ten, with three to six ticks per span."""
    rough = span / 4
    power = 10.0 ** np.floor(np.log10(rough))
    return float(power * min((1, 2, 5, 10), key=lambda factor: abs(factor - rough / power)))


def _x(frames: Int[np.ndarray, " frames"], frame: int) -> float:
    """Return the horizontal position of a frame in the drawing."""
    first, last = int(frames[0]), int(frames[-1])
    return LEFT + (float(frame) - first) / max(1, last - first) * (WIDTH - LEFT - RIGHT)


def _bands(frames: Int[np.ndarray, " frames"], actions: Sequence[tuple[int, int]]) -> str:
    parts = []
    for first, last in actions:
        left, right = _x(frames, first), _x(frames, last)
        parts.append(
            f'<rect class="band" x="{left:.1f}" y="{TOP}" width="{max(1.0, right - left):.1f}" '
            f'height="{HEIGHT - TOP - BOTTOM}"/>'
        )
    return "".join(parts)


def _frame_ticks(frames: Int[np.ndarray, " frames"]) -> str:
    first, last = int(frames[0]), int(frames[-1])
    step = max(1, round(_round_step(float(max(1, last - first)))))
    ticks = [first, *range(first - first % step + step, last + 1, step)]
    return "".join(
        f'<text class="tick" x="{_x(frames, tick):.1f}" y="{HEIGHT - 7}" '
        f'text-anchor="middle">{tick}</text>'
        for tick in ticks
    )


def _polyline(line: Line, frames: Int[np.ndarray, " frames"], axis: _Axis) -> str:
    values = np.asarray(line.values, dtype=np.float64)
    fine = np.isfinite(values)
    x, y = [_x(frames, frame) for frame in frames.tolist()], axis.y(np.where(fine, values, 1.0))
    command, parts = "M", []
    alone = []
    for k in range(len(values)):
        if not fine[k]:
            command = "M"
            continue
        before, after = k > 0 and fine[k - 1], k + 1 < len(values) and fine[k + 1]
        if not before and not after:
            alone.append(f'<circle class="tone{line.tone}" cx="{x[k]:.1f}" cy="{y[k]:.1f}" r="2"/>')
        parts.append(f"{command}{x[k]:.1f} {y[k]:.1f}")
        command = "L"
    return f'<path class="line tone{line.tone}" d="{"".join(parts)}"/>' + "".join(alone)


def _crosses(chart: Chart, frames: Int[np.ndarray, " frames"]) -> str:
    y = HEIGHT - BOTTOM - 5
    return "".join(
        f'<path class="cross" d="M{x - 3:.1f} {y - 3}l6 6m0 -6l-6 6"><title>frame {frame}: '
        f"{escape(chart.marks_label)}</title></path>"
        for frame, x in ((frame, _x(frames, frame)) for frame in chart.marks)
    )


def _number(value: float) -> float | None:
    return float(f"{value:.4g}") if np.isfinite(value) else None
