"""Outlines of flat garments, from which front and back are cut.

An outline is a list of spans, counterclockwise from the left end of the hem. Sewn spans are seams
between front and back; the others are openings.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.triangulation import Span

_UNDERARM = 0.04
"""Minimum distance of a random sleeve's end from the body, as a share of the shirt's length."""

NECK_POINTS = 65
"""Points of a neckline's half ellipse."""


@dataclass(frozen=True)
class ShirtOutline:
    """Proportions of a shirt relative to its length from hem to neck, with sleeves of any length.

    Attributes:
        waist: width at the hem relative to that under the arms.
        shoulder: distance of the sleeve's start from the middle, relative to half the width under
            the arms.
        slope: drop of the shoulder from the neck to the sleeve.
        armhole: distance from the end of the shoulder down to the armpit.
        sleeve_angle_rad: angle of that edge below the horizontal [rad].
        hood: height of a hood that lies flat behind the neck; 0: there is none.
        hood_width: half the width of the hood where it is widest, at least `neck`.
    """

    body: float = 0.74
    waist: float = 1.0
    shoulder: float = 0.9
    slope: float = 0.05
    armhole: float = 0.3
    sleeve: float = 0.3
    sleeve_angle_rad: float = 0.6
    cuff: float = 0.22
    neck: float = 0.13
    front_depth: float = 0.10
    back_depth: float = 0.03
    hood: float = 0.0
    hood_width: float = 0.2

    def spans(self, length_m: float, *, depth: float) -> list[Span]:
        """Return the outline of one layer of a shirt of this length [m] with this neck depth."""
        right = self._right(length_m)
        return shirt_spans(right, neckline(right, depth * length_m))

    def hooded_back(self, length_m: float) -> list[Span]:
        """Return the outline [m] of the back, whose neckline is the seam of the hood."""
        return shirt_spans(self._right(length_m), self._hood_seam(length_m))

    def hood_front(self, length_m: float) -> list[Span]:
        """Return the outline [m] of the upper layer of the hood, which is open below."""
        seam = self._hood_seam(length_m)
        return [seam, Span(seam.points[[-1, 0]])]

    def _hood_seam(self, length_m: float) -> Span:
        """Return the arc of an ellipse from the right end of the neck over the top to the left."""
        neck, wide, high = np.array([self.neck, self.hood_width, self.hood]) * length_m
        begins = np.arccos(min(neck / wide, 1.0))
        radius = high / (1.0 + np.sin(begins))
        turn = np.linspace(-begins, np.pi + begins, NECK_POINTS)
        above = radius * (np.sin(begins) + np.sin(turn))
        points = np.stack([wide * np.cos(turn), 0.5 * length_m + above], axis=1)
        return Span(points, sewn=True)

    def _right(self, length_m: float) -> Float[np.ndarray, "6 2"]:
        """Return the right half [m], from the hem up to the neck."""
        top, half = 0.5 * length_m, 0.5 * self.body * length_m
        x, y = self.shoulder * half, top - self.slope * length_m
        out = np.array([np.cos(self.sleeve_angle_rad), -np.sin(self.sleeve_angle_rad)])
        across = np.array([-np.sin(self.sleeve_angle_rad), -np.cos(self.sleeve_angle_rad)])
        cuff = np.array([x, y]) + self.sleeve * length_m * out
        corners = np.array(
            [
                (half * self.waist, -top),
                (half, y - self.armhole * length_m),
                cuff + self.cuff * length_m * across,
                cuff,
                (x, y),
                (self.neck * length_m, top),
            ]
        )
        if not (corners[:, 0] > 0.0).all() or _crosses_itself(corners):
            raise InvalidConfigError(
                f"the outline of {self} crosses itself; give a shorter or a higher sleeve, or a "
                "smaller cuff"
            )
        return corners


def draw_shirt(rng: np.random.Generator, *, long_sleeves: float = 0.35) -> ShirtOutline:
    """Draw random proportions of a shirt, a polo or a sweater."""

    def draw() -> ShirtOutline:
        long = rng.random() < long_sleeves
        return ShirtOutline(
            body=rng.uniform(0.6, 0.95),
            waist=rng.uniform(0.85, 1.1),
            shoulder=rng.uniform(0.78, 0.98),
            slope=rng.uniform(0.03, 0.09),
            armhole=rng.uniform(0.24, 0.36),
            sleeve=rng.uniform(0.55, 0.95) if long else rng.uniform(0.12, 0.4),
            sleeve_angle_rad=rng.uniform(0.3, 1.1) if long else rng.uniform(0.15, 1.1),
            cuff=rng.uniform(0.1, 0.17) if long else rng.uniform(0.17, 0.28),
            neck=rng.uniform(0.09, 0.16),
            front_depth=rng.uniform(0.04, 0.14),
            back_depth=rng.uniform(0.015, 0.04),
        )

    return _with_free_sleeves(draw)


