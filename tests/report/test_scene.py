import gc
import http.client
import socket

import numpy as np
import pytest
import viser
import websockets.asyncio.server
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from clothtrack.errors import InvalidConfigError
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


@pytest.fixture
def port():
    with local_server() as server:
        yield server.get_port()
    gc.collect()


def answer_to_get(port, headers):
    connection = http.client.HTTPConnection(LOOP_BACK, port, timeout=10)
    try:
        connection.request("GET", "/", headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


def answer_to_websocket(port, headers):
    """Over a real socket, as a browser asks: the status of the upgrade."""
    with socket.create_connection((LOOP_BACK, port), timeout=10) as raw:
        lines = {
            "Host": f"{LOOP_BACK}:{port}",
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
            **headers,
        }
        asked = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        raw.sendall(f"GET / HTTP/1.1\r\n{asked}\r\n".encode())
        return int(raw.makefile("rb").readline().split()[1])


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_a_live_page_may_ask_its_own_server(port, name):
    own = {"Host": f"{name}:{port}", "Origin": f"http://{name}:{port}"}
    assert answer_to_get(port, {}) == 200
    assert answer_to_get(port, own) == 200
    assert answer_to_websocket(port, {}) == 101
    assert answer_to_websocket(port, own) == 101


@pytest.mark.parametrize(
    "foreign",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1.evil.example:{port}"},
        {"Origin": "http://localhost:1"},
        {"Origin": "https://localhost:{port}"},
        {"Origin": "null"},
    ],
)
def test_another_web_site_can_neither_read_a_live_page_nor_press_its_buttons(port, foreign):
    headers = {name: value.format(port=port) for name, value in foreign.items()}
    assert answer_to_get(port, headers) == 403
    assert answer_to_websocket(port, headers) == 403
    assert answer_to_get(port, {}) == 200


def test_the_refusal_says_which_address_to_open(port):
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://{LOOP_BACK}:{port}", origin="http://evil.example")
    assert f"http://127.0.0.1:{port}/" in refused.value.response.body.decode()


def test_other_servers_of_the_process_are_left_as_they_are():
    before = websockets.asyncio.server.serve
    with local_server(), local_server():
        assert websockets.asyncio.server.serve is before
    gc.collect()


def test_a_viser_that_cannot_be_kept_to_its_own_page_is_not_served(monkeypatch):
    class Unguarded:
        def __init__(self, **options):
            self.stopped = False
            started.append(self)

        def stop(self):
            self.stopped = True

    started = []
    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    with pytest.raises(InvalidConfigError, match=r"viser .* install viser"), local_server():
        pass
    assert [one.stopped for one in started] == [True]
