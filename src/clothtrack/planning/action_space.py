"""Sampling of pick-and-places on visible cloth, within reach and within the picture.

Random shooting as in the paper (Sec. IV-B.2) and its reference code: a pick on visible cloth, a
direction, 5 to 20 cm. Picks near hems and corners are sampled more often because they unfold cloth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.files.bounds import Checked, Interval, Share
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.pick_and_place import ActionConfig, PlannedAction, carrying_path

_EDGE_REACH_M = 0.02
"""Radius of the neighborhood [m] that distinguishes an edge from the interior of a cloth."""

_LEAST_WEIGHT = 0.02
"""Pick weight of the interior of the cloth; a straight edge has 0.18."""

ON_CLOTH_M = 0.012
"""Largest distance of a pick or place on the cloth from a visible point [m]."""

_OUTWARDS = 0.5
"""Share of moves within 60 degrees of the direction away from the middle of the cloth; the others
have any direction."""

RELEASE_HEIGHT_M = 0.006
"""Height of the tip above table or cloth when it opens [m]."""

PICTURE_MARGIN = 0.03
"""Smallest distance of a pick or place from the picture border, as a share of its width."""


@dataclass(frozen=True, eq=False)
class PickPlace:
    """Pick-and-place in the world frame; None stands for no action.

    Attributes:
        pick: position where the gripper closes [m].
        place: position where it opens [m].
        lift_m: height of the path over the straight line between them [m].
    """

    pick: Float[np.ndarray, " 3"]
    place: Float[np.ndarray, " 3"]
    lift_m: float

    def path(self, speed: float, time_step_s: float) -> Float[np.ndarray, "steps 3"]:
        """Return the tip position [m] after each time step, at most this fast [m/s]."""
        planned = PlannedAction(np.zeros(0, np.int64), self.pick, self.place, self.lift_m)
        config = ActionConfig(speed=speed, frame_rate=1.0 / time_step_s)
        return carrying_path(planned, config, time_step_s)

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {"pick": self.pick.tolist(), "place": self.place.tolist(), "lift_m": self.lift_m}


@dataclass(frozen=True)
class Workspace(Checked):
    """Box in the world frame that the robot reaches and nobody else needs; the tip stays in it.

    Attributes:
        x_m: least and largest x [m].
        y_m: least and largest y [m].
        z_m: least and largest height [m].
    """

    x_m: Annotated[tuple[float, float], Interval()] = (-0.4, 0.4)
    y_m: Annotated[tuple[float, float], Interval()] = (-0.3, 0.3)
    z_m: Annotated[tuple[float, float], Interval()] = (-0.005, 0.4)

    def holds(self, points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Return which points [m] are inside."""
        bounds = np.array([self.x_m, self.y_m, self.z_m])
        inside = (points >= bounds[:, 0]) & (points <= bounds[:, 1])
        return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True)
class ActionSpace(Checked):
    """Settings of the sampled pick-and-places.

    Attributes:
        distance_m: least and largest horizontal distance [m] (paper's reference code: 0.05 to 0.2).
        lift_m: least and largest height of the path over the straight line [m]; VCD lifts 0.07.
        edges: share of picks drawn near edges and corners; the others are anywhere on visible
            cloth, as in the reference code.
    """

    distance_m: Annotated[tuple[float, float], Interval(least=0, empty=True)] = (0.05, 0.2)
    lift_m: Annotated[tuple[float, float], Interval(least=0, empty=True)] = (0.02, 0.1)
    edges: Share = 0.7
    workspace: Workspace = field(default_factory=Workspace)


@dataclass(frozen=True, eq=False)
class SeenCloth:
    """Visible cloth from which actions are chosen.

    Attributes:
        cloud: visible points of the cloth [m], world frame, z up.
        camera: camera whose picture must contain picks and places; None: no such limit.
        table_height_m: height of the table in the world [m].
    """

    cloud: Float[np.ndarray, "points 3"]
    camera: Camera | None
    table_height_m: float = 0.0


def edge_measure(
    points: Float[np.ndarray, "points dimensions"], radius_m: float = _EDGE_REACH_M
) -> Float[np.ndarray, " points"]:
    """Return the edge strength at each point, seen from above.

    It is the distance from the point to the mean of its neighbors, over the radius: 0 inside,
    4 / (3 pi) = 0.42 on a straight edge, 0.6 in a right-angled corner.

    Args:
        points: evenly spread points [m]; only the first two coordinates are used.
        radius_m: radius of the neighborhood [m].
    """
    flat = np.asarray(points[:, :2], dtype=np.float64)
    tree = cKDTree(flat)
    pairs = tree.query_pairs(radius_m, output_type="ndarray")
    total, count = flat.copy(), np.ones(len(flat))
    for here, there in (pairs.T, pairs.T[::-1]):
        np.add.at(total, here, flat[there])
        np.add.at(count, here, 1.0)
    return np.linalg.norm(total / count[:, None] - flat, axis=1) / radius_m


