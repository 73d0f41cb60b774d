"""Pages of what is not a tracked trajectory: a recording, a mesh, a folder of trajectories."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Recording
from clothtrack.report.document import write_document
from clothtrack.report.evidence import (
    Observer,
    observed,
    observed_points,
    thinned,
    view_picture,
)
from clothtrack.report.film_colors import cloud_colors
from clothtrack.report.layers import Layers
from clothtrack.report.overlay import whole_view
from clothtrack.report.page import evenly
from clothtrack.report.scene_data import SCENE_POINTS, SceneContents
from clothtrack.report.sections import Figure, key_figures
from clothtrack.report.stage import Pictures, scene_card, stage, video_card
from clothtrack.report.video import frame_rate, write_video
from clothtrack.report.viewpoint import layers_axis, three_quarter_view, upward, view_of

log = logging.getLogger(__name__)

MOST_FRAMES = 360
PICTURE_HEIGHT = 480
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class IndexEntry:
    """One line of an index.

    Attributes:
        name: of the trajectory.
        page: its report, beside the index; None where there is none.
        description: what is known of it: what was tracked, or why there is no report.
        verdicts: what a person decided about its labels.
    """

    name: str
    page: Path | None
    description: str
    verdicts: str = ""


def write_recording_page(
    recording: Recording, path: Path, *, observer: Observer = observed
) -> Path:
    """Write a page of what was recorded: pictures, observed cloth, pickers; nothing is tracked yet.

    Raises:
        InvalidRecordingError: no frame shows any cloth.
        StorageError: when the disk refuses.
    """
    steps = evenly(len(recording.frames), MOST_FRAMES)
    frames = [recording.frames[step] for step in steps]
    clouds = [
        thinned(observed_points(recording, frame, observer), SCENE_POINTS) for frame in frames
    ]
    points = np.concatenate([np.empty((0, 3)), *clouds])
    if not len(points):
        raise InvalidRecordingError(
            f"{recording.folder}: no cloth was found in any frame; look with: "
            f"clothtrack inspect {recording.folder}"
        )
    eye = view_of(points, recording, width=800, height=600)
    camera = recording.cameras[0] if recording.cameras else eye
    camera = camera.resized(round(camera.width * PICTURE_HEIGHT / camera.height))
    times = np.array([frame.time_s for frame in frames])
    numbers = [int(frame.index) for frame in frames]
    nothing = np.zeros((len(frames), 0, 3), np.float32)
    scene = SceneContents(
        frames=np.array(numbers),
        time_s=times,
        eye=eye,
        up=upward(recording, eye),
        along=layers_axis(recording, eye),
        positions=nothing,
        faces=np.zeros((0, 3), np.int64),
        ranks=nothing[..., 0],
        clouds=clouds,
        pickers=recording.picker_paths,
        table=recording.table,
        views=[whole_view(camera)] if recording.cameras else [],
        cloud_colors=cloud_colors(recording, frames, clouds),
    )

    def write(file: Path) -> float:
        rate = frame_rate(times)
        pictures = (
            view_picture(recording, frame, camera, seen)
            for frame, seen in zip(frames, clouds, strict=True)
        )
        write_video(pictures, file, frames_per_second=rate)
        return rate

    pictures = Pictures(numbers, write, (camera.width, camera.height))
    cards = [video_card("What was recorded", "", pictures), scene_card(scene)]
    actions = [(action.first_frame, action.last_frame) for action in recording.actions]
    figures = [
        Figure(
            "Frames",
            str(len(recording.frames)),
            f"in {times[-1] - times[0]:.1f} s",
            "All of the recording.",
        ),
        Figure("Cameras", str(len(recording.cameras)), "", "Those that recording.json describes."),
        Figure("Actions", str(len(recording.actions)), "", "Each is one pick and place."),
        Figure(
            "Points of cloth, median",
            f"{np.median([len(one) for one in clouds]):.0f}",
            "a frame",
            f"What is measured of the cloth, in cubes of 4 mm; at most {SCENE_POINTS} are kept "
            "here.",
        ),
    ]
    body = (
        '<p class="lead">A recording; nothing of it is tracked yet.</p>'
        f"{key_figures(figures)}{stage(cards, numbers, times.tolist(), actions=actions)}"
    )
    return write_document(path, recording.name, body)


def write_mesh_page(mesh: ClothMesh, name: str, path: Path) -> Path:
    """Write a page of one mesh [m], z up.

    Raises:
        StorageError: when the disk refuses.
    """
    vertices = np.asarray(mesh.vertices, np.float64)
    scene = mesh_scene(mesh)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = " by ".join(f"{100 * side:.1f}" for side in high - low)
    figures = [
        Figure("Vertices", f"{mesh.vertex_count:,}", "", "Corners of the triangles."),
        Figure("Triangles", f"{len(mesh.faces):,}", "", "Faces of the mesh."),
        Figure("Size", size, "cm", "Along x, y and z."),
    ]
    body = f"{key_figures(figures)}{stage([scene_card(scene)], [0], [0.0], wide=True)}"
    return write_document(path, name, body)


def mesh_scene(mesh: ClothMesh) -> SceneContents:
    """One mesh that does not move."""
    vertices = np.asarray(mesh.vertices, np.float64)
    return SceneContents(
        frames=np.zeros(1, np.int64),
        time_s=np.zeros(1),
        eye=three_quarter_view(vertices, width=800, height=600),
        up=UP,
        along=UP,
        positions=vertices[None],
        faces=np.asarray(mesh.faces, np.int64),
        ranks=Layers(mesh, UP).ranks(vertices)[None],
    )


def write_index(entries: Sequence[IndexEntry], title: str, path: Path) -> Path:
    """Write a page that links the reports of many trajectories.

    Raises:
        StorageError: when the disk refuses.
    """
    rows = "".join(
        f"<tr><th>{_link(entry)}</th><td>{escape(entry.description)}</td>"
        f"<td>{escape(entry.verdicts)}</td></tr>"
        for entry in entries
    )
    body = (
        f'<p class="lead">{len(entries)} tracked trajectories</p><table class="index"><thead><tr>'
        f"<th>report</th><th>tracked</th><th>labels</th></tr></thead><tbody>{rows}</tbody></table>"
    )
    return write_document(path, title, body, script=False)


def _link(entry: IndexEntry) -> str:
    name = escape(entry.name)
    if entry.page is None:
        return name
    return f'<a href="{quote(entry.page.name)}">{name}</a>'
