"""One offline page per flattening episode: pictures with the next action's arrow, and the curve.

An episode with a control is labeled as such at the top, in the title and at each perceived mesh.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.arrows import draw_action, shown_depth
from clothtrack.planning.episode_store import EpisodeStore
from clothtrack.planning.flattening import Watch, improvement
from clothtrack.planning.perception import Estimate
from clothtrack.planning.planner import Decision
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.report.document import write_document
from clothtrack.report.lettering import Picture
from clothtrack.report.live import live_page
from clothtrack.report.sections import Figure, key_figures, stills_html
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.report.viewpoint import three_quarter_view

CONTROL = "control, not a result"
FAREWELL_S = 1.5
"""Time that an open page has to load the last version [s]; it checks every second."""


def write_flattening_report(
    store: EpisodeStore, path: Path, *, coming: PickPlace | None = None
) -> Path:
    """Write the page of an episode and return its path."""
    label, config = store.document["asked"]["label"], store.document["asked"]["config"]
    control = f" ({CONTROL})" if label["control"] else ""
    cards = "".join(_card(store, number, coming) for number in range(len(store.steps)))
    method = f"policy {config['policy']}, perception {label['perception']}{control}" + (
        f", dynamics {config['dynamics']}" if config["policy"] == "planned" else ""
    )
    status = f"ended: {store.document['status']}" if store.finished else "running"
    lead = f"{method}; {len(store.steps) - 1} actions; {status}"
    body = f"""<p class="lead">{escape(lead)}</p>
{key_figures(_figures(store))}
<h2>Coverage</h2>
<div class="charts">{_curve(store.steps)}</div>
<h2>Step by step</h2>
{cards}"""
    return write_document(path, f"{store.folder.name}{control}", body, script=False)


@contextmanager
def watched_live(
    port: int | None = None, *, opened: Callable[[str], None] | None = None
) -> Iterator[Watch]:
    """Serve the page of the running episode (`live_page`), and yield its step callback."""
    with live_page("flattening", port, opened=opened) as page, TemporaryDirectory() as folder:

        def show(store: EpisodeStore, decision: Decision | None) -> None:
            coming = None if decision is None else decision.action
            page.show(write_flattening_report(store, Path(folder) / "page.html", coming=coming))

        yield show
        # Wait until an open page has loaded the last step.
        time.sleep(FAREWELL_S)


def _figures(store: EpisodeStore) -> list[Figure]:
    """Return the key figures of an episode."""
    steps = store.steps
    key = "seen_m2" if steps[0]["true_m2"] is None else "true_m2"
    share = "Area that the cloth covers on the table, of what it covers when it is flat."
    figures = [Figure("Coverage at the end", _share(steps[-1]), "of the flat cloth", share)]
    if steps[0]["flat_m2"] is not None:
        gained = improvement(steps, key)[-1]
        where = "seen by the camera" if key == "seen_m2" else "true"
        gain = "Coverage gained, of what there was to gain: 1 is flat, 0 is nothing."
        figures.insert(0, Figure("Normalized improvement", f"{gained:.2f}", where, gain))
    decided = [row["decision_s"] + row["perception_s"] for row in steps[1:]]
    if decided:
        spent = "From the picture to the chosen action."
        figures.append(Figure("Per decision", f"{np.median(decided):.1f}", "s, median", spent))
    return figures


def _share(row: dict[str, Any]) -> str:
    """Return the coverage relative to the flat cloth, from the truth if it is known."""
    area = row["seen_m2"] if row["true_m2"] is None else row["true_m2"]
    return f"{100.0 * area / row['flat_m2']:.0f} %" if row["flat_m2"] else f"{1e4 * area:.0f} cm2"


def _curve(steps: Sequence[dict[str, Any]]) -> str:
    """Return a drawing of the coverage after each action: seen, and true if it is known."""
    flat = steps[0]["flat_m2"] or max(row["seen_m2"] for row in steps)
    width, height, left, low = 420, 190, 34, 160

    def column(number: int) -> str:
        return f"{left + (width - left - 10) * number / max(1, len(steps) - 1):.1f}"

    def height_of(share: float) -> float:
        return low - (low - 12) * min(share, 1.1)

    lines, keys = [], []
    for tone, (key, words) in enumerate((("true_m2", "true"), ("seen_m2", "seen"))):
        if steps[0][key] is None:
            continue
        points = " ".join(
            f"{column(k)},{height_of(row[key] / flat):.1f}" for k, row in enumerate(steps)
        )
        lines.append(f'<polyline class="line tone{tone}" points="{points}"/>')
        keys.append(f'<span class="key tone{tone}"><i></i>{words}</span>')
    marks = "".join(
        f'<line class="grid" x1="{left}" x2="{width}" y1="{y:.1f}" y2="{y:.1f}"/>'
        f'<text class="tick" x="2" y="{y + 4:.1f}">{share:.0%}</text>'
        for share, y in ((share, height_of(share)) for share in (0.0, 0.5, 1.0))
    )
    numbers = "".join(
        f'<text class="tick" x="{column(k)}" y="{low + 16}">{k}</text>' for k in range(len(steps))
    )
    return (
        f'<figure class="chart"><b>Share of the flat cloth\'s area, by action</b>'
        f'<svg viewBox="0 0 {width} {height}">{marks}{"".join(lines)}{numbers}</svg>'
        f'<div class="legend">{"".join(keys)}</div></figure>'
    )


def _card(store: EpisodeStore, number: int, coming: PickPlace | None) -> str:
    """Return the card of a step: picture, estimate, and predicted gain of the action before it."""
    row = store.steps[number]
    stills = [(_picture(store, number, coming), "What the camera saw, and the next action")]
    recording = read_recording(store.recording_path(number))
    if (belief := store.estimate(number)) is not None:
        stills.append((_belief(belief, recording), f"Believed: {belief.source}"))
    text = [f"coverage {_share(row)}"]
    if row["action"] is not None and number:
        before = store.steps[number - 1]
        key = "seen_m2" if row["true_m2"] is None else "true_m2"
        text.append(
            f"gain {1e4 * (row[key] - before[key]):+.0f} cm², "
            f"expected {1e4 * row['gain_m2']:+.0f} cm²"
        )
        if row["grasped"] is False:
            text.append("nothing was grasped")
    return (
        f'<article class="card action"><h3>After {number} action{"s" if number != 1 else ""}'
        f"<span>{escape('; '.join(text))}</span></h3>"
        f"{stills_html(stills)}</article>"
    )


def _picture(store: EpisodeStore, number: int, coming: PickPlace | None = None) -> Picture:
    """Return the last picture of a step, with the arrow of the action after it."""
    recording = read_recording(store.recording_path(number))
    frame = recording.frames[-1]
    camera = next(one for one in recording.cameras if one.name in frame.depth)
    if camera.name in frame.color:
        image = read_color(frame.color[camera.name])
    else:
        unit = recording.depth_units_m[camera.name]
        image = shown_depth(read_depth(frame.depth[camera.name], unit))
    if number + 1 < len(store.steps):
        row = store.steps[number + 1]["action"]
        coming = PickPlace(np.array(row["pick"]), np.array(row["place"]), row["lift_m"])
    return image if coming is None else draw_action(image, camera, coming)


def _belief(estimate: Estimate, recording: Recording) -> Picture:
    """Return a picture of the estimated mesh from the side and above."""
    view = three_quarter_view(estimate.positions, width=480, height=360)
    shader = Shader(
        estimate.flat.faces, view, table=recording.table, config=ShadingConfig(supersampling=2)
    )
    return shader.render(estimate.positions).image
