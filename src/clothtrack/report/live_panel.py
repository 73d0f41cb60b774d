"""The written parts of a live page's panel: legend, labels, curves, calibration, keys."""

from collections.abc import Sequence
from html import escape

import numpy as np
import viser
from jaxtyping import Float

from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.evaluation.label_review import LabelReview
from clothtrack.report.coloring import Coloring
from clothtrack.report.measures import charts
from clothtrack.report.palette import HIDDEN, OUTSIDE
from clothtrack.report.sections import calibration_html
from clothtrack.report.stage import KEYS, quality_words, scale_legend, sides_legend, swatch
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

TONES = ("#3b6ea5", "#d9923b", "#8b6fa8")
CURVES_SHOWN = 3

STYLE = """<style>
.ct { font-size: 0.8rem; padding: 0 0.75em 0.5em; opacity: 0.9; }
.ct.told { font-size: 0.9rem; padding-top: 0.5em; }
.ct table { width: 100%; border-collapse: collapse; }
.ct td, .ct th { padding: 0.1em 0.4em; text-align: left; font-weight: 400; }
.ct .current { outline: 1px solid #8a8f99; border-radius: 4px; }
.ct .accepted { color: #2e9d5f; font-weight: 600; }
.ct .rejected { color: #d0493a; font-weight: 600; }
.ct .swatch { display: inline-block; width: 10px; height: 10px; border-radius: 3px; }
.ct .swatch { margin: 0 4px 0 8px; }
.ct .ramp { display: inline-block; width: 72px; height: 9px; border-radius: 3px; }
.ct kbd { border: 1px solid #9a9da5; border-radius: 4px; padding: 0 4px; }
.ct svg { width: 100%; } .ct circle.rest { fill: #8a8f99; opacity: 0.55; }
.ct circle.best { fill: #d0493a; } .ct .grid { stroke: #9a9da5; stroke-width: 0.5; }
.ct .tick { fill: #8a8f99; font-size: 20px; }
</style>"""

# viser moves its camera with A and the arrows. What this page does with them must not reach that
# listener: the keys are taken at the window and given to viser's commands alone, which listen at
# the root element. A script element would not run here; an image that fails does.
_TAKE_KEYS = """
if (!window.clothtrackKeys) {
  window.clothtrackKeys = true;
  window.addEventListener('keydown', (event) => {
    const keys = ['a', 'r', 'o', 'u', 'ArrowLeft', 'ArrowRight', 'ArrowUp', 'ArrowDown'];
    if (!event.isTrusted || event.ctrlKey || event.metaKey || event.altKey) return;
    if (!keys.includes(event.key) || event.target.closest?.('input, textarea, select')) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    const again = { key: event.key, code: event.code, bubbles: false };
    document.documentElement.dispatchEvent(new KeyboardEvent('keydown', again));
  }, true);
}
"""

KEY_HOOK = (
    f'{STYLE}<div class="ct">{KEYS}'
    f'<img alt="" src="data:," style="display:none" onerror="{escape(_TAKE_KEYS, quote=True)}">'
    "</div>"
)


def legend_html(coloring: Coloring | None, *, visibility: bool) -> str:
    """What the colours mean; the sides' where there is no graded colouring."""
    if coloring is not None:
        told = f"{scale_legend(coloring)}<br>{escape(coloring.note)}"
    elif visibility:
        told = swatch(OUTSIDE, "visible") + swatch(HIDDEN, "hidden, believed")
    else:
        told = sides_legend()
    return f'{STYLE}<div class="ct">{told}</div>'


def review_html(review: LabelReview, judged: Sequence[LabelQuality], current: int | None) -> str:
    """Every label, what is expected of it, and what was decided."""
    rows = "".join(
        f'<tr class="{"current" if one.action == current else ""}"><th>Label {one.action + 1}</th>'
        f"<td>frame {one.frame}</td>"
        f"<td>{escape(quality_words(judged[one.action]) if judged else 'not judged')}</td>"
        f'<td class="verdict {one.verdict}">{one.verdict}</td></tr>'
        for one in review.labels
    )
    return f'{STYLE}<div class="ct"><table><tbody>{rows}</tbody></table></div>'


def add_curves(
    gui: viser.GuiApi, tracked: TrackedTrajectory, rms_mm: Float[np.ndarray, " frames"]
) -> None:
    """The report's charts; the most telling ones open."""
    if len(tracked.frames) < 2:
        return
    drawn = charts(tracked, rms_mm)
    frames = tracked.frames.astype(np.float64)
    for title, part, opened in (
        ("Curves", drawn[:CURVES_SHOWN], True),
        ("More curves", drawn[CURVES_SHOWN:], False),
    ):
        with gui.add_folder(title, expand_by_default=opened):
            for chart in part:
                series = [
                    {"label": line.label or chart.title, "stroke": TONES[line.tone], "width": 1.5}
                    for line in chart.lines
                ]
                gui.add_uplot(
                    (frames, *(np.asarray(line.values, np.float64) for line in chart.lines)),
                    ({"label": "frame"}, *series),
                    title=f"{chart.title} [{chart.unit}]" if chart.unit else chart.title,
                    scales={"x": {"time": False}, "y": {"distr": 3 if chart.logarithmic else 1}},
                    aspect=1.9,
                )


def add_calibrations(gui: viser.GuiApi, tracked: TrackedTrajectory) -> None:
    """The scores of the parameters that were tried, per action."""
    if not tracked.actions:
        return
    with gui.add_folder("Calibration", expand_by_default=False):
        for number, action in enumerate(tracked.actions, 1):
            parameters = ", ".join(
                f"{name.replace('_', ' ')} {value:.3g}" for name, value in action.parameters.items()
            )
            gui.add_html(
                f'{STYLE}<div class="ct"><b>Action {number}</b> {escape(parameters)}'
                f"{calibration_html(action.calibration)}</div>"
            )
