"""Films of a cloth whose vertices are known in closed form: no simulator has moved it.

A sheet is bent only along straight lines, so its lengths do not change. The cross-section of a fold
is a chain of arcs and straight pieces. Hand, forearm and table are drawn into the same picture. The
world has z up, in meters, and the table at z = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import brentq

from clothtrack.garments.garment_meshes import garment, towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from shared.recording_data import RecordingData

RATE_HZ, NOISE_M, SETTLING_S = 10.0, 0.0013, 0.15
"""Pictures per second, standard deviation of the depth [m], time in which a loop sinks [s]."""

LAYER_M, SPACING_M, SPRING = 0.003, 0.003, 2.0
"""Height of a layer over the one below, distance of the truth's vertices [m], and the radius of the
arc that bends a flap back onto the cloth, in radii of its loop."""

LOWEST_M = 0.5 * LAYER_M
"""Height of the middle of cloth that lies on the table [m]."""


@dataclass(frozen=True)
class Fold:
    """A fold of a part of the cloth over a line.

    Attributes:
        normal: unit vector in the cloth, from the line towards the part that is carried.
        offset_m: distance of the line from the middle of the cloth [m].
        reach_m: distance of the carried tip from the line [m].
        loop_m: height of the loop at the end of the carrying [m].
        settled_m: height that the loop sinks to after it is let go [m].
    """

    normal: tuple[float, float]
    offset_m: float
    reach_m: float
    loop_m: float = 0.023
    settled_m: float = 0.023
    start_s: float = 0.4
    end_s: float = 1.4

    def section(self, time_s: float) -> list[tuple[float, float]]:
        """Return length [m] and curvature [1/m] of the cross-section's pieces, from the line on."""
        share = float(np.clip((time_s - self.start_s) / (self.end_s - self.start_s), 0.0, 1.0))
        late = max(0.0, time_s - self.end_s)
        height = self.settled_m + (self.loop_m - self.settled_m) * np.exp(-late / SETTLING_S)
        radius = 0.5 * height
        # The loop is higher than two layers: beyond half a turn the cloth dips by `dip`, then
        # bends back on a wider arc and lies on the lower layer.
        wider = SPRING * radius
        dip = float(np.arccos(1.0 - (2.0 * radius - LAYER_M) / (radius + wider)))
        lifted = self.reach_m * _smooth(share / 0.7)
        if lifted <= 1e-9:
            return []
        turn = (np.pi + dip) * _smooth(share)
        back = dip * _smooth((share - 0.6) / 0.4)
        wide = radius + (0.05 - radius) * (1.0 - _smooth(share))
        flat = self.reach_m - lifted

        def bent(angle: float) -> list[tuple[float, float]]:
            first = min(wide, 0.75 * lifted / max(angle, 1e-6))
            return [(flat, 0.0), (first * angle, 1.0 / first), (wider * back, -1.0 / wider)]

        def above(angle: float) -> float:
            """Return the cloth's least height over the lower layer past a quarter turn [m]."""
            beyond = np.linspace(flat + 0.5 * lifted, self.reach_m, 30)
            return float(cross_section(beyond, bent(angle))[1].min()) - LAYER_M

        if share > 0.5 and above(turn) < 0.0:
            # The cloth cannot be turned through what it comes to lie on.
            turn = float(brentq(above, 0.5 * np.pi, turn))
        return bent(turn)

    def __call__(self, material: np.ndarray, time_s: float) -> np.ndarray:
        """Return material points' displacements from the flat cloth: (n, 3) [m], in its frame."""
        along = material @ np.asarray(self.normal) - self.offset_m
        beyond = np.maximum(along, 0.0)
        x, z = cross_section(beyond, self.section(time_s))
        moved = np.zeros((len(material), 3))
        moved[:, :2] = (x - beyond)[:, None] * np.asarray(self.normal)
        moved[:, 2] = z
        return moved


