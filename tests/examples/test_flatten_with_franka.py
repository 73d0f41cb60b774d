"""The example as it is written, with an arm and a camera that only pretend."""

import importlib.util
import json
import sys
import types
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.planning.coarse_cloth import CoarseConfig
from clothtrack.planning.perception import Estimate
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.store import read_recording
from clothtrack_capture import CapturedFrame

EXAMPLES = Path(__file__).parents[2] / "examples"
_spec = importlib.util.spec_from_file_location(
    "flatten_with_franka", EXAMPLES / "flatten_with_franka.py"
)
example = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(example)

SIDE_M = 0.2
FLAT = towel(SIDE_M, SIDE_M, 0.025)


class Franky:
    """Remembers what the arm was asked; it goes wherever it is told."""

    def __init__(self):
        self.at, self.moves, self.speeds, self.fingers = np.array([0.0, 0.0, 0.35]), [], [], []
        franky = self

        class Robot:
            def __init__(self, address):
                self.translation_velocity_limit = types.SimpleNamespace(set=franky.speeds.append)

            @property
            def current_cartesian_state(self):
                pose = types.SimpleNamespace(translation=franky.at.copy())
                return types.SimpleNamespace(pose=types.SimpleNamespace(end_effector_pose=pose))

            def move(self, motion):
                (place, _), _ = motion
                franky.at = np.array(place)
                franky.moves.append(franky.at)

        class Gripper:
            def __init__(self, address):
                pass

            def open(self, speed):
                franky.fingers.append("open")
                return True

            def grasp(self, width, speed, force, epsilon_outer):
                franky.fingers.append("close")
                return True

        self.module = types.SimpleNamespace(
            Robot=Robot, Gripper=Gripper, Affine=lambda place, turn: (place, turn),
            CartesianMotion=lambda target, kind: (target, kind),
            ReferenceType=types.SimpleNamespace(Absolute="absolute"),
        )  # fmt: skip


class Still:
    """A camera that always shows the same picture."""

    def __init__(self, recording):
        frame, self.camera = recording.frames[-1], recording.cameras[0]
        name = self.camera.name
        unit = recording.depth_units_m[name]
        self._shown = CapturedFrame(
            0.0, read_color(frame.color[name]), read_depth(frame.depth[name], unit)
        )

    def frames(self):
        return repeat(self._shown)


class Outwards:
    """Dynamics that promise most of the farthest place."""

    coarse = CoarseConfig()

    def predict(self, cloth, actions):
        far = [0.0 if one is None else np.linalg.norm(one.place - one.pick) for one in actions]
        return np.stack([cloth.positions * [1.0 + way, 1.0, 1.0] for way in far])


class Known:
    """Perception that has been told where the cloth is."""

    def perceive(self, recording):
        middle = observe(recording, recording.frames[-1]).points.mean(axis=0)
        return Estimate(FLAT, FLAT.vertices + middle, "network")


@pytest.fixture
def cell(tmp_path, napkin, monkeypatch):
    """Writes cell.json, and gives the arm that answers."""
    arm, recording = Franky(), read_recording(napkin)
    monkeypatch.setitem(sys.modules, "franky", arm.module)
    monkeypatch.setattr(example, "open_realsense", lambda **_: Still(recording))
    monkeypatch.setattr(example, "perception_of", lambda *_: Known())
    monkeypatch.setattr(example, "dynamics_of", lambda *_: Outwards())
    told = json.loads((EXAMPLES / "franka_cell.json").read_text())
    box = {"x_m": [-0.4, 0.4], "y_m": [-0.4, 0.4], "z_m": [0.0, 0.5]}
    told |= {
        "recording": str(napkin), "garment": "towel", "size_m": [SIDE_M, SIDE_M],
        "color": recording.cloth.color, "workspace": box, "home_m": [0.0, 0.0, 0.35],
    }  # fmt: skip

    def asked(*words, **changes):
        (tmp_path / "cell.json").write_text(json.dumps(told | changes))
        given = [str(tmp_path / "cell.json"), "--output", str(tmp_path / "out"), *words]
        return example.main(given)

    asked.arm, asked.out = arm, tmp_path / "out"
    return asked


def test_without_leave_the_plan_is_drawn_and_nothing_moves(cell, capsys):
    assert cell() == 0
    assert not cell.arm.moves
    assert not cell.arm.fingers
    assert (cell.out / "action_00.png").exists()
    assert "nothing has moved" in capsys.readouterr().out
    # What was seen then is not gone on from: the cloth may lie elsewhere by now.
    assert cell("--move") == 1
    assert "another --output" in capsys.readouterr().err
    assert not cell.arm.moves


def test_one_action_is_carried_out_within_the_limits(cell):
    assert cell("--move") == 0
    arm = cell.arm
    assert arm.fingers == ["open", "close", "open"]
    assert set(arm.speeds) == {0.05}
    moves = np.array(arm.moves)
    assert (np.abs(moves[:, :2]) <= 0.4).all()
    assert moves[:, 2].min() >= 0.002
    np.testing.assert_allclose(moves[-1], [0.0, 0.0, 0.35])
    steps = json.loads((cell.out / "episode" / "episode.json").read_text())["steps"]
    assert len(steps) == 2
    assert (cell.out / "report.html").exists()


def test_in_the_air_the_same_way_is_so_much_higher(cell, tmp_path):
    assert cell("--move", "--raise", "0.1") == 0
    told = json.loads((cell.out / "episode" / "episode.json").read_text())["steps"][1]["action"]
    moves = np.array(cell.arm.moves)
    assert moves[:, 2].min() >= 0.102
    assert moves[:, 2].max() <= 0.5
    placed = np.array(told["place"]) + [0.0, 0.0, 0.1]
    assert np.linalg.norm(moves - placed, axis=1).min() < 1e-9


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"speed": 1.0}, "limits.speed"),
        ({"home_m": [0.0, 0.0, 0.9]}, "home_m"),
        ({"base_from_world": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "rigid"),
    ],
)
def test_a_cell_that_is_not_safe_is_refused(cell, capsys, changes, told):
    assert cell("--move", **changes) == 1
    assert told in capsys.readouterr().err
    assert not cell.arm.moves
    assert not cell.out.exists()


def test_fingers_that_may_not_come_down_to_the_cloth_take_nothing(cell):
    assert cell("--move", clearance_m=0.1) == 0
    assert (np.array(cell.arm.moves)[:, 2] >= 0.1).all()
    assert "close" not in cell.arm.fingers
    status = json.loads((cell.out / "episode" / "episode.json").read_text())["status"]
    assert status == "no action is within reach"
