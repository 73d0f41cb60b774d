"""Videos of a cloth whose vertices are known in closed form, drawn by an independent renderer.

The module shares no physics, camera or rasterizer with the simulators or the package. A sheet is
bent only along straight lines, so its lengths do not change. The cross-section of a fold is a chain
of arcs and straight pieces. A drag is a translation with wrinkles along it. A hand, a forearm and a
table are drawn into the same picture. The world has z up, in meters, and the table at z = 0. The
camera has x right, y down, z forward, and pixel centers at integers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.optimize import brentq

LAYER_M = 0.003
"""Height of a layer over the one below [m]."""

LOWEST_M = 0.5 * LAYER_M
"""Height of the middle of cloth that lies on the table [m]."""

Motion = Callable[[np.ndarray, float], np.ndarray]
"""Where the material points, (n, 2) [m] from the middle of the cloth, are at a time [s]: (n, 3)."""


@dataclass(frozen=True)
class Fold:
    """A fold of a part of the cloth over a line.

    Attributes:
        normal: unit vector in the cloth, from the line towards the part that is carried.
        offset_m: distance of the line from the middle of the cloth [m].
        reach_m: distance of the carried tip from the line [m].
        start_s: when the picker begins to carry.
        duration_s: how long it carries.
        loop_m: height of the loop at the end of the carrying [m].
        settled_m: height that the loop sinks to after it is let go [m].
        settling_s: time constant of that [s].
        spring: radius of the arc that bends the flap back onto the cloth, in radii of the loop: the
            larger, the less of the flap lies down.
    """

    normal: tuple[float, float]
    offset_m: float
    reach_m: float
    start_s: float
    duration_s: float
    loop_m: float = 0.023
    settled_m: float = 0.023
    settling_s: float = 0.15
    spring: float = 2.0

    @property
    def end_s(self) -> float:
        """When the picker lets go."""
        return self.start_s + self.duration_s

    def section(self, time_s: float) -> list[tuple[float, float]]:
        """Return length [m] and curvature [1/m] of the cross-section's pieces, from the line on."""
        share = float(np.clip((time_s - self.start_s) / self.duration_s, 0.0, 1.0))
        late = max(0.0, time_s - self.end_s)
        height = self.settled_m + (self.loop_m - self.settled_m) * np.exp(-late / self.settling_s)
        radius = 0.5 * height
        # The loop is higher than two layers: beyond half a turn the cloth dips by `dip`, then
        # bends back on a wider arc and lies on the lower layer.
        wider = self.spring * radius
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
    """Return the points of a plane curve of arcs, straight beyond the last one: x and z [m].

    Args:
        lengths: arc lengths [m] from its start, where it runs along x.
        pieces: length [m] and curvature [1/m] of each piece.
    """
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


@dataclass(frozen=True)
class Drag:
    """A drag of the whole cloth along the table, with wrinkles along its path.

    Attributes:
        way: displacement in the cloth's frame [m].
        start_s: when it begins.
        duration_s: how long it is drawn.
        height_m: of the wrinkles at the end [m].
        wave_m: distance of the wrinkles [m].
    """

    way: tuple[float, float]
    start_s: float
    duration_s: float
    height_m: float
    wave_m: float

    @property
    def end_s(self) -> float:
        """When the picker lets go."""
        return self.start_s + self.duration_s

    def __call__(self, material: np.ndarray, time_s: float) -> np.ndarray:
        """Return material points' displacements from the flat cloth: (n, 3) [m], in its frame."""
        share = _smooth((time_s - self.start_s) / self.duration_s)
        way = np.asarray(self.way)
        across = np.array([-way[1], way[0]]) / np.linalg.norm(way)
        height, turns = self.height_m * share, 2.0 * np.pi / self.wave_m
        s = material @ across
        # dx/ds = sqrt(1 - (dz/ds)^2), to the second order.
        shorter = (
            0.5 * (0.5 * height * turns) ** 2 * (0.5 * s - np.sin(2.0 * turns * s) / 4 / turns)
        )
        moved = np.zeros((len(material), 3))
        moved[:, :2] = share * way - shorter[:, None] * across
        moved[:, 2] = 0.5 * height * (1.0 - np.cos(turns * s))
        return moved


