"""Detection of a tool's colored tip in one picture, to subpixel precision and in depth.

A tip is a few pixels wide, and half of its depth is missing or mixed with the background. So its
end is found in the color picture. The depth there comes from a line fitted to the depths along the
tip, chosen by the number of depths that agree with it. Lines with few depths in front of them are
preferred, because mixed depths are always farther.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.colors import (
    CORE,
    LOOSE,
    NAMED_COLORS,
    learned_set,
    named_set,
    votes_of,
)

LEAST_PIXELS = 8
"""Least number of surely tip-colored pixels; fewer are specks."""
WIDEST_SHARE = 0.03
"""Largest share of the picture that a tip may cover; a tip is only a few pixels wide."""
_ELONGATED = 2.0
"""Length over width from which a tip has an end; for a rounder tip its middle is used."""
_DEPTH_BAND_M = 0.003
"""Distance within which depths along the tip agree with a line [m]."""
STEEPEST = 3.0
"""Largest change of depth along the tip [m] per meter across."""
_RADIUS_M = 0.0015
"""Half the thickness of the tip [m]; depth is measured on its surface."""
_SECOND_SHARE = 0.4
"""A second piece with at least this share of the first one's pixels is the other arm of open
tweezers."""
_WIDEST_GAP_M = 0.1
"""Largest distance between two arms of the same tool [m]."""
_LASTING_SHARE = 0.9
_LEARNING_ROUNDS = 2
_JOINING = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class Tip:
    """A tip in one picture.

    Attributes:
        pixel: column and row of the tip's end.
        position: position of the end in the world [m].
        axis: unit vector in the picture that points to its end; zero for a round tip.
        gap_m: distance between the two arms [m]; 0 for one arm, or closed ones.
        pixels: number of pixels that show it.
    """

    pixel: Float[np.ndarray, " 2"]
    position: Float[np.ndarray, " 3"]
    axis: Float[np.ndarray, " 2"]
    gap_m: float
    pixels: int


def tip_colors(name: str) -> UInt8[np.ndarray, "32 32 32"]:
    """Return the set of colors that a name stands for."""
    if name.lower() not in NAMED_COLORS:
        raise InvalidConfigError(
            f"the tip's color is {name!r}; known names: {', '.join(NAMED_COLORS)}"
        )
    return named_set(name)


class TipFinder:
    """A detector for a tip of known colors in the pictures of one camera."""

    def __init__(
        self,
        members: UInt8[np.ndarray, "32 32 32"],
        camera: Camera,
        *,
        background: Bool[np.ndarray, "height width"] | None = None,
    ) -> None:
        """Look for these colors; `background` has them but does not belong to the tip."""
        self._members, self._camera = members, camera
        self._background = background

    def _votes(
        self, color: UInt8[np.ndarray, "height width 3"]
    ) -> UInt8[np.ndarray, "height width"]:
        """Return the color vote of every pixel, without the background."""
        votes = votes_of(color, self._members)
        if self._background is not None:
            votes[self._background] = 0
        return votes

    def find(
        self,
        color: UInt8[np.ndarray, "height width 3"],
        depth_m: Float[np.ndarray, "height width"],
        *,
        near: Float[np.ndarray, " 2"] | None = None,
        axis: Float[np.ndarray, " 2"] | None = None,
    ) -> Tip | None:
        """Return the tip in a picture (red first); None if it is not seen.

        Args:
            near: recent position of the tip [pixels]; pieces near it are preferred.
            axis: recent direction of its end, used in place of the direction from depth if it is
                reliable.
        """
        pieces = self.pieces(color, near=near)
        tips = [tip for piece in pieces if (tip := self._end_of(piece, depth_m, axis)) is not None]
        if not tips:
            return None
        first, *others = tips
        for other in others:
            gap = float(np.linalg.norm(other.position - first.position))
            if gap < _WIDEST_GAP_M:
                return Tip(
                    0.5 * (first.pixel + other.pixel),
                    0.5 * (first.position + other.position),
                    first.axis,
                    gap,
                    first.pixels + other.pixels,
                )
        return first

    def pieces(
        self,
        color: UInt8[np.ndarray, "height width 3"],
        *,
        near: Float[np.ndarray, " 2"] | None = None,
    ) -> list[Int[np.ndarray, "pixels 2"]]:
        """Return pixels (column, row) of up to two pieces of tip color, likeliest first."""
        votes = self._votes(color)
        sure = votes == CORE
        if np.count_nonzero(sure) < LEAST_PIXELS:
            return []
        joined = cv2.morphologyEx(
            (sure | (votes == LOOSE)).view(np.uint8), cv2.MORPH_CLOSE, _JOINING
        )
        count, labels = cv2.connectedComponents(joined, connectivity=8)
        rows, columns = np.nonzero(votes)
        of_piece = labels[rows, columns]
        areas = np.bincount(of_piece[sure[rows, columns]], minlength=count).astype(float)
        areas[0] = 0.0
        areas[np.bincount(of_piece, minlength=count) > WIDEST_SHARE * votes.size] = 0.0
        worth = areas.copy()
        if near is not None:
            for piece in np.flatnonzero(areas >= LEAST_PIXELS):
                inside = of_piece == piece
                middle = columns[inside].mean(), rows[inside].mean()
                worth[piece] /= 1.0 + (np.hypot(*(middle - near)) / 100.0) ** 2
        best = int(np.argmax(worth))
        chosen = [best] if areas[best] >= LEAST_PIXELS else []
        for piece in np.argsort(-worth):
            large = areas[piece] >= max(_SECOND_SHARE * areas[best], LEAST_PIXELS)
            if chosen and piece != best and large:
                chosen.append(int(piece))
                break
        return [
            np.stack([columns[of_piece == piece], rows[of_piece == piece]], axis=1)
            for piece in chosen
        ]

    def _end_of(
        self,
        pixels: Int[np.ndarray, "pixels 2"],
        depth_m: Float[np.ndarray, "height width"],
        axis: Float[np.ndarray, " 2"] | None,
    ) -> Tip | None:
        """Return the end of one piece; None if its depth is not known."""
        middle = pixels.mean(axis=0)
        spread, directions = np.linalg.eigh(np.cov((pixels - middle).T) + 1e-9 * np.eye(2))
        along = directions[:, 1]
        places = (pixels - middle) @ along
        depths = depth_m[pixels[:, 1], pixels[:, 0]].astype(np.float64)
        line = self._depth_line(places[depths > 0], depths[depths > 0])
        if line is None:
            return None
        offset, slope = line
        if np.sqrt(spread[1] / max(spread[0], 1.0 / 12.0)) < _ELONGATED:
            return self._tip(middle, offset, np.zeros(2), len(pixels))
        # The tool comes from above, so the end of the tip is the far one.
        sign = np.sign(slope * np.ptp(places))
        if axis is not None and np.linalg.norm(axis) > 0.3:
            sign = np.sign(axis @ along)
        sign = float(sign) or 1.0
        end = sign * float(np.max(sign * places))
        return self._tip(middle + end * along, offset + slope * end, sign * along, len(pixels))

    def _tip(
        self,
        pixel: Float[np.ndarray, " 2"],
        depth: float,
        axis: Float[np.ndarray, " 2"],
        pixels: int,
    ) -> Tip:
        camera = self._camera
        ray = np.array([(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1])
        local = ray * (depth + _RADIUS_M)
        position = camera.world_from_camera[:3, :3] @ local + camera.position
        return Tip(np.asarray(pixel, dtype=float), position, axis, 0.0, pixels)

    def _depth_line(
        self, places: Float[np.ndarray, " pixels"], depths: Float[np.ndarray, " pixels"]
    ) -> tuple[float, float] | None:
        """Return depth [m] in the middle of the tip and its slope per pixel, or None."""
        if len(depths) < 3:
            return None
        band = _DEPTH_BAND_M
        steepest = STEEPEST * float(np.median(depths)) / self._camera.fx
        first, second = np.triu_indices(len(depths), 1)
        if len(first) > 4000:
            chosen = np.linspace(0, len(first) - 1, 4000).astype(int)
            first, second = first[chosen], second[chosen]
        apart = places[second] - places[first]
        wide = np.abs(apart) > 0.25 * np.ptp(places)
        first, second, apart = first[wide], second[wide], apart[wide]
        if not len(first):
            return float(np.median(depths)), 0.0
        slopes = (depths[second] - depths[first]) / apart
        gentle = np.abs(slopes) <= steepest
        slopes, first = slopes[gentle], first[gentle]
        if not len(slopes):
            return None
        offsets = depths[first] - slopes * places[first]
        off = depths - offsets[:, None] - slopes[:, None] * places
        agreeing = (np.abs(off) < band).sum(axis=1)
        # Each depth in front of a line counts against it, half as much as an agreeing one.
        agreeing = agreeing - 0.5 * (off < -band).sum(axis=1)
        best = int(np.argmax(agreeing))
        used = np.abs(off[best]) < band
        if used.sum() < 3 or np.ptp(places[used]) < 1.0:
            return float(np.median(depths[used])), 0.0
        slope, offset = np.polyfit(places[used], depths[used], 1)
        return float(offset), float(np.clip(slope, -steepest, steepest))


def learned_finder(
    looks: Sequence[tuple[UInt8[np.ndarray, "_ _ 3"], Float[np.ndarray, "_ _"]]],
    members: UInt8[np.ndarray, "32 32 32"],
    camera: Camera,
) -> TipFinder:
    """Return a finder whose colors are learned from the recording, starting from these.

    Cloth and table have colors similar to the tip's in shade, and where two colors mix at an edge.
    So the detected tip is compared with the rest of the same pictures, and a color is kept if it is
    more frequent on the tip.

    Args:
        looks: color (red first) and depth [m] of pictures from the whole recording.
    """
    pictures = [color for color, _ in looks]
    members, background = _without_surroundings(pictures, members)
    finder = TipFinder(members, camera, background=background)
    strip = np.concatenate(pictures)
    for _ in range(_LEARNING_ROUNDS):
        marks = []
        for color, _ in looks:
            mark = np.zeros(color.shape[:2], dtype=bool)
            for pixels in finder.pieces(color):
                mark[pixels[:, 1], pixels[:, 0]] = True
            marks.append(mark)
        tip = np.concatenate(marks)
        around = cv2.dilate(tip.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
        learned = learned_set(strip, tip, ~around)
        if not (learned == CORE).any():
            break
        finder = TipFinder(learned, camera, background=background)
    return finder


def _without_surroundings(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]],
    members: UInt8[np.ndarray, "32 32 32"],
) -> tuple[UInt8[np.ndarray, "32 32 32"], Bool[np.ndarray, "height width"]]:
    """Return the tip's colors without the surroundings' ones, and pixels never on the tip."""
    votes = [votes_of(picture, members) for picture in pictures]
    sure = np.mean([vote == CORE for vote in votes], axis=0)
    if sure.mean() > 2.0 * WIDEST_SHARE:
        raise InvalidConfigError(
            f"the tip's color covers {100 * sure.mean():.0f} % of the pictures (at most "
            f"{200 * WIDEST_SHARE:.0f} %): table or cloth have it too; mark the tip in another "
            "color, or click on it"
        )
    if np.mean([vote == LOOSE for vote in votes]) > WIDEST_SHARE:
        members = np.where(members == CORE, members, 0).astype(np.uint8)
    lasting = (sure >= _LASTING_SHARE) & (len(pictures) > 2)
    return members, cv2.dilate(lasting.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
