import gc
import socket

import numpy as np
import pytest

from clothtrack.report.coloring import Coloring
from clothtrack.report.scene import LOOP_BACK, TONES, ClothScene, face_paint, local_server

# The server's event loop may end before it has seen its client go; what it then leaves is found
# here, and not in whatever test comes next.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def graded(values, limit=10.0):
    return Coloring("x", "X [mm]", "", limit, np.asarray(values, np.float32))


def test_each_face_has_the_tone_of_its_value():
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4]])
    values = graded([[0.0, 0.0, 0.0, 99.0, np.nan]])
    assert face_paint(faces, values, 0).tolist() == [0, TONES - 1, TONES]


def test_every_face_is_shown_once_whatever_the_colours(tracked):
    faces = tracked.mesh.faces
    values = np.random.default_rng(0).uniform(0, 12, tracked.visible.shape)
    values[0, :40] = np.nan
    with local_server() as server:
        scene = ClothScene(server, tracked.mesh)
        paints = {
            "graded": face_paint(faces, graded(values), 0),
            "visible": (np.arange(len(faces)) % 2),
        }
        for group, paint in paints.items():
            scene.show(tracked.positions[1], paint, group=group)
            shown = [h for handles in scene._groups.values() for h in handles if h.visible]
            together = np.concatenate([handle.vertices[handle.faces] for handle in shown])
            expected = tracked.positions[1][faces]
            assert sorted(together.reshape(-1, 9).tolist()) == sorted(
                expected.reshape(-1, 9).tolist()
            )
            for handle in shown:  # no corner travels that no face of this paint has
                assert len(np.unique(handle.faces)) == len(handle.vertices)
        scene.show(tracked.positions[2], None, opacity=0.4)
        shown = [h for handles in scene._groups.values() for h in handles if h.visible]
        assert [(handle.side, handle.opacity) for handle in shown] == [
            ("front", 0.4),
            ("back", 0.4),
        ]
    gc.collect()


def test_the_server_is_local_quiet_and_gone(capfd):
    with local_server() as server:
        port = server.get_port()
        assert server.get_host() == LOOP_BACK
        with socket.create_connection((LOOP_BACK, port), timeout=5):
            pass
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((LOOP_BACK, port), timeout=5)
    assert capfd.readouterr().out == ""
    gc.collect()