def _smooth(share: float) -> float:
    """Return a smooth share from 0 to 1, at rest at both ends (minimum jerk)."""
    share = min(max(share, 0.0), 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


@dataclass(frozen=True)
class Picked:
    """A picker: which material point it holds and when.

    Attributes:
        name: in the recording.
        point: material point [m], from the middle of the cloth.
        start_s: when it closes.
        end_s: when it opens.
        azimuth_rad: direction in the world from which its hand comes.
    """

    name: str
    point: tuple[float, float]
    start_s: float
    end_s: float
    azimuth_rad: float


@dataclass(frozen=True)
class Scene:
    """A video to draw.

    Attributes:
        size_m: width and length of the cloth.
        moves: folds and drags; no point of the cloth is in two folds.
        picked: pickers with their points and times; a point may be held again.
        frames: number of frames.
        rate: pictures per second.
        actions: first and last frame of each.
        yaw_rad: rotation of the cloth about the vertical.
        place_m: middle of the cloth in the world.
        tilt_deg: of the camera against the vertical.
        distance_m: of the camera from the origin.
        width: of the picture [pixels], three quarters of which are its height.
        color: of the cloth.
        pattern: "plain", "dots" or "stripes".
        hand: whether a bare hand is in the picture.
        noise_m: standard deviation of the depth [m].
        seed: of noise and texture.
    """

    size_m: tuple[float, float]
    moves: tuple[Fold | Drag, ...]
    picked: tuple[Picked, ...]
    frames: int = 22
    rate: float = 10.0
    actions: tuple[tuple[int, int], ...] = ((0, 21),)
    yaw_rad: float = 0.0
    place_m: tuple[float, float] = (0.0, 0.0)
    tilt_deg: float = 35.0
    distance_m: float = 0.75
    width: int = 320
    color: tuple[int, int, int] = (60, 95, 170)
    pattern: str = "plain"
    hand: bool = True
    noise_m: float = 0.0013
    seed: int = 0

    @property
    def times(self) -> np.ndarray:
        """Time of each frame [s]."""
        return np.arange(self.frames) / self.rate

    def positions(self, material: np.ndarray, time_s: float) -> np.ndarray:
        """Return material points (n, 2) in the world at a time: (n, 3) [m]."""
        local = np.zeros((len(material), 3))
        local[:, :2] = material
        for move in self.moves:
            local += move(material, time_s)
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        turned = local[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
        return np.column_stack([turned + self.place_m, local[:, 2] + LOWEST_M])

    def tip(self, picked: Picked, time_s: float) -> np.ndarray:
        """Return a picker's fingertips [m]: at its point; before and after it, away."""
        held = min(max(time_s, picked.start_s), picked.end_s)
        place = self.positions(np.array([picked.point]), held)[0]
        away = _smooth(max(picked.start_s - time_s, time_s - picked.end_s) / 0.5)
        side = np.array([np.cos(picked.azimuth_rad), np.sin(picked.azimuth_rad), 0.45])
        return place + 0.5 * away * side

    @property
    def focal(self) -> float:
        """Focal length [pixels]."""
        return 0.92 * self.width

    @property
    def pose(self) -> np.ndarray:
        """World from camera: it looks at the origin, from the side of negative y."""
        tilt = np.radians(self.tilt_deg)
        forward = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
        down = np.array([0.0, -np.cos(tilt), -np.sin(tilt)])
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([np.cross(down, forward), down, forward])
        pose[:3, 3] = -self.distance_m * forward
        return pose


@dataclass
class Film:
    """The pictures of the camera, and the truth.

    Attributes:
        color: (frames, height, width, 3) of 8 bits, red first.
        depth: (frames, height, width) of 16 bits [mm]; 0 = none.
        exact: depth without noise [m].
        mask: (frames, height, width): the cloth.
        grid: flat material points (vertices, 2) [m] of the truth.
        faces: its triangles.
        positions: (frames, vertices, 3) [m].
        tips: per picker, (frames, 3) [m].
        closed: per picker, (frames,).
    """

    color: np.ndarray
    depth: np.ndarray
    exact: np.ndarray
    mask: np.ndarray
    grid: np.ndarray
    faces: np.ndarray
    positions: np.ndarray
    tips: dict[str, np.ndarray] = field(default_factory=dict)
    closed: dict[str, np.ndarray] = field(default_factory=dict)


def draw(scene: Scene, spacing_m: float = 0.003) -> Film:
    """Draw a video; the truth has a vertex every `spacing_m`."""
    rng = np.random.default_rng(scene.seed)
    width, height = scene.width, scene.width * 3 // 4
    grid, faces = sheet(scene.size_m, spacing_m)
    cloth = _cloth_color(grid[faces].mean(axis=1), scene)
    tabletop, ground = _table(scene, rng)
    shape = (scene.frames, height, width)
    film = Film(
        np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint16), np.zeros(shape),
        np.zeros(shape, bool), grid, faces,
        np.stack([scene.positions(grid, time_s) for time_s in scene.times]),
        {one.name: np.zeros((scene.frames, 3)) for one in scene.picked},
        {one.name: np.zeros(scene.frames, bool) for one in scene.picked},
    )  # fmt: skip
    for frame, time_s in enumerate(scene.times):
        shown = [(film.positions[frame], faces, cloth)]
        for name in film.tips:
            # Of the grips of one picker, the one that is nearest in time.
            one = min(
                (each for each in scene.picked if each.name == name),
                key=lambda each: max(each.start_s - time_s, time_s - each.end_s),
            )
            film.tips[name][frame] = scene.tip(one, time_s)
            # A picker is closed up to the frame in which it opens.
            film.closed[name][frame] = one.start_s - 1e-9 <= time_s < one.end_s - 1e-9
            if scene.hand:
                shown.append(hand(film.tips[name][frame], one.azimuth_rad))
        exact, color, which = render(scene, shown, ground, tabletop)
        film.exact[frame], film.mask[frame] = exact, which == 0
        film.color[frame] = np.clip(color + rng.normal(0.0, 3.0, color.shape), 0, 255)
        noisy = exact + rng.normal(0.0, scene.noise_m, exact.shape)
        # No measurement along a step in depth, as stereo has it, and at a few pixels besides.
        step = cv2.morphologyEx(exact, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.03
        missing = step & (rng.random(exact.shape) < 0.7) | (rng.random(exact.shape) < 0.005)
        film.depth[frame] = np.where(missing, 0, np.round(1e3 * noisy))
    return film


def sheet(size_m: tuple[float, float], spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a rectangle of triangles around the origin: material points (n, 2) [m] and faces."""
    columns, rows = (max(2, round(side / spacing_m) + 1) for side in size_m)
    u, v = (
        np.linspace(-0.5 * side, 0.5 * side, n)
        for side, n in zip(size_m, (columns, rows), strict=True)
    )
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid, _grid_faces(columns, rows)


def _grid_faces(columns: int, rows: int) -> np.ndarray:
    index = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _cloth_color(places: np.ndarray, scene: Scene) -> np.ndarray:
    """Return color of each triangle (n, 3): plain, with dots or stripes; a seam along the rim."""
    color = np.tile(np.array(scene.color, np.float64), (len(places), 1))
    light = 0.5 * np.array(scene.color) + 110.0
    if scene.pattern == "dots":
        cell = 0.035
        color[np.linalg.norm((places % cell) - 0.5 * cell, axis=1) < 0.008] = light
    if scene.pattern == "stripes":
        color[places[:, 0] % 0.05 < 0.012] = light
    inside = 0.5 * np.array(scene.size_m) - np.abs(places)
    color[(np.abs(inside.min(axis=1) - 0.008) < 0.0015)] *= 0.75
    weave = np.random.default_rng(scene.seed + 1).normal(0.0, 6.0, (len(places), 1))
    return color + weave


def _table(scene: Scene, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return color and depth [m] of the bare table."""
    width, height = scene.width, scene.width * 3 // 4
    coarse = rng.normal(0.0, 7.0, (height // 8, width // 8)).astype(np.float32)
    grain = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    color = np.array([168.0, 150.0, 128.0]) + grain[..., None]
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack(
        [(columns - 0.5 * (width - 1)) / scene.focal, (rows - 0.5 * (height - 1)) / scene.focal,
         np.ones_like(rows)], axis=-1
    )  # fmt: skip
    down = rays @ scene.pose[2, :3]
    depth = np.where(down < -1e-3, -scene.pose[2, 3] / np.minimum(down, -1e-3), 4.0)
    return color, np.minimum(depth, 4.0)


def hand(tip: np.ndarray, azimuth_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pinching fingers, a fist and a forearm: vertices [m], faces, color of each face."""
    outwards = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.55])
    outwards /= np.linalg.norm(outwards)
    side = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    up = np.cross(outwards, side)
    # The tip is held from above: cloth lies between and under the fingers.
    start = tip + 0.008 * up + 0.002 * outwards
    fist = tip + 0.075 * outwards + 0.012 * up
    parts = [
        _tube([start + 0.006 * side, start + 0.035 * outwards + 0.016 * side, fist],
              [0.006, 0.008, 0.012]),
        _tube([start - 0.005 * side, start + 0.035 * outwards - 0.012 * side, fist],
              [0.006, 0.009, 0.012]),
        _tube([fist - 0.028 * outwards, fist - 0.01 * outwards, fist + 0.03 * outwards,
               fist + 0.07 * outwards, fist + 0.5 * outwards],
              [0.004, 0.026, 0.034, 0.027, 0.042]),
    ]  # fmt: skip
    vertices, faces, begun = [], [], 0
    for points, triangles in parts:
        vertices.append(points)
        faces.append(triangles + begun)
        begun += len(points)
    all_vertices, all_faces = np.concatenate(vertices), np.concatenate(faces)
    return all_vertices, all_faces, np.tile(np.array([205.0, 150.0, 122.0]), (len(all_faces), 1))


def _tube(axis: Sequence[np.ndarray], radii: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return a round tube along points with radii [m], in triangles of some millimeters."""
    points = np.array(axis)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    steps = np.linspace(0.0, lengths[-1], max(3, int(lengths[-1] / 0.004)))
    middle = np.stack([np.interp(steps, lengths, points[:, k]) for k in range(3)], axis=1)
    radius = np.interp(steps, lengths, radii)
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(along, across)
    vertices = middle[:, None] + radius[:, None, None] * ring
    return vertices.reshape(-1, 3), _grid_faces(len(steps), len(angles))


def render(
    scene: Scene,
    shown: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    ground: np.ndarray,
    tabletop: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return one picture.

    Args:
        scene: the camera.
        shown: vertices [m], faces and color of each face, per thing.
        ground: depth of the table [m].
        tabletop: its color.

    Returns:
        Depth along the optical axis [m], color, and which thing each pixel shows (-1: the table).
    """
    depth, color = ground.copy(), tabletop.copy()
    which = np.full(ground.shape, -1)
    light = np.array([0.25, -0.35, 0.9]) / np.linalg.norm([0.25, -0.35, 0.9])
    for number, (vertices, faces, own) in enumerate(shown):
        pixels, z = project(scene, vertices)
        near, face = rasterize(pixels[faces], z[faces], depth)
        corners = vertices[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        shaded = own * (0.45 + 0.6 * np.abs(normals @ light))[:, None]
        seen = face >= 0
        depth[seen], which[seen] = near[seen], number
        color[seen] = shaded[face[seen]]
    return depth, color, which


def project(scene: Scene, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows (n, 2) and depth along the optical axis [m] of world points."""
    local = (points - scene.pose[:3, 3]) @ scene.pose[:3, :3]
    middle = (0.5 * (scene.width - 1), 0.5 * (scene.width * 3 // 4 - 1))
    z = np.maximum(local[:, 2], 1e-3)
    return scene.focal * local[:, :2] / z[:, None] + middle, z


def rasterize(
    corners: np.ndarray, depths: np.ndarray, behind: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest of many small triangles at every pixel center.

    Args:
        corners: (triangles, 3, 2) [pixels].
        depths: of the corners, (triangles, 3) [m].
        behind: what is nearer already hides them, (height, width) [m].

    Returns:
        The depth [m] and the triangle of each pixel, -1 where none is in front.
    """
    height, width = behind.shape
    low = np.ceil(corners.min(axis=1)).astype(np.int64)
    span = np.floor(corners.max(axis=1)).astype(np.int64) - low
    inside = (low + span >= 0).all(axis=1) & (low < (width, height)).all(axis=1)
    kept = np.flatnonzero(inside & (span >= 0).all(axis=1))
    a, b, c = (corners[kept, k] for k in range(3))
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    inverse = 1.0 / depths[kept]
    near, face = behind.ravel().copy(), np.full(behind.size, -1)
    most = span[kept].max(axis=0) if len(kept) else (-1, -1)
    for row in range(most[1] + 1):
        for column in range(most[0] + 1):
            pixel = low[kept] + (column, row)
            from_a = pixel - a
            with np.errstate(divide="ignore", invalid="ignore"):
                v = (from_a[:, 0] * ac[:, 1] - from_a[:, 1] * ac[:, 0]) / area
                w = (ab[:, 0] * from_a[:, 1] - ab[:, 1] * from_a[:, 0]) / area
            hit = (v >= 0) & (w >= 0) & (v + w <= 1)
            hit &= (pixel >= 0).all(axis=1) & (pixel < (width, height)).all(axis=1)
            v, w, at = v[hit], w[hit], pixel[hit]
            one = inverse[hit]
            # 1 / z is linear in the picture.
            z = 1.0 / ((1.0 - v - w) * one[:, 0] + v * one[:, 1] + w * one[:, 2])
            place = at[:, 1] * width + at[:, 0]
            order = np.argsort(-z, kind="stable")
            place, z, own = place[order], z[order], kept[hit][order]
            front = z < near[place]
            # The last that is written is the nearest.
            near[place[front]], face[place[front]] = z[front], own[front]
    return near.reshape(behind.shape), face.reshape(behind.shape)


def _corner(size_m: tuple[float, float], signs: tuple[int, int]) -> tuple[float, float]:
    """Return where a corner is taken: 4 mm inside the cloth."""
    return signs[0] * (0.5 * size_m[0] - 0.004), signs[1] * (0.5 * size_m[1] - 0.004)


def _corner_fold(
    size_m: tuple[float, float],
    signs: tuple[int, int],
    reach_m: float,
    start_s: float,
    **more: float,
) -> Fold:
    """Return a corner fold over the line `reach_m` from it at equal angles to its sides."""
    normal = np.array(signs) / np.sqrt(2.0)
    corner = 0.5 * np.array(size_m) * np.array(signs)
    return Fold(tuple(normal), float(corner @ normal) - reach_m, reach_m, start_s, 1.0, **more)


_WIDE, _NAPKIN, _LONG, _SQUARE = (0.42, 0.31), (0.3, 0.26), (0.46, 0.24), (0.34, 0.33)

SCENES: dict[str, Scene] = {
    "stiff_loop": Scene(
        _WIDE, (_corner_fold(_WIDE, (1, -1), 0.15, 0.4),),
        (Picked("hand", _corner(_WIDE, (1, -1)), 0.4, 1.4, -0.4),),
        frames=25, actions=((0, 24),), yaw_rad=0.15, place_m=(-0.02, 0.01), width=480, seed=1,
    ),
    "stiff_open": Scene(
        _WIDE, (_corner_fold(_WIDE, (1, -1), 0.125, 0.4, spring=14.0),),
        (Picked("hand", _corner(_WIDE, (1, -1)), 0.4, 1.4, -0.4),),
        frames=28, rate=12.0, actions=((0, 27),), yaw_rad=0.15, place_m=(-0.02, 0.01), width=480,
        color=(200, 200, 190), seed=6,
    ),
    "soft_drape": Scene(
        _NAPKIN,
        (_corner_fold(_NAPKIN, (-1, 1), 0.12, 0.4, loop_m=0.014, settled_m=0.006),),
        (Picked("hand", _corner(_NAPKIN, (-1, 1)), 0.4, 1.4, 2.4),),
        yaw_rad=-0.3, tilt_deg=25.0, distance_m=0.65, color=(170, 60, 60), pattern="dots", seed=2,
    ),
    "drag": Scene(
        _LONG, (Drag((-0.07, 0.02), 0.4, 1.0, 0.006, 0.07),),
        (Picked("hand", (-0.226, 0.0), 0.4, 1.4, 3.0),),
        yaw_rad=0.1, tilt_deg=40.0, distance_m=0.8, color=(70, 140, 80), pattern="stripes", seed=3,
    ),
    "two_folds": Scene(
        _SQUARE,
        (_corner_fold(_SQUARE, (1, 1), 0.12, 0.2, loop_m=0.016, settled_m=0.008),
         _corner_fold(_SQUARE, (-1, -1), 0.12, 1.8, loop_m=0.012, settled_m=0.007)),
        (Picked("hand", _corner(_SQUARE, (1, 1)), 0.2, 1.2, 0.5),
         Picked("hand", _corner(_SQUARE, (-1, -1)), 1.8, 2.8, -2.2)),
        frames=34, actions=((0, 16), (16, 33)), yaw_rad=0.4, tilt_deg=15.0, distance_m=0.7,
        color=(185, 130, 50), hand=False, seed=4,
    ),
    "half_fold": Scene(
        _LONG, (Fold((1.0, 0.0), 0.08, 0.15, 0.4, 1.0, loop_m=0.018, settled_m=0.012),),
        (Picked("left", (0.226, 0.1), 0.4, 1.4, 0.9),
         Picked("right", (0.226, -0.1), 0.4, 1.4, -0.9)),
        yaw_rad=-0.1, tilt_deg=30.0, distance_m=0.8, color=(120, 70, 140), seed=5,
    ),
}  # fmt: skip
"""Motion laws that no simulator of ours has: a stiff loop that lies still, one whose flap touches
the cloth with its corner alone, a soft one that sinks, a drag with wrinkles, two corners one after
the other, and an edge carried by two hands."""
