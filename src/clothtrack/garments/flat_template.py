"""Template mesh of a garment from its flat outline: layers, seams and openings."""

import itertools
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import one_layer, sewn, towel, with_vertices
from clothtrack.garments.openings import (
    CORNER_SHARE,
    OPENINGS,
    SewnKind,
    corners_of,
    find_openings,
    openings_at,
)
from clothtrack.garments.outlines import NECK_POINTS
from clothtrack.garments.silhouettes import Outline, Silhouette, signed_area
from clothtrack.garments.triangulation import Span, evenly_along
from clothtrack.geometry.mesh import ClothMesh

TemplateKind = Literal["towel", "tshirt", "polo", "sweater", "trousers"]
"""Garments for which a template can be made."""

_USUAL_FRONT_NECK_SHARE = 0.10
"""Default depth of the front neckline as a share of the garment's length; the picture shows only
that of the back."""

_RECTANGLE_SHARE = 0.02
"""A towel is a rectangle if its area differs from the rectangle's by less than this share."""

_MIRROR_LIMIT_SHARE = 0.05
"""Halves that differ by more than this share of the garment's extent (root mean square) are not
mirrored."""

_STRETCH_POINTS = 241
"""Points per stretch for comparing both halves; odd, so that one is in the middle."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Named part of a garment's outline.

    Attributes:
        points: points on the upright garment [m].
        pixels: the same points in the picture; column and row.
    """

    name: str
    points: Outline
    pixels: Outline

    @property
    def sewn(self) -> bool:
        """Whether front and back are sewn together here."""
        return self.name not in (*OPENINGS, "edge")

    @property
    def length_m(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class FlatTemplate:
    """Template of a garment and the outline that it was made from.

    Attributes:
        mesh: the flat mesh, neck or waist toward +y, with canonical coordinates.
        asymmetry_m: root mean square distance between each half and the mirror image of the other
            [m].
        neck_seen: whether the neck's ends were detected rather than guessed.
    """

    kind: TemplateKind
    mesh: ClothMesh
    stretches: tuple[Stretch, ...]
    asymmetry_m: float = 0.0
    mirrored: bool = False
    neck_seen: bool = True

    @property
    def hem_share(self) -> float:
        """Width of a shirt's hem over that between its armpits; 1 for another garment."""
        if self.kind in ("towel", "trousers"):
            return 1.0
        hem, side = (stretch.points for stretch in self.stretches[:2])
        across = np.array([side[0, 1] - side[-1, 1], side[-1, 0] - side[0, 0]])
        armpit = side[int(((side - side[0]) @ across).argmax())]
        return float((hem[-1, 0] - hem[0, 0]) / (2.0 * abs(armpit[0])))

    @property
    def measures(self) -> dict[str, float]:
        """Width and length [m], area of the outline [m^2], mean length of each stretch [m]."""
        points = np.concatenate([stretch.points[:-1] for stretch in self.stretches])
        width, length = np.ptp(points, axis=0).tolist()
        lengths: dict[str, list[float]] = {}
        for stretch in self.stretches:
            name = "sleeve" if stretch.name == "shoulder" else stretch.name.replace(" ", "_")
            lengths.setdefault(f"{name}_m", []).append(stretch.length_m)
        means = {name: float(np.mean(values)) for name, values in lengths.items()}
        return {"width_m": width, "length_m": length, "area_m2": signed_area(points), **means}


def make_template(
    outline: Silhouette,
    kind: TemplateKind,
    *,
    vertex_count: int = 1000,
    front_neck_m: float | None = None,
    openings: Float[np.ndarray, "ends 2"] | None = None,
    mirrored: bool = True,
    seed: int = 0,
    name: str = "the picture",
) -> FlatTemplate:
    """Make the template of a garment from its outline when it lies flat, front up.

    Args:
        front_neck_m: depth of the front neckline [m]; None: a tenth of the length.
    """
    if kind not in get_args(TemplateKind):
        raise InvalidConfigError(
            f"kind is {kind!r}; a template can be made of: {', '.join(get_args(TemplateKind))}"
        )
    if front_neck_m is not None and kind in ("towel", "trousers"):
        raise InvalidConfigError(f"front_neck_m: a {kind} has no neck; leave it out")
    if kind == "towel":
        if openings is not None:
            raise InvalidConfigError("openings: a towel has none; leave them out")
        return _towel_template(outline, vertex_count, seed)
    return _sewn_template(
        outline, kind, openings, vertex_count=vertex_count, front_neck_m=front_neck_m,
        mirrored=mirrored, seed=seed, name=name,
    )  # fmt: skip


def _sewn_template(
    outline: Silhouette,
    kind: SewnKind,
    pixels: Float[np.ndarray, "ends 2"] | None,
    *,
    vertex_count: int,
    front_neck_m: float | None,
    mirrored: bool,
    seed: int,
    name: str,
) -> FlatTemplate:
    found = find_openings(outline, kind, name) if pixels is None else openings_at(
        outline, kind, pixels
    )  # fmt: skip
    numbers = range(len(found.names))
    evenly = [evenly_along(found.stretch(number), _STRETCH_POINTS) for number in numbers]
    in_picture = [evenly_along(found.stretch_pixels(number), _STRETCH_POINTS) for number in numbers]
    parts, asymmetry = _about_their_axis(evenly)
    extent = float(np.ptp(np.concatenate(parts), axis=0).max())
    mirrored = mirrored and asymmetry <= _MIRROR_LIMIT_SHARE * extent
    if mirrored:
        parts = [0.5 * (part + other) for part, other in zip(parts, _images(parts), strict=True)]
    around = np.concatenate([part[:-1] for part in parts])
    middle = 0.5 * (around.min(axis=0) + around.max(axis=0))
    parts = [part - (0.0 if mirrored else middle[0], middle[1]) for part in parts]
    stretches = tuple(Stretch(*each) for each in zip(found.names, parts, in_picture, strict=True))
    back = [span for stretch in stretches for span in _spans(stretch, CORNER_SHARE * extent)]
    front = back
    if kind != "trousers":
        length = float(np.ptp(around[:, 1]))
        depth = _USUAL_FRONT_NECK_SHARE * length if front_neck_m is None else front_neck_m
        if not 0.0 < depth < 0.5 * length:
            raise InvalidConfigError(
                f"front_neck_m is {depth:.3g} for a length of {length:.3g} m; it must be above 0 "
                "and less than half of the length"
            )
        front = [
            span
            for stretch in stretches
            for span in (
                [Span(_front_neck(stretch.points, depth))]
                if stretch.name == "neck"
                else _spans(stretch, CORNER_SHARE * extent)
            )
        ]
    mesh = sewn(front, back, vertex_count=vertex_count, seed=seed)
    return FlatTemplate(kind, mesh, stretches, asymmetry, mirrored, found.neck_seen)


def _towel_template(outline: Silhouette, vertex_count: int, seed: int) -> FlatTemplate:
    """Return a one-layer template: a rectangle if the outline is one, else the outline itself."""
    upright = _levelled(outline)
    corners = _rectangle(upright.points)
    width, length = (corners[2] - corners[0]).tolist()
    extent = max(width, length)
    area = signed_area(upright.points)
    spread = np.abs(_to_rectangle(upright.points, width, length))
    if abs(area / (width * length) - 1.0) < _RECTANGLE_SHARE and spread.mean() < 0.01 * extent:
        mesh = with_vertices(
            lambda edge_m: towel(width, length, edge_m),
            vertex_count,
            float(np.sqrt(width * length / vertex_count)),
        )
        at = [int(np.linalg.norm(upright.points - corner, axis=1).argmin()) for corner in corners]
        sides = [
            Stretch("edge", corners[[k, (k + 1) % 4]], upright.pixels[[at[k], at[(k + 1) % 4]]])
            for k in range(4)
        ]
        return FlatTemplate("towel", mesh, tuple(sides))
    closed = np.concatenate([upright.points, upright.points[:1]])
    closed = closed - 0.5 * (closed.min(axis=0) + closed.max(axis=0))
    pixels = np.concatenate([upright.pixels, upright.pixels[:1]])
    # Begin at a corner, because the first point becomes a corner of the mesh.
    start = int(np.linalg.norm(closed[:-1], axis=1).argmax())
    order = np.append(np.roll(np.arange(len(closed) - 1), -start), start)
    edge = Stretch("edge", closed[order], pixels[order])
    mesh = one_layer(_spans(edge, CORNER_SHARE * extent), vertex_count=vertex_count, seed=seed)
    return FlatTemplate("towel", mesh, (edge,))


def _levelled(outline: Silhouette) -> Silhouette:
    """Rotate by less than an eighth of a turn to align the longest straight edges to the axes."""
    (_, _, degrees) = cv2.minAreaRect(outline.points.astype(np.float32))
    steps = np.roll(outline.points, -8, axis=0) - np.roll(outline.points, 8, axis=0)
    angles = np.arctan2(steps[:, 1], steps[:, 0])
    angle = np.radians(degrees)
    for reach in (0.2, 0.1, 0.05):
        # Angles of the edges modulo a quarter turn, near the current angle.
        off = (angles - angle + np.pi / 4) % (np.pi / 2) - np.pi / 4
        near = off[np.abs(off) < reach]
        angle += float(np.mean(near)) if len(near) else 0.0
    angle = (angle + np.pi / 4) % (np.pi / 2) - np.pi / 4
    return outline.upright(np.pi / 2 + angle)


def _rectangle(points: Outline) -> Float[np.ndarray, "4 2"]:
    """Return the axis-aligned rectangle fitted to the outline's sides, counterclockwise."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    sides = []
    for axis in (0, 1):
        other = points[:, 1 - axis]
        central = np.abs(other - 0.5 * (low + high)[1 - axis]) < 0.4 * size[1 - axis]
        near_low = central & (points[:, axis] < low[axis] + 0.25 * size[axis])
        near_high = central & (points[:, axis] > high[axis] - 0.25 * size[axis])
        sides.append((np.median(points[near_low, axis]), np.median(points[near_high, axis])))
    (x0, x1), (y0, y1) = sides
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def _to_rectangle(points: Outline, width: float, length: float) -> Float[np.ndarray, " points"]:
    """Return signed distances [m] of points to a rectangle at their middle; negative inside."""
    centered = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
    beyond = np.abs(centered) - 0.5 * np.array([width, length])
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return outside + np.minimum(beyond.max(axis=1), 0.0)


def _about_their_axis(parts: list[Outline]) -> tuple[list[Outline], float]:
    """Rotate and shift stretches to be most symmetric; return them and the asymmetry [m]."""
    count = len(parts)
    ours = np.concatenate(parts)
    theirs = np.concatenate([parts[-number % count][::-1] for number in range(count)])
    middle = ours.mean(axis=0)
    moment = (theirs - middle).T @ (ours - middle)
    axis = 0.5 * np.arctan2(moment[0, 1] + moment[1, 0], moment[0, 0] - moment[1, 1])
    if np.sin(axis) < 0.0:
        axis += np.pi
    cosine, sine = np.cos(axis - np.pi / 2), np.sin(axis - np.pi / 2)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    upright = [(part - middle) @ turn for part in parts]
    apart = np.concatenate(upright) - np.concatenate(_images(upright))
    return upright, float(np.sqrt(np.mean((apart**2).sum(axis=1))))


def _images(parts: list[Outline]) -> list[Outline]:
    """Return the mirror image of each stretch's counterpart, in the direction of the stretch."""
    count = len(parts)
    return [parts[-number % count][::-1] * (-1.0, 1.0) for number in range(count)]


def _spans(stretch: Stretch, bend_m: float) -> list[Span]:
    """Cut a stretch at its corners, symmetrically on both sides of the garment."""
    points = stretch.points
    last = len(points) - 1
    if not stretch.sewn and stretch.name != "edge":
        return [Span(points)]
    if stretch.name == "inner seam":
        half = corners_of(points[: last // 2 + 1], bend_m)
        corners = sorted({*half, *(last - index for index in half)})
    elif points[0, 0] + points[-1, 0] < 0.0:
        corners = [last - index for index in corners_of(points[::-1] * (-1.0, 1.0), bend_m)][::-1]
    else:
        corners = corners_of(points, bend_m)
    return [Span(points[a : b + 1], sewn=stretch.sewn) for a, b in itertools.pairwise(corners)]


def _front_neck(back: Outline, depth_m: float) -> Outline:
    """Return the front neckline: half an ellipse, or that of the back if it is deeper."""
    start, end = back[0], back[-1]
    middle, half = 0.5 * (start + end), 0.5 * (start - end)
    if middle[1] - back[len(back) // 2, 1] >= depth_m:
        return back
    turn = np.linspace(0.0, np.pi, NECK_POINTS)[:, None]
    return middle + np.cos(turn) * half - np.sin(turn) * (0.0, depth_m)
