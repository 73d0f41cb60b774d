import base64
import gc
import re
import socket

import msgspec
import numpy as np
import pytest
import zstandard

from clothtrack.report.scene import LOOP_BACK, SceneConfig, local_server, scene_html


def unpacked(document):
    """The recorded messages of a viser document: (time, message) pairs and the binary buffers."""
    packed = re.search(r'__VISER_EMBED_DATA__="([^"]+)"', document).group(1)
    data = base64.b64decode(packed)
    data = zstandard.ZstdDecompressor().decompress(data[8:], int.from_bytes(data[:8], "little"))
    length = int.from_bytes(data[:8], "little")
    return msgspec.msgpack.decode(data[8 : 8 + length]), data[8 + length :]


@pytest.fixture(scope="module")
def document(tracked, clouds_only):
    clouds = [positions.astype(float) for positions in tracked.positions]
    return scene_html(tracked, clouds_only, clouds)


def test_the_time_bar_is_as_long_as_the_recording(document, tracked):
    recorded, _ = unpacked(document)
    expected = tracked.time_s[-1] + SceneConfig().last_frame_s
    assert recorded["durationSeconds"] == pytest.approx(expected)


@pytest.mark.parametrize("side", ["outside", "inside"])
def test_every_frame_moves_both_sides_of_the_cloth(document, tracked, side):
    recorded, _ = unpacked(document)
    times = [
        time
        for time, message in recorded["messages"]
        if message["type"] == "SceneNodeUpdateMessage"
        and message["name"] == f"/cloth/{side}"
        and "vertices" in message["updates"]
    ]
    np.testing.assert_allclose(times, tracked.time_s[1:], atol=1e-9)


def test_the_page_follows_light_and_dark(document):
    assert "{darkMode:matchMedia(" in document


# The server's event loop may end before it has seen its client go; what it then leaves is found
# here, and not in whatever test comes next.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
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
