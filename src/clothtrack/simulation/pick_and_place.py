"""Random pick-and-places: the grasp of the gripper, and the path of its tip.

Grasp and release happen exactly at camera frames, as with a robot that waits for its camera.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from clothtrack.files.bounds import Bounds, Checked, Interval, Share
from clothtrack.geometry.mesh import ClothMesh

Picks = Literal["outline", "middle", "folded", "pulled"]

_SHARE_OF_EXTREMES = 0.8
_SHARE_STRAIGHT = 0.75
"""Share of places within 45 degrees of the inward direction, or outward for "pulled" picks."""

_RAMP = 0.2
"""Share of a path's time for acceleration, and the same for deceleration."""

_MIDDLE_M = 0.04
"""Maximum distance of a "middle" pick from the middle of the cloth [m]."""

MOST_LAYERS = 8
"""Maximum number of layers that the gripper takes."""

_LAYERS_APART_M = 0.03
"""Vertices of one stack farther apart than this [m] in the canonical pose are on two layers."""

_FOLD_REACH_M = 0.05
"""Vertices that lie together but are farther apart than this [m] in the flat cloth are folded."""


Length = Annotated[float, Bounds(least=0, most=10)]
Lengths = Annotated[tuple[float, float], Interval(least=0, empty=True, most=10)]
Speed = Annotated[float, Bounds(least=1e-3, most=100)]


@dataclass(frozen=True)
class ActionConfig(Checked):
    """Ranges of random pick-and-places, and motion of the gripper.

    Attributes:
        distance_m: smallest and largest horizontal distance of a place from its pick [m].
        lift_m: smallest and largest height of the path above the straight line [m].
        speed: highest speed of the tip while it holds cloth [m/s].
        both_layers: share of grasps that also take the cloth underneath.
        grasp_radius_m: horizontal reach of the gripper [m].
        reach_m: largest distance of a place from the table's origin [m].
        release_height_m: height of the tip above the cloth at the place when it opens [m]; above
            the lowest vertex if no cloth is there.
        free_speed: speed of the tool without cloth [m/s].
        frame_rate: pictures per second [1/s].
        picks: location of the grasps. "outline": mostly at the outline of the cloth; "middle": in
            the middle of the lying cloth; "folded": on folded cloth (once there is any), with all
            its layers, carried inward, so that folds are stacked on folds; "pulled": at the outline
            and carried outward, as a person does to flatten it.
        clear_held: whether the release height is that of the lowest held layer instead of the tip,
            so that a stack is laid down and not pressed into the table.
    """

    distance_m: Lengths = (0.05, 0.2)
    lift_m: Lengths = (0.05, 0.1)
    speed: Speed = 0.25
    both_layers: Share = 0.5
    grasp_radius_m: Annotated[float, Bounds(above=0, most=10)] = 0.01
    reach_m: Length = 0.2
    release_height_m: Length = 0.004
    free_speed: Speed = 1.25
    frame_rate: Annotated[float, Bounds(least=0.1, most=1000)] = 20.0
    picks: Picks = "outline"
    clear_held: bool = False


@dataclass(frozen=True, eq=False)
class PlannedAction:
    """One pick-and-place, planned for the current cloth.

    Attributes:
        held: vertices of the cloth that the gripper takes.
        pick: position where it closes [m].
        place: position where it opens [m].
        lift_m: height of the path above the straight line [m].
        folded: whether the pick is on folded cloth.
    """

    held: Int[np.ndarray, " held"]
    pick: Float[np.ndarray, " 3"]
    place: Float[np.ndarray, " 3"]
    lift_m: float
    folded: bool = False


def plan_action(cloth: ClothMesh, config: ActionConfig, rng: np.random.Generator) -> PlannedAction:
    """Return a random pick-and-place for the current cloth.

    Most picks are extreme points of the outline in a random direction (corners, cuffs, hems),
    and most of those move toward the middle of the cloth, so that it folds.

    Args:
        cloth: the cloth at its present vertices [m].
    """
    points = cloth.vertices
    middle = points[:, :2].mean(axis=0)
    folded = folded_vertices(cloth, config.grasp_radius_m)
    chosen = _chosen(points, middle, folded, config.picks, rng)
    column = np.linalg.norm(points[:, :2] - points[chosen, :2], axis=1) < config.grasp_radius_m
    stack = np.flatnonzero(column)
    top = int(stack[np.argmax(points[stack, 2])])
    held = [top]
    both = rng.random() < config.both_layers
    if config.picks == "folded":
        held = _whole_stack(cloth, top, config.grasp_radius_m)
    elif both:
        held += _layers_below(cloth, top, config.grasp_radius_m)

    pick = points[top].copy()
    place = _place(pick, middle, config, rng)
    under = np.linalg.norm(points[:, :2] - place[:2], axis=1) < config.grasp_radius_m
    under[held] = False
    ground = points[under, 2].max() if under.any() else points[:, 2].min()
    place[2] = ground + config.release_height_m
    if config.clear_held:
        place[2] += pick[2] - points[held, 2].min()
    lift = float(rng.uniform(*config.lift_m))
    return PlannedAction(np.array(held), pick, place, lift, bool(folded[stack].any()))


def folded_vertices(cloth: ClothMesh, radius_m: float) -> Bool[np.ndarray, " vertices"]:
    """Return which vertices lie over or under another part of the cloth, seen from above.

    The two layers that already lie on each other in the flat garment do not count.

    Args:
        cloth: the cloth at its present vertices [m]; its canonical coordinates identify the parts.
        radius_m: largest distance [m] of the other part in the plane of the table.
    """
    flat = cloth.vertices if cloth.canonical is None else cloth.canonical

    pairs = cKDTree(cloth.vertices[:, :2]).query_pairs(radius_m, output_type="ndarray")
    apart = np.linalg.norm(np.subtract(*flat[pairs.T, :2]), axis=1)
    folded = np.zeros(len(flat), dtype=bool)
    folded[pairs[apart > _FOLD_REACH_M]] = True
    return folded


