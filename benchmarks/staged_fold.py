"""A recording for benchmarks: folding a corner of a two-layer T-shirt, 43 frames at 20 Hz.

The recorded cloth is simulated by our own solver with another triangulation (about 1,500 vertices)
than any tracked one. The camera is that of the simulated world (MuJoCo), with its noise and the
tool in view. Everything is written to disk and read back, so that reading, segmenting and thinning
are included.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.recording import ClothDescription, PickerPath, Recording, Table
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.picker_action import HeldMotion
from clothtrack.simulation.solver import ClothSolver
from clothtrack_lab.world.appearance import Appearance
from clothtrack_lab.world.scene import Scene
from clothtrack_lab.world.sensor import Sensor, top_down_camera
from clothtrack_lab.world.tool import Tool

SIZE_M = (0.30, 0.27)
"""Cuff to cuff and hem to shoulder: about 1,000 vertices at 10 mm, 4,000 at 5 mm."""

FRAME_RATE = 20.0
STEPS = 42
CARRIED_STEPS = 32
WAY_M = np.array([-0.12, 0.13, 0.008])
LIFT_M = 0.07
FILMED_VERTICES = 1500
PICKER = "gripper"
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
FILMED = ClothParameters(bend_compliance=30.0, table_friction=0.6, particle_friction=0.4)


def shirt(vertex_count: int, *, seed: int = 0) -> ClothMesh:
    """Return the T-shirt on the table with about `vertex_count` vertices."""
    flat = garment("tshirt", vertex_count=vertex_count, size_m=SIZE_M, seed=seed)
    return flat.with_vertices(flat.vertices + (0.0, 0.0, 0.002 - flat.vertices[:, 2].min()))


def staged(folder: Path, frame_rate: float = FRAME_RATE) -> Recording:
    """Record the fold into a new folder, and read it.

    The duration of the fold does not depend on the rate [1/s].
    """
    steps, carried = (round(n * frame_rate / FRAME_RATE) for n in (STEPS, CARRIED_STEPS))
    mesh = shirt(FILMED_VERTICES, seed=3)
    held = int(np.argmax(mesh.vertices @ (1.0, -0.3, 0.5)))
    tips = _tips(mesh.vertices[held], steps, carried)
    shapes = _motion(mesh, held, tips, carried)
    rng = np.random.default_rng(0)
    config = SensorConfig()
    camera = top_down_camera(config, rng)
    scene = Scene(mesh, Tool(azimuth_rad=-np.pi / 3.0), camera)
    look = replace(Appearance.sample(rng), cloth="blue")
    sensor = Sensor(scene, config, look, seed=1)
    times = np.arange(steps + 1) / frame_rate
    with RecordingWriter(
        folder, [camera], {camera.name: config.step_m}, table=TABLE,
        cloth=ClothDescription(kind="tshirt", color=look.cloth, size_m=SIZE_M),
    ) as writer:  # fmt: skip
        for time_s, shape, tip in zip(times, shapes, tips, strict=True):
            picture = sensor.capture(shape, tip)
            writer.add_frame(
                float(time_s),
                color={camera.name: picture.color},
                depth={camera.name: picture.depth},
            )
        writer.add_action(0, steps, [PICKER])
        writer.set_picker_path(PICKER, PickerPath(times, tips, np.arange(len(tips)) < carried))
    return read_recording(folder)


def _tips(start: np.ndarray, steps: int, carried: int) -> np.ndarray:
    """Return where the tool is at each frame [m]: an arc, then straight up and away."""
    share = np.linspace(0.0, 1.0, carried + 1)
    eased = share**2 * (3.0 - 2.0 * share)
    arc = start + eased[:, None] * WAY_M
    arc[:, 2] += LIFT_M * (1.0 - (2.0 * eased - 1.0) ** 4)
    left = np.arange(1, steps - carried + 1)[:, None] * (STEPS / steps)
    away = left * (0.03, -0.04, 0.02)
    return np.concatenate([arc, arc[-1] + away])


def _motion(mesh: ClothMesh, held: int, tips: np.ndarray, carried: int) -> list[np.ndarray]:
    """Return the cloth's vertices at each frame [m]."""
    solver = ClothSolver(mesh, SolverConfig(table=TABLE), parameters=FILMED)
    dynamics = ClothDynamics(solver)
    shapes = [solver.positions[0].astype(np.float64)]
    duration_s = STEPS / FRAME_RATE / (len(tips) - 1)
    for frame in range(len(tips) - 1):
        motion = None
        if frame < carried:
            motion = HeldMotion(np.array([held], np.int32), tips[frame : frame + 2, None])
        rolled = dynamics.roll_out(None, motion, duration_s)
        shapes.append(rolled.positions[0].astype(np.float64))
    return shapes