def cross_section(
    lengths: np.ndarray, pieces: Sequence[tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (x, z) [m] at arc lengths [m]; pieces have a length [m] and curvature [1/m]."""
    x, z = np.zeros_like(lengths), np.zeros_like(lengths)
    angle, begun = 0.0, 0.0
    for length, curvature in (*pieces, (np.inf, 0.0)):
        inside = np.clip(lengths - begun, 0.0, length)
        if abs(curvature) < 1e-9:
            x += np.cos(angle) * inside
            z += np.sin(angle) * inside
        else:
            turned = angle + curvature * inside
            x += (np.sin(turned) - np.sin(angle)) / curvature
            z += (np.cos(angle) - np.cos(turned)) / curvature
            angle += curvature * length
        begun += length
    return x, z


def _smooth(share: float) -> float:
    """Return a smooth share from 0 to 1, at rest at both ends (minimum jerk)."""
    share = min(max(share, 0.0), 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


@dataclass(frozen=True)
class Scene:
    """A film to draw: one fold, carried by one or two hands.

    Attributes:
        points: of each picker, its material point from the middle of the cloth [m], and the
            direction in the world from which its hand comes [rad].
        yaw_rad: rotation of the cloth about the vertical.
        width: of the picture [pixels], three quarters of which are its height.
    """

    size_m: tuple[float, float]
    fold: Fold
    points: dict[str, tuple[tuple[float, float], float]]
    frames: int = 22
    yaw_rad: float = 0.0
    tilt_deg: float = 30.0
    distance_m: float = 0.75
    width: int = 320
    color: tuple[int, int, int] = (60, 95, 170)
    seed: int = 0

    @property
    def times(self) -> np.ndarray:
        """Time of each frame [s]."""
        return np.arange(self.frames) / RATE_HZ

    def positions(self, material: np.ndarray, time_s: float) -> np.ndarray:
        """Return material points (n, 2) in the world at a time: (n, 3) [m]."""
        local = np.zeros((len(material), 3))
        local[:, :2] = material
        local += self.fold(material, time_s)
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        turned = local[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
        return np.column_stack([turned, local[:, 2] + LOWEST_M])

    def tip(self, picker: str, time_s: float) -> np.ndarray:
        """Return a picker's fingertips [m]: at its point; before and after it, away."""
        point, azimuth_rad = self.points[picker]
        begun, ended = self.fold.start_s, self.fold.end_s
        place = self.positions(np.array([point]), min(max(time_s, begun), ended))[0]
        away = _smooth(max(begun - time_s, time_s - ended) / 0.5)
        return place + 0.5 * away * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.45])

    @property
    def camera(self) -> Camera:
        """It looks at the origin, from the side of negative y."""
        tilt = np.radians(self.tilt_deg)
        forward = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
        down = np.array([0.0, -np.cos(tilt), -np.sin(tilt)])
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([np.cross(down, forward), down, forward])
        pose[:3, 3] = -self.distance_m * forward
        width, height, focal = self.width, self.width * 3 // 4, 0.92 * self.width
        middle = 0.5 * (width - 1), 0.5 * (height - 1)
        return Camera("camera", width, height, focal, focal, *middle, pose)


