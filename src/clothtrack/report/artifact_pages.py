"""Pages of other artifacts: a recording, a mesh, a folder of trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.evaluation.verdict import Verdict, verdict_of
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.from_picture import BOUND
from clothtrack.recordings.recording import Recording
from clothtrack.report.coloring import judged_or_none, vertex_errors
from clothtrack.report.document import write_document
from clothtrack.report.evidence import (
    mesh_distance_mm,
    observed,
    observed_points,
    thinned,
    view_picture,
)
from clothtrack.report.layers import Layers
from clothtrack.report.overlay import Overlay, OverlayConfig, whole_view
from clothtrack.report.page import evenly
from clothtrack.report.scene_data import SCENE_POINTS, SceneContents, recorded_scene
from clothtrack.report.sections import Figure, evidence_card, jpeg_uri, key_figures
from clothtrack.report.stage import Pictures, scene_card, stage, video_card
from clothtrack.report.video import frame_rate, write_video
from clothtrack.report.viewpoint import three_quarter_view, view_of
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

MOST_FRAMES = 360
_PICTURE_HEIGHT = 480
UP = np.array([0.0, 0.0, 1.0])

_THUMBNAIL_PX = 120
"""Height of the picture in an index [pixels]."""

_INDEX_COLUMNS = (
    ("", "The mesh over the picture at the last label"),
    ("report", "Name of the recording"),
    ("verdict", "Of the worst label: trust it, look at it, or reject it"),
    ("expected error", "Mean vertex error to expect of the worst label, without the truth"),
    ("distance", "Root mean square of visible mesh to observed points and back, at the last label"),
    ("labels", "What a person decided"),
)
"""Heading and explanation of each column of an index."""


@dataclass(frozen=True)
class TrajectorySummary:
    """Summary of one trajectory in an index.

    Attributes:
        thumbnail: the mesh over the picture at the last label, as a data URI.
        expected_error_mm: largest expected error of its labels [mm]; NaN if unknown.
        rms_mm: distance of visible mesh and observed points at the last label [mm]; NaN if unknown.
    """

    thumbnail: str
    verdict: Verdict
    expected_error_mm: float
    rms_mm: float


@dataclass(frozen=True)
class IndexEntry:
    """Row of an index.

    Attributes:
        page: its report, beside the index; None if there is none.
        description: description of the trajectory, or the reason for a missing report.
        summary: picture and verdict; None if there is no report.
    """

    name: str
    page: Path | None
    description: str
    verdicts: str = ""
    summary: TrajectorySummary | None = None


def write_recording_page(recording: Recording, path: Path) -> Path:
    """Write the page of an untracked recording, with pictures, observed cloth and pickers."""
    frames = [recording.frames[step] for step in evenly(len(recording.frames), MOST_FRAMES)]
    clouds = [thinned(observed_points(recording, frame), SCENE_POINTS) for frame in frames]
    points = np.concatenate([np.empty((0, 3)), *clouds])
    if not len(points):
        raise InvalidRecordingError(
            f"{recording.folder}: no cloth was found in any frame; look with: "
            f"clothtrack inspect {recording.folder}"
        )
    eye = view_of(points, recording, width=800, height=600)
    camera = recording.cameras[0] if recording.cameras else eye
    camera = camera.resized(round(camera.width * _PICTURE_HEIGHT / camera.height))
    views = [whole_view(camera)] if recording.cameras else []
    scene = recorded_scene(recording, frames, eye, clouds, views=views)

    def write(file: Path) -> float:
        rate = frame_rate(scene.time_s)
        pictures = (
            view_picture(recording, frame, camera, seen)
            for frame, seen in zip(frames, clouds, strict=True)
        )
        write_video(pictures, file, frames_per_second=rate)
        return rate

    numbers = scene.frames.tolist()
    pictures = Pictures(numbers, write, (camera.width, camera.height))
    cards = [video_card("What was recorded", "", pictures), scene_card(scene)]
    actions = [(action.first_frame, action.last_frame) for action in recording.actions]
    body = (
        '<p class="lead">A recording; nothing of it is tracked yet.</p>'
        f"{key_figures(_recorded(recording, clouds))}"
        f"{stage(cards, numbers, scene.time_s.tolist(), actions=actions)}"
    )
    return write_document(path, recording.name, body)


def _recorded(recording: Recording, clouds: Sequence[Float[np.ndarray, "_ 3"]]) -> list[Figure]:
    """Return the key figures of a recording."""
    frames, cameras = recording.frames, recording.cameras
    points = f"{np.median([len(one) for one in clouds]):.0f}"
    measured = (
        f"What is measured of the cloth, in cubes of 4 mm; at most {SCENE_POINTS} are kept here."
    )
    seconds = frames[-1].time_s - frames[0].time_s
    return [
        Figure("Frames", str(len(frames)), f"in {seconds:.1f} s", "All of the recording."),
        Figure("Cameras", str(len(cameras)), "", "Those that recording.json describes."),
        Figure("Actions", str(len(recording.actions)), "", "Each is one pick and place."),
        Figure("Points of cloth, median", points, "a frame", measured),
    ]


def write_mesh_page(
    mesh: ClothMesh,
    name: str,
    path: Path,
    *,
    expected_error_m: Float[np.ndarray, " vertices"] | None = None,
    verdict: Verdict | None = None,
) -> Path:
    """Write the page of one mesh [m], z up, colored by the expected error of each vertex.

    Args:
        expected_error_m: expected error of each vertex [m]; None if unknown.
    """
    vertices, errors = np.asarray(mesh.vertices, np.float64), expected_error_m
    scene = SceneContents(
        frames=np.zeros(1, np.int64),
        time_s=np.zeros(1),
        eye=three_quarter_view(vertices, width=800, height=600),
        up=UP,
        along=UP,
        positions=vertices[None],
        faces=np.asarray(mesh.faces, np.int64),
        ranks=Layers(mesh, UP).ranks(vertices)[None],
        colorings=[] if errors is None else [vertex_errors(errors)],
    )
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = " by ".join(f"{100 * side:.1f}" for side in high - low)
    figures = [
        Figure("Vertices", f"{mesh.vertex_count:,}", "", "Corners of the triangles."),
        Figure("Triangles", f"{len(mesh.faces):,}", "", "Faces of the mesh."),
        Figure("Size", size, "cm", "Along x, y and z."),
    ]
    if errors is not None:
        words = (
            "What the network expects: mean distance of a vertex from where it really is. Nine of "
            f"ten vertices lie within {BOUND:g} times theirs."
        )
        figures.append(Figure("Expected error", f"{1e3 * errors.mean():.0f}", "mm, mean", words))
    judged = "" if verdict is None else evidence_card(verdict, of="picture")
    body = f"{judged}{key_figures(figures)}{stage([scene_card(scene)], [0], [0.0], wide=True)}"
    return write_document(path, name, body)


def write_index(entries: Sequence[IndexEntry], title: str, path: Path) -> Path:
    """Write a page of links to many reports, the largest expected error first."""
    rows = "".join(_index_row(entry) for entry in sorted(entries, key=_by_expected_error))
    heads = "".join(
        f'<th title="{escape(help_, quote=True)}">{escape(words)}</th>'
        for words, help_ in _INDEX_COLUMNS
    )
    body = (
        f'<p class="lead">{len(entries)} tracked trajectories, the largest expected error first'
        f'</p><table class="index"><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>'
    )
    return write_document(path, title, body, script=False)


def _by_expected_error(entry: IndexEntry) -> tuple[bool, bool, float, str]:
    """Return the sort key: largest error first, then unknown errors, then missing reports."""
    error = float("nan") if entry.summary is None else entry.summary.expected_error_mm
    unknown = not np.isfinite(error)
    return entry.page is None, unknown, 0.0 if unknown else -error, entry.name


def _index_row(entry: IndexEntry) -> str:
    said = entry.summary
    if said is None:
        return (
            f'<tr><td></td><th>{_link(entry)}</th><td colspan="3">{escape(entry.description)}</td>'
            f"<td>{escape(entry.verdicts)}</td></tr>"
        )
    picture = f'<img alt="" src="{said.thumbnail}">'
    if entry.page is not None:
        picture = f'<a href="{quote(entry.page.name)}" tabindex="-1">{picture}</a>'
    numbers = [
        f"{value:.{digits}f}{unit}" if np.isfinite(value) else ""
        for value, digits, unit in (
            (said.expected_error_mm, 1, " mm"),
            (said.rms_mm, 1, " mm"),
        )
    ]
    cells = "".join(
        f'<td title="{escape(help_, quote=True)}">{number}</td>'
        for number, (_, help_) in zip(numbers, _INDEX_COLUMNS[3:5], strict=True)
    )
    return (
        f"<tr><td>{picture}</td><th>{_link(entry)}<small>{escape(entry.description)}</small></th>"
        f'<td><b class="word" data-word="{said.verdict.word}" '
        f'title="{escape(said.verdict.reason, quote=True)}">{said.verdict.word}</b> '
        f"<small>trusted up to {1e3 * said.verdict.trusted_up_to_m:.0f} mm</small></td>"
        f"{cells}<td>{escape(entry.verdicts)}</td></tr>"
    )


def _link(entry: IndexEntry) -> str:
    name = escape(entry.name)
    if entry.page is None:
        return name
    return f'<a href="{quote(entry.page.name)}">{name}</a>'


def summary_of(tracked: TrackedTrajectory, recording: Recording) -> TrajectorySummary:
    """Return the picture of a trajectory's last label, and the verdict on all labels."""
    last = tracked.actions[-1].last_frame if tracked.actions else int(tracked.frames[-1])
    step = int(np.abs(tracked.frames - last).argmin())
    config = OverlayConfig(height=2 * _THUMBNAIL_PX, cameras=1)
    overlay = Overlay(tracked, recording, config=config)
    picture = overlay.draw(step)
    width = round(picture.shape[1] * _THUMBNAIL_PX / picture.shape[0])
    small = cv2.resize(picture, (width, _THUMBNAIL_PX), interpolation=cv2.INTER_AREA)
    judged = judged_or_none(tracked, recording)
    verdict = verdict_of(tracked, recording, judged)
    observation = observed(recording, overlay.frame(step))
    return TrajectorySummary(
        jpeg_uri(small, quality=80),
        verdict,
        1e3 * verdict.expected_error_m,
        float("nan") if observation is None else mesh_distance_mm(tracked, step, observation),
    )
