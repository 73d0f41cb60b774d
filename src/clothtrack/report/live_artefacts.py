"""Live pages of what is not a tracked trajectory: a recording, a mesh."""

import threading

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Recording
from clothtrack.report.evidence import Observer, observed, observed_points, view_picture
from clothtrack.report.layers import Layers
from clothtrack.report.live import require_port, wait
from clothtrack.report.scene import ClothScene, ObservedScene, local_server
from clothtrack.report.stage import LARGEST_GAP_M
from clothtrack.report.viewpoint import three_quarter_view, upward, view_of

UP = np.array([0.0, 0.0, 1.0])
PICTURE_WIDTH = 480


def view_recording_live(
    recording: Recording,
    port: int | None = None,
    *,
    stop: threading.Event | None = None,
    observer: Observer = observed,
) -> None:
    """Serve a page on 127.0.0.1 with every frame's picture, observed cloth and pickers.

    Raises:
        InvalidConfigError: when there is no such port.
        InvalidRecordingError: the first frame shows no cloth.
    """
    require_port(port)
    points = observed_points(recording, recording.frames[0], observer)
    if not len(points):
        raise InvalidRecordingError(
            f"{recording.folder}: no cloth was found in the first frame; look with: "
            f"clothtrack inspect {recording.folder}"
        )
    eye = view_of(points, recording, width=800, height=600)
    camera = (recording.cameras[0] if recording.cameras else eye).resized(PICTURE_WIDTH)
    lock = threading.Lock()
    with local_server(port) as server:
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.set_panel_label(f"{recording.name} · clothtrack")
        gui.main_panel.dock_right()
        observed = ObservedScene(
            server,
            eye=eye,
            up=upward(recording, eye),
            points=points,
            pickers=recording.picker_paths,
            table=recording.table,
        )
        told = gui.add_markdown("")
        last = len(recording.frames) - 1
        slider = gui.add_slider("Frame", 0, max(1, last), 1, initial_value=0)
        picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), format="jpeg")

        def show() -> None:
            with lock:
                frame = recording.frames[min(int(slider.value), last)]
                seen = observed_points(recording, frame, observer)
                observed.observe(seen, frame.time_s)
                picture.image = view_picture(recording, frame, camera, seen)
                told.content = f"**frame {frame.index}**, {frame.time_s:.2f} s, {len(seen)} points"

        def go(way: int) -> None:
            slider.value = min(last, max(0, int(slider.value) + way))

        slider.on_update(lambda _: show())
        gui.add_command("Next frame", hotkey="N").on_trigger(lambda _: go(1))
        gui.add_command("Frame before", hotkey="P").on_trigger(lambda _: go(-1))
        show()
        wait(stop)


def view_mesh_live(
    mesh: ClothMesh,
    name: str,
    port: int | None = None,
    *,
    stop: threading.Event | None = None,
) -> None:
    """Serve a page on 127.0.0.1 with one mesh [m], z up.

    Raises:
        InvalidConfigError: when there is no such port.
    """
    require_port(port)
    vertices = np.asarray(mesh.vertices, np.float64)
    ranks = Layers(mesh, UP).ranks(vertices)
    with local_server(port) as server:
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label(f"{name} · clothtrack")
        eye = three_quarter_view(vertices, width=800, height=600)
        ObservedScene(server, eye=eye, up=UP, points=vertices, pickers={}, table=None)
        cloth = ClothScene(server, mesh)
        gui.add_markdown(f"{mesh.vertex_count:,} vertices, {len(mesh.faces):,} triangles")
        opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, initial_value=1.0)
        gap = gui.add_slider("Layers apart [m]", 0.0, LARGEST_GAP_M, 0.002, initial_value=0.0)

        def show() -> None:
            placed = vertices + gap.value * ranks[:, None] * UP
            cloth.show(placed, None, opacity=float(opacity.value))

        for control in (opacity, gap):
            control.on_update(lambda _: show())
        show()
        wait(stop)