_SWEATER = {
    "body": (0.75, 1.05), "waist": (0.72, 0.98), "shoulder": (0.72, 0.92), "slope": (0.05, 0.12),
    "armhole": (0.3, 0.42), "sleeve": (0.6, 0.95), "sleeve_angle_rad": (0.4, 1.2),
    "cuff": (0.11, 0.2), "neck": (0.1, 0.17), "front_depth": (0.02, 0.2),
    "back_depth": (0.01, 0.03),
}  # fmt: skip
_ROBE = {
    "body": (0.42, 0.62), "waist": (0.98, 1.25), "shoulder": (0.82, 1.0), "slope": (0.02, 0.05),
    "armhole": (0.16, 0.26), "sleeve": (0.15, 0.52), "sleeve_angle_rad": (0.2, 1.0),
    "cuff": (0.1, 0.18), "neck": (0.05, 0.09), "front_depth": (0.03, 0.25),
    "back_depth": (0.008, 0.02),
}  # fmt: skip


def draw_sweater(rng: np.random.Generator) -> ShirtOutline:
    """Draw random proportions of a sweater or cardigan: wide, narrow hem, low shoulders."""
    return _with_free_sleeves(lambda: _drawn(rng, _SWEATER))


def with_hood(outline: ShirtOutline, rng: np.random.Generator) -> ShirtOutline:
    """Draw a hood for an outline."""
    wide = max(rng.uniform(0.16, 0.26), 1.05 * outline.neck)
    return replace(outline, hood=rng.uniform(0.3, 0.5), hood_width=wide)


def draw_robe(rng: np.random.Generator) -> ShirtOutline:
    """Draw random proportions of a robe, a coat or a nightshirt: narrow for its length."""
    return _with_free_sleeves(lambda: _drawn(rng, _ROBE))


def _drawn(rng: np.random.Generator, ranges: Mapping[str, tuple[float, float]]) -> ShirtOutline:
    return ShirtOutline(**{name: rng.uniform(*limits) for name, limits in ranges.items()})


def _with_free_sleeves(draw: Callable[[], ShirtOutline]) -> ShirtOutline:
    """Draw until the outline does not cross itself and the sleeves' ends are off the body."""
    while True:
        outline = draw()
        try:
            spans = outline.spans(1.0, depth=outline.front_depth)
        except InvalidConfigError:
            continue
        # The spans after the hem are the right side (1) and the sleeve's lower edge (2).
        armpit, cuff = spans[2].points
        if cuff[0] - max(armpit[0], spans[1].points[0, 0]) > _UNDERARM:
            return outline


@dataclass(frozen=True)
class TrousersOutline:
    """Proportions of trousers relative to their length from cuffs to waist, with any leg length.

    Attributes:
        hip: half the width at the hips, halfway between waist and crotch.
        rise: distance from the waist down to the crotch.
        spread_rad: outward angle of a leg's center line [rad].
        thigh: width of a leg at the crotch.
    """

    waist: float = 0.19
    hip: float = 0.25
    rise: float = 0.28
    spread_rad: float = 0.12
    thigh: float = 0.26
    cuff: float = 0.17

    def spans(self, length_m: float) -> list[Span]:
        """Return the outline of one layer of trousers of this length [m], counterclockwise."""
        along = np.array([np.sin(self.spread_rad), -np.cos(self.spread_rad)])
        across = np.array([np.cos(self.spread_rad), np.sin(self.spread_rad)])
        crotch = np.array([0.0, 0.5 - self.rise])
        leg = crotch + 0.5 * self.thigh * across
        end = leg + along * (0.5 + leg[1]) / -along[1]
        right = np.array(
            [
                crotch,
                end - 0.5 * self.cuff * across,
                end + 0.5 * self.cuff * across,
                crotch + self.thigh * across,
                (self.hip, 0.5 - 0.5 * self.rise),
                (self.waist, 0.5),
            ]
        )
        if not (right[1:, 0] > 0.0).all() or _crosses_itself(right):
            raise InvalidConfigError(
                f"the outline of {self} crosses itself; spread the legs, or make them narrower"
            )
        right = right * length_m
        up, down = _both_sides(right, cuff=1)
        return [*up, Span(np.stack([right[-1], right[-1] * (-1.0, 1.0)])), *down]