def _grid_faces(columns: int, rows: int) -> np.ndarray:
    index = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _table(camera: Camera, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return color and depth [m] of the bare table."""
    shape = camera.height, camera.width
    coarse = rng.normal(0.0, 7.0, (shape[0] // 8, shape[1] // 8)).astype(np.float32)
    grain = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    color = np.array([168.0, 150.0, 128.0]) + grain[..., None]
    pose = camera.world_from_camera
    ahead = camera.back_project(np.ones(shape)) - pose[:3, 3]
    down = np.minimum(ahead[:, 2], -1e-3).reshape(shape)
    return color, np.minimum(-pose[2, 3] / down, 4.0)


def hand(tip: np.ndarray, azimuth_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pinching fingers, a fist and a forearm: vertices [m], faces, color of each face."""
    outwards = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.55])
    outwards /= np.linalg.norm(outwards)
    side = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    up = np.cross(outwards, side)
    # Fingers hold from above: cloth lies between and under them. Distance and radius [m].
    along = np.array([0.002, 0.037, 0.065, 0.105, 0.145, 0.575])
    radii = np.array([0.011, 0.018, 0.026, 0.034, 0.027, 0.042])
    steps = np.arange(along[0], along[-1], 0.004)
    angles = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * up
    middle = tip + steps[:, None] * outwards + 0.012 * up
    radius = np.interp(steps, along, radii)
    vertices = (middle[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    faces = _grid_faces(len(steps), len(angles))
    return vertices, faces, np.tile(np.array([205.0, 150.0, 122.0]), (len(faces), 1))


def render(
    camera: Camera,
    shown: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    ground: np.ndarray,
    tabletop: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return depth [m], color, which thing is seen; -1: the table."""
    depth, color = ground.copy(), tabletop.copy()
    which = np.full(ground.shape, -1)
    light = np.array([0.25, -0.35, 0.9]) / np.linalg.norm([0.25, -0.35, 0.9])
    for number, (vertices, faces, own) in enumerate(shown):
        drawn = Rasterizer(faces, camera).render(vertices)
        corners = vertices[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        shaded = own * (0.45 + 0.6 * np.abs(normals @ light))[:, None]
        seen = drawn.depth < depth
        depth[seen], which[seen] = drawn.depth[seen], number
        color[seen] = shaded[drawn.faces[seen]]
    return depth, color, which


def _corner_fold(size_m: tuple[float, float], signs: tuple[int, int], **shape: float) -> Fold:
    """Return a fold of a corner over a line at equal angles to its sides."""
    normal = np.array(signs) / np.sqrt(2.0)
    offset_m = float(0.5 * np.array(size_m) * signs @ normal) - shape["reach_m"]
    return Fold((float(normal[0]), float(normal[1])), offset_m, **shape)


SCENES: dict[str, Scene] = {
    "stiff_loop": Scene(
        (0.42, 0.31), _corner_fold((0.42, 0.31), (1, -1), reach_m=0.15),
        {"hand": ((0.206, -0.151), -0.4)}, frames=25, yaw_rad=0.15, width=480, seed=1,
    ),
    "soft_drape": Scene(
        (0.3, 0.26),
        _corner_fold((0.3, 0.26), (-1, 1), reach_m=0.12, loop_m=0.014, settled_m=0.006),
        {"hand": ((-0.146, 0.126), 2.4)}, yaw_rad=-0.3, distance_m=0.65, color=(170, 60, 60),
        seed=2,
    ),
    "half_fold": Scene(
        (0.46, 0.24), Fold((1.0, 0.0), 0.08, 0.15, loop_m=0.018, settled_m=0.012),
        {"left": ((0.226, 0.1), 0.9), "right": ((0.226, -0.1), -0.9)}, yaw_rad=-0.1,
        distance_m=0.8, color=(120, 70, 140), seed=5,
    ),
}  # fmt: skip
"""A stiff loop that lies still, a soft one that sinks, and an edge carried by two hands."""


def draw(scene: Scene, *, template_vertices: int = 0) -> RecordingData:
    """Draw a film; with a template of about so many vertices in place of the cloth's size."""
    rng = np.random.default_rng(scene.seed)
    view = scene.camera
    flat = towel(*scene.size_m, spacing_m=SPACING_M)
    grid, faces = np.asarray(flat.canonical, np.float64)[:, :2], flat.faces
    cloth = np.array(scene.color) + rng.normal(0.0, 6.0, (len(faces), 1))
    tabletop, ground = _table(view, rng)
    shape = (scene.frames, view.height, view.width)
    pinhole = {
        key: getattr(view, key) for key in ("name", "width", "height", "fx", "fy", "cx", "cy")
    }
    pose = view.world_from_camera.tolist()
    data = RecordingData(
        document={
            "version": 1, "frames": [],
            "cameras": [{**pinhole, "depth_unit_m": 0.001, "world_from_camera": pose}],
            "table": {"point": [0, 0, 0], "normal": [0, 0, 1]},
            "actions": [{"first_frame": 0, "last_frame": scene.frames - 1,
                         "pickers": list(scene.points)}],
            "cloth": {"kind": "towel", "size_m": list(scene.size_m)},
            "provenance": {"source": "drawn"},
        },
        color=np.zeros((*shape, 3), np.uint8),
        depth=np.zeros(shape, np.uint16),
        mask=np.zeros(shape, bool),
        truth=np.stack([scene.positions(grid, time_s) for time_s in scene.times]),
        truth_faces=faces,
        truth_canonical=np.column_stack([grid, np.zeros(len(grid))]),
        moments=np.arange(scene.frames),
    )  # fmt: skip
    data.times = scene.times
    data.picker = {name: np.zeros((scene.frames, 5)) for name in scene.points}
    for frame, time_s in enumerate(scene.times):
        shown = [(data.truth[frame], faces, cloth)]
        for name, samples in data.picker.items():
            # A picker is closed up to the frame in which it opens.
            closed = scene.fold.start_s - 1e-9 <= time_s < scene.fold.end_s - 1e-9
            samples[frame] = (time_s, *scene.tip(name, time_s), closed)
            shown.append(hand(samples[frame, 1:4], scene.points[name][1]))
        exact, color, which = render(view, shown, ground, tabletop)
        data.mask[frame] = which == 0
        data.color[frame] = np.clip(color + rng.normal(0.0, 3.0, color.shape), 0, 255)
        noisy = exact + rng.normal(0.0, NOISE_M, exact.shape)
        # No measurement along a step in depth, as stereo has it, and at a few pixels besides.
        step = cv2.morphologyEx(exact, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.03
        missing = step & (rng.random(exact.shape) < 0.7) | (rng.random(exact.shape) < 0.005)
        data.depth[frame] = np.where(missing, 0, np.round(1e3 * noisy))
    for samples in data.picker.values():
        # As a path that was found in pictures: a constant error, and one of each sample.
        samples[:, 1:4] += rng.normal(0.0, 0.002, 3) + rng.normal(0.0, 0.001, (len(samples), 3))
    if template_vertices:
        mesh = garment("towel", vertex_count=template_vertices, size_m=scene.size_m)
        data.faces, data.canonical = mesh.faces, np.asarray(mesh.canonical, np.float64)
        data.vertices = scene.positions(data.canonical[:, :2], 0.0)
        data.vertices[:, :2] += rng.normal(0.0, 0.0004, (len(data.vertices), 2))
    return data
