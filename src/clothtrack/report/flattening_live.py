"""A page on this machine that shows a flattening episode while it happens."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from clothtrack.planning.flattening import Step, Watch
from clothtrack.report.evidence import observed_points, thinned
from clothtrack.report.palette import HIDDEN, OBSERVED, OUTSIDE, PICKER_CLOSED, rgb255
from clothtrack.report.scene import local_server

POINTS = 20_000
_NOTHING = np.full((1, 3), -1e3)


@contextmanager
def watched_live(port: int | None = None) -> Iterator[Watch]:
    """Serve a page on 127.0.0.1 and give what has to be called after every step.

    Shown are the seen points, the belief (a second one in another hue), and the next action.
    """
    with local_server(port) as server:
        words = server.gui.add_markdown("waiting for the first picture")
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/table", 1.0, 1.0, cell_size=0.1)
        server.initial_camera.position = (0.0, -0.5, 0.6)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        cloud = server.scene.add_point_cloud(
            "/observed", _NOTHING, rgb255(OBSERVED), point_size=0.002
        )

        def show(step: Step) -> None:
            points = thinned(observed_points(step.recording, step.recording.frames[-1]), POINTS)
            cloud.points = points if len(points) else _NOTHING
            for number, color in enumerate((OUTSIDE, HIDDEN)):
                if number < len(step.estimates):
                    one = step.estimates[number]
                    server.scene.add_mesh_simple(
                        f"/belief/{number}", one.positions.astype(np.float32),
                        one.flat.faces.astype(np.uint32), color=rgb255(color), side="double",
                        opacity=0.9 if number == 0 else 0.4,
                    )  # fmt: skip
            action = None if step.decision is None else step.decision.action
            way = np.repeat(_NOTHING, 2, axis=0) if action is None else np.stack(
                [action.pick, action.place]
            )  # fmt: skip
            server.scene.add_spline_catmull_rom(
                "/action", way, color=rgb255(PICKER_CLOSED), thickness=6.0, thickness_units="screen"
            )
            flat = step.row["flat_m2"]
            share = f"{100 * step.row['seen_m2'] / flat:.0f} % of flat" if flat else ""
            sources = ", ".join(step.row["sources"])
            words.content = f"after {step.number} actions: {share}\n\n{sources}"

        yield show
