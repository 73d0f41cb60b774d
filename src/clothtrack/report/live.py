"""A page on this machine to look through a tracked trajectory, frame by frame."""

import threading

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.recordings.recording import Recording
from clothtrack.report.evidence import CloudReader, observed_points
from clothtrack.report.palette import HIDDEN, rgb255
from clothtrack.report.scene import ClothScene, local_server
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

HIGHEST_PORT = 65_535


def view_live(
    tracked: TrackedTrajectory,
    recording: Recording,
    port: int | None = None,
    *,
    stop: threading.Event | None = None,
    cloud: CloudReader = observed_points,
) -> None:
    """Serve a page on 127.0.0.1 with a frame slider until `stop` is set or Ctrl-C is pressed.

    Outer and inner side have their colours, hidden vertices are dots in the hidden hue, and the
    cloth can be made transparent to see the layers inside. Without a `port` any free one is taken;
    the address is written to the log.

    Raises:
        InvalidConfigError: when there is no such port.
    """
    if port is not None and not 0 <= port <= HIGHEST_PORT:
        raise InvalidConfigError(
            f"port is {port}; choose one from 1024 to {HIGHEST_PORT}, or leave it out"
        )
    stop = stop or threading.Event()
    frames = {frame.index: frame for frame in recording.frames}
    with local_server(port) as server:
        scene = ClothScene(server, tracked, recording)
        hidden = server.scene.add_point_cloud(
            "/hidden", np.full((1, 3), -1e3), rgb255(HIDDEN), point_size=0.003
        )
        frame_slider = server.gui.add_slider("Frame", 0, len(tracked.frames) - 1, 1, 0)
        opacity = server.gui.add_slider("Opacity of the cloth", 0.1, 1.0, 0.05, 1.0)
        words = server.gui.add_markdown("")

        def show() -> None:
            step = int(frame_slider.value)
            index = int(tracked.frames[step])
            points = cloud(recording, frames[index]) if index in frames else np.empty((0, 3))
            scene.show(step, points)
            unseen = tracked.positions[step][~tracked.visible[step]]
            hidden.points = unseen if len(unseen) else np.full((1, 3), -1e3)
            words.content = f"frame {index}, {tracked.time_s[step]:.2f} s"

        frame_slider.on_update(lambda _: show())

        @opacity.on_update
        def fade(_: object) -> None:
            for side in scene.sides:
                side.opacity = None if opacity.value == 1.0 else opacity.value

        show()
        try:
            stop.wait()
        except KeyboardInterrupt:
            return