def draw_trousers(rng: np.random.Generator, *, short: float = 0.35) -> TrousersOutline:
    """Draw random proportions of trousers."""
    # With short legs, waist and rise are large relative to the length.
    scale = rng.uniform(1.5, 2.2) if rng.random() < short else 1.0
    hip = scale * rng.uniform(0.22, 0.28)
    while True:
        outline = TrousersOutline(
            waist=hip * rng.uniform(0.72, 0.95),
            hip=hip,
            rise=scale * rng.uniform(0.24, 0.32),
            spread_rad=rng.uniform(0.08, 0.3),
            thigh=hip * rng.uniform(0.98, 1.12),
            cuff=hip * rng.uniform(0.5, 0.95),
        )
        try:
            outline.spans(1.0)
        except InvalidConfigError:
            continue
        return outline


def tshirt_corners(width_m: float, length_m: float) -> Float[np.ndarray, "6 2"]:
    """Return the right half of the standard T-shirt [m], from the hem up to the neck.

    The body takes three fifths of the width from cuff to cuff; sleeves slope downward.
    """
    top = length_m / 2.0
    return np.array(
        [
            (0.30 * width_m, -top),
            (0.30 * width_m, top - 0.32 * length_m),
            (0.42 * width_m, top - 0.42 * length_m),
            (0.50 * width_m, top - 0.22 * length_m),
            (0.27 * width_m, top - 0.06 * length_m),
            (0.11 * width_m, top),
        ]
    )


def neckline(right: Float[np.ndarray, "6 2"], depth_m: float) -> Span:
    """Return the open neckline of a shirt: half an ellipse of this depth [m].

    Args:
        right: right half of the shirt [m]; the neck ends at its last corner.
        depth_m: depth of the neckline [m].
    """
    turn = np.linspace(0.0, np.pi, NECK_POINTS)
    neck, top = right[-1]
    return Span(np.stack([neck * np.cos(turn), top - depth_m * np.sin(turn)], axis=1))


def shirt_spans(right: Float[np.ndarray, "6 2"], neck: Span) -> list[Span]:
    """Return the symmetric outline of one layer of a shirt.

    Args:
        right: its right half [m]: hem, armpit, lower and upper end of the cuff, shoulder, neck.
    """
    up, down = _both_sides(right, cuff=2)
    return [Span(np.stack([right[0] * (-1.0, 1.0), right[0]])), *up, neck, *down]


def _both_sides(
    right: Float[np.ndarray, "corners 2"], *, cuff: int
) -> tuple[list[Span], list[Span]]:
    """Return spans up the right half and down its mirror image; all but the cuff are sewn."""
    left = right * (-1.0, 1.0)
    steps = list(enumerate(pairwise(range(len(right)))))
    up = [Span(right[[a, b]], sewn=number != cuff) for number, (a, b) in steps]
    down = [Span(left[[b, a]], sewn=number != cuff) for number, (a, b) in steps]
    return up, down[::-1]


def cut_open(spans: list[Span]) -> tuple[list[Span], list[Span]]:
    """Cut the outline of a shirt (`shirt_spans`) along its middle, from the neck to the hem."""
    number = len(spans) // 2
    hem, up, neck, down = spans[0], spans[1:number], spans[number], spans[number + 1 :]
    middle = np.array([0.0, hem.points[0, 1]])
    half = len(neck.points) // 2
    top = neck.points[half]
    right = [
        Span(np.stack([middle, hem.points[-1]])), *up, Span(neck.points[: half + 1]),
        Span(np.stack([top, middle])),
    ]  # fmt: skip
    left = [
        Span(np.stack([hem.points[0], middle])), Span(np.stack([middle, top])),
        Span(neck.points[half:]), *down,
    ]  # fmt: skip
    return left, right


def _crosses_itself(corners: Float[np.ndarray, "corners 2"]) -> bool:
    """Return whether two nonadjacent segments of an open polyline cross each other."""

    def turns(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return float((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])

    stretches = list(pairwise(corners))
    for first, (a, b) in enumerate(stretches):
        for c, d in stretches[first + 2 :]:
            if turns(a, b, c) * turns(a, b, d) < 0.0 and turns(c, d, a) * turns(c, d, b) < 0.0:
                return True
    return False