def _chosen(
    points: Float[np.ndarray, "vertices 3"],
    middle: Float[np.ndarray, " 2"],
    folded: Bool[np.ndarray, " vertices"],
    picks: Picks,
    rng: np.random.Generator,
) -> int:
    """Return the vertex above which the gripper descends."""
    if picks == "middle":
        off = np.linalg.norm(points[:, :2] - middle, axis=1)
        near = np.flatnonzero(off < max(_MIDDLE_M, float(off.min())))
        return int(rng.choice(near if len(near) else [np.argmin(off)]))
    if picks in ("outline", "pulled") and rng.random() >= _SHARE_OF_EXTREMES:
        return int(rng.integers(len(points)))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    outward = (points[:, :2] - middle) @ np.array([np.cos(angle), np.sin(angle)])
    outward = outward - rng.exponential(0.01, len(points))
    if picks == "folded" and folded.any():
        outward[~folded] = -np.inf
    return int(np.argmax(outward))


def _place(
    pick: Float[np.ndarray, " 3"],
    middle: Float[np.ndarray, " 2"],
    config: ActionConfig,
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:
    """Return a random place within reach [m], at the height of the pick."""
    to_middle = np.arctan2(middle[1] - pick[1], middle[0] - pick[0])
    ahead = to_middle + np.pi if config.picks == "pulled" else to_middle
    straight = 1.0 if config.picks == "folded" else _SHARE_STRAIGHT
    for _ in range(100):
        spread = np.pi / 4.0 if rng.random() < straight else np.pi
        heading = ahead + rng.uniform(-spread, spread)
        way = rng.uniform(*config.distance_m)
        place = pick + way * np.array([np.cos(heading), np.sin(heading), 0.0])
        if np.linalg.norm(place[:2]) < config.reach_m:
            return place
    # The pick itself is out of reach: bring the cloth back.
    home = pick * [1.0, 1.0, 0.0]
    return pick - config.distance_m[1] * home / np.linalg.norm(home)


def carrying_path(
    action: PlannedAction, config: ActionConfig, time_step_s: float
) -> Float[np.ndarray, "steps 3"]:
    """Return the tip positions [m] after each time step from grasp to release.

    The path rises steeply, carries, and descends steeply, with smooth acceleration and
    deceleration. It lasts a whole number of pictures.
    """
    at = np.linspace(0.0, 1.0, 2001)
    across = at**2 * (3.0 - 2.0 * at)
    height = action.lift_m * (1.0 - (2.0 * at - 1.0) ** 4)
    curve = action.pick + across[:, None] * (action.place - action.pick)
    curve[:, 2] += height
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    mean_speed = config.speed * (1.0 - _RAMP)
    frames = max(2, int(np.ceil(along[-1] / mean_speed * config.frame_rate)))
    steps = frames * round(1.0 / (config.frame_rate * time_step_s))
    time = np.arange(1, steps + 1) / steps
    wanted = along[-1] * _eased(time)
    return np.stack([np.interp(wanted, along, axis) for axis in curve.T], axis=1)


def free_path(
    start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"], config: ActionConfig
) -> Float[np.ndarray, "frames 3"]:
    """Return tip positions [m] at each picture on a straight path without cloth.

    The start is not included; the last position is the end.
    """
    way = np.linalg.norm(end - start)
    frames = max(1, int(np.ceil(way / config.free_speed * config.frame_rate)))
    return start + np.linspace(0.0, 1.0, frames + 1)[1:, None] * (end - start)


def _eased(time: Float[np.ndarray, " steps"]) -> Float[np.ndarray, " steps"]:
    """Return the share of the path at each share of the time, for a trapezoidal speed profile."""
    top = 1.0 / (1.0 - _RAMP)
    rising = 0.5 * top * time**2 / _RAMP
    level = top * (time - 0.5 * _RAMP)
    falling = 1.0 - 0.5 * top * (1.0 - time) ** 2 / _RAMP
    return np.where(time < _RAMP, rising, np.where(time < 1.0 - _RAMP, level, falling))


def _layers_below(cloth: ClothMesh, top: int, radius: float) -> list[int]:
    """Return the nearest vertex of the layer directly under a vertex; none above bare table."""
    points = cloth.vertices
    gap = np.linalg.norm(points[:, :2] - points[top, :2], axis=1)
    depth = points[top, 2] - points[:, 2]
    # Cloth of the same layer slopes at most about one to one.
    below = np.flatnonzero((gap < radius) & (depth > np.maximum(0.0015, gap)) & (depth < 0.02))
    return [int(below[np.argmin(gap[below] + depth[below])])] if len(below) else []


def _whole_stack(cloth: ClothMesh, top: int, radius: float) -> list[int]:
    """Return `top` and one vertex of each other part of the cloth in its column, nearest first."""
    flat = cloth.vertices if cloth.canonical is None else cloth.canonical
    gap = np.linalg.norm(cloth.vertices[:, :2] - cloth.vertices[top, :2], axis=1)
    held = [top]
    for vertex in np.flatnonzero(gap < radius)[np.argsort(gap[gap < radius])]:
        apart = np.linalg.norm(flat[held] - flat[vertex], axis=1).min()
        if apart > _LAYERS_APART_M and len(held) < MOST_LAYERS:
            held.append(int(vertex))
    return held
