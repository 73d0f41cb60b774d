import base64
import json
import zlib

import numpy as np

from clothtrack.report.coloring import Coloring
from clothtrack.report.scene_data import RANK_STEPS, SceneContents, packed
from clothtrack.report.viewpoint import look_at


def contents(tracked, **changes):
    count = len(tracked.frames)
    values = np.linspace(0, 20, tracked.visible.size).reshape(tracked.visible.shape)
    values[0, 0] = np.nan
    given = {
        "frames": tracked.frames,
        "time_s": tracked.time_s,
        "eye": look_at(np.array([0.5, 0.0, 0.5]), np.zeros(3)),
        "up": np.array([0.0, 0.0, 1.0]),
        "along": np.array([0.0, 0.0, 1.0]),
        "positions": tracked.positions,
        "faces": tracked.mesh.faces,
        "ranks": np.full(tracked.visible.shape, 1.5),
        "visible": tracked.visible,
        "clouds": [positions[:k].astype(float) for k, positions in enumerate(tracked.positions)],
        "colorings": [Coloring("gap", "Gap [mm]", "", 10.0, values)],
    }
    assert count == len(given["clouds"])
    return SceneContents(**{**given, **changes})


def unpacked(scene):
    """What the browser does, in Python."""
    told, data = packed(scene)
    header, content = json.loads(told), zlib.decompress(base64.b64decode(data))
    arrays = {}
    for name, (kind, start, length, width) in header["arrays"].items():
        part = content[start : start + length]
        if kind in ("words", "bytes"):
            arrays[name] = np.frombuffer(part, "<u4" if kind == "words" else np.uint8)
            continue
        halves = np.frombuffer(part, np.uint8).reshape(2, -1).astype(np.uint16)
        values = (halves[0] | (halves[1] << 8)).view(np.int16).reshape(-1, 3)
        if kind == "differences":
            values = values.reshape(len(header["frames"]), width // 3, 3)
            values = np.add.accumulate(values, axis=0, dtype=np.int16)
        arrays[name] = values * header["grain"] + header["origin"]
    return header, arrays


def test_the_browser_gets_every_frame_within_half_a_grain(tracked):
    header, arrays = unpacked(contents(tracked))
    np.testing.assert_allclose(arrays["positions"], tracked.positions, atol=3.2e-5)
    np.testing.assert_array_equal(arrays["faces"].reshape(-1, 3), tracked.mesh.faces)
    assert header["counts"] == list(range(len(tracked.frames)))
    np.testing.assert_allclose(arrays["cloud"][:1], tracked.positions[1][:1], atol=2.6e-4)
    bits = np.unpackbits(arrays["visible"], bitorder="little")[: tracked.visible.size]
    np.testing.assert_array_equal(bits.reshape(tracked.visible.shape), tracked.visible)
    assert set(arrays["ranks"]) == {1.5 * RANK_STEPS}


def test_every_observed_point_keeps_its_color(tracked, rng):
    clouds = [rng.uniform(-0.2, 0.2, (50 * (k + 1), 3)) for k in range(len(tracked.frames))]
    red_right = [np.where(p[:, :1] > 0, (200, 0, 0), (0, 0, 200)).astype(np.uint8) for p in clouds]
    header, arrays = unpacked(contents(tracked, clouds=clouds, cloud_colors=red_right))
    shown = np.array(header["cloudColors"])[arrays["cloud colors"]]
    right = arrays["cloud"][:, 0] > 0
    far = np.abs(arrays["cloud"][:, 0]) > 3e-4
    np.testing.assert_array_equal(shown[far][:, 0] == 200, right[far])
    assert len(shown) == sum(map(len, clouds))