def pick_weights(
    cloud: Float[np.ndarray, "points 3"],
    flat: ClothMesh | None = None,
    positions: Float[np.ndarray, "vertices 3"] | None = None,
) -> Float[np.ndarray, " points"]:
    """Return the pick probability of each visible point, higher at edges of cloud and garment.

    A hem that lies on other cloth is not an edge of the cloud. If the mesh has a hem near the
    visible surface, it counts as an edge.

    Args:
        cloud: visible points [m].
        positions: estimated positions of its vertices [m].
    """
    weights = np.maximum(edge_measure(cloud) ** 2, _LEAST_WEIGHT)
    if flat is not None and positions is not None:
        spacing = float(np.median(flat.edge_lengths))
        at_rest = edge_measure(flat.vertices, max(_EDGE_REACH_M, 2.0 * spacing)) ** 2
        gap, nearest = cKDTree(positions).query(cloud)
        own = np.where(gap < max(ON_CLOTH_M, spacing), at_rest[nearest], 0.0)
        weights = np.maximum(weights, own)
    return weights / weights.sum()


def sample_actions(
    seen: SeenCloth,
    count: int,
    space: ActionSpace,
    rng: np.random.Generator,
    *,
    weights: Float[np.ndarray, " points"] | None = None,
) -> list[PickPlace]:
    """Sample pick-and-places within all limits; fewer than `count` if few are possible."""
    cloud = seen.cloud
    weights = pick_weights(cloud) if weights is None else weights
    middle = cloud[:, :2].mean(axis=0)
    actions: list[PickPlace] = []
    for _ in range(20):
        missing = 2 * (count - len(actions))
        if missing <= 0:
            break
        near = rng.choice(len(cloud), missing, p=weights)
        picks = np.where(
            rng.random(missing) < space.edges, near, rng.integers(len(cloud), size=missing)
        )
        pick = cloud[picks].astype(np.float64)
        outward = np.arctan2(*(pick[:, :2] - middle).T[::-1])
        spread = np.where(rng.random(missing) < _OUTWARDS, np.pi / 3.0, np.pi)
        heading = outward + spread * rng.uniform(-1.0, 1.0, missing)
        distance = rng.uniform(*space.distance_m, missing)
        step = distance[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        lift = rng.uniform(*space.lift_m, missing)
        actions += within_limits(seen, pick, pick[:, :2] + step, lift, space)
    return actions[:count]


def within_limits(
    seen: SeenCloth,
    picks: Float[np.ndarray, "actions 3"],
    places: Float[np.ndarray, "actions 2"],
    lifts_m: Float[np.ndarray, " actions"],
    space: ActionSpace,
) -> list[PickPlace]:
    """Return the pick-and-places within all limits, with the height of the place.

    Args:
        picks: positions where the gripper closes [m].
        places: positions where it opens, in the plane of the table [m].
        lifts_m: height of each path over the straight line [m].
    """
    # Noise puts points of flat cloth below the table, where the gripper must not go.
    picks = np.column_stack([picks[:, :2], np.maximum(picks[:, 2], seen.table_height_m)])
    tree = cKDTree(seen.cloud[:, :2])
    ground = np.full(len(places), seen.table_height_m)
    for index, near in enumerate(tree.query_ball_point(places, ON_CLOTH_M)):
        if near:
            ground[index] = seen.cloud[near, 2].max()
    placed = np.column_stack([places, ground + RELEASE_HEIGHT_M])
    top = np.column_stack([picks[:, :2], np.maximum(picks[:, 2], placed[:, 2]) + lifts_m])
    distance = np.linalg.norm(places - picks[:, :2], axis=1)
    allowed = (distance >= space.distance_m[0] - 1e-9) & (distance <= space.distance_m[1] + 1e-9)
    for points in (picks, placed, top):
        allowed &= space.workspace.holds(points)
    for points in (picks, placed):
        allowed &= in_picture(points, seen.camera, PICTURE_MARGIN)
    return [
        PickPlace(picks[k].copy(), placed[k].copy(), float(lifts_m[k]))
        for k in np.flatnonzero(allowed)
    ]


def in_picture(
    points: Float[np.ndarray, "points 3"], camera: Camera | None, margin: float
) -> Bool[np.ndarray, " points"]:
    """Return which points [m, world] are in the picture, a share of its width from the border.

    Without a camera, all points are.
    """
    if camera is None:
        return np.ones(len(points), dtype=bool)
    pixels, depth = camera.project(points)
    border = margin * camera.width
    size = np.array([camera.width, camera.height])
    inside = (pixels >= border - 0.5) & (pixels <= size - border - 0.5)
    return inside.all(axis=1) & (depth > 0)


def off_cloth(seen: SeenCloth, actions: Sequence[PickPlace]) -> Float[np.ndarray, " actions"]:
    """Return the horizontal distance of each place from the nearest visible cloth [m]."""
    places = np.array([action.place[:2] for action in actions]).reshape(-1, 2)
    return cKDTree(seen.cloud[:, :2]).query(places)[0]
