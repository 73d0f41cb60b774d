"""ChArUco boards: the pose of a camera relative to a printed board of known size."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.optimize import least_squares

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera

_LEAST_CORNERS = 6
"""Least number of board corners from which a pose is computed."""

_DICTIONARIES = ("4X4_50", "4X4_100", "5X5_50", "5X5_100", "6X6_50", "6X6_250", "7X7_50")


@dataclass(frozen=True)
class Board:
    """A printed ChArUco board: a chessboard with a marker in every white square.

    The origin of its frame is the middle of the board, x runs along the columns, y up along the
    rows, and z points out of the paper.

    Attributes:
        columns: squares along the width.
        rows: squares along the height.
        square_m: side of a square [m], measured on the print.
        marker_m: side of a marker [m].
        dictionary: marker dictionary, such as "4X4_50".
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        """Refuse boards that cannot be printed."""
        if self.columns < 3 or self.rows < 3:
            raise InvalidConfigError(
                f"a board of {self.columns} x {self.rows} squares; give at least 3 x 3"
            )
        if not 0.0 < self.marker_m < self.square_m:
            raise InvalidConfigError(
                f"square_m is {self.square_m} and marker_m {self.marker_m}; both in meters, the "
                "marker smaller than its square"
            )
        if self.dictionary not in _DICTIONARIES:
            raise InvalidConfigError(
                f"dictionary is {self.dictionary!r}; choose from {', '.join(_DICTIONARIES)}"
            )

    @cached_property
    def corners(self) -> Float[np.ndarray, "corners 3"]:
        """Inner corners of the chessboard in the board's frame [m], ordered by id."""
        across, down = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        x = (across - self.columns / 2.0) * self.square_m
        y = (self.rows / 2.0 - down) * self.square_m
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)

    def picture(self, pixels_per_square: int) -> UInt8[np.ndarray, "height width"]:
        """Return the board as a black and white picture to print, without a margin."""
        size = self.columns * pixels_per_square, self.rows * pixels_per_square
        return self._boards[0].generateImage(size)

    def find(
        self, color: UInt8[np.ndarray, "height width 3"]
    ) -> tuple[Int[np.ndarray, " found"], Float[np.ndarray, "found 2"]]:
        """Return the ids and pixels (column, row) of the corners seen in a picture, if any.

        Boards printed by old versions of OpenCV, whose first square is white, are recognized too.
        """
        gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        best = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        for board in self._boards:
            corners, ids, *_ = cv2.aruco.CharucoDetector(board).detectBoard(gray)
            if ids is not None and len(ids) > len(best[0]):
                best = ids.ravel().astype(np.int64), corners.reshape(-1, 2).astype(np.float64)
        return best

    @cached_property
    def _boards(self) -> tuple[cv2.aruco.CharucoBoard, cv2.aruco.CharucoBoard]:
        named = getattr(cv2.aruco, f"DICT_{self.dictionary}")
        markers = cv2.aruco.getPredefinedDictionary(named)
        boards = []
        for legacy in (False, True):
            size = self.columns, self.rows
            board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, markers)
            board.setLegacyPattern(legacy)
            boards.append(board)
        return boards[0], boards[1]


@dataclass(frozen=True, eq=False)
class BoardPose:
    """The pose of a board in a camera's frame.

    Attributes:
        camera_from_board: rigid 4 x 4, board to camera [m].
        corners: number of corners used.
        residual_px: root mean square reprojection error of the corners [pixels].
    """

    camera_from_board: Float[np.ndarray, "4 4"]
    corners: int
    residual_px: float


def locate_board(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]], board: Board, camera: Camera
) -> BoardPose:
    """Return the pose of a static board, estimated jointly from all pictures (red first)."""
    seen = [board.find(picture) for picture in pictures]
    ids = np.concatenate([one for one, _ in seen])
    pixels = np.concatenate([one for _, one in seen])
    if len(set(ids.tolist())) < _LEAST_CORNERS:
        raise InvalidRecordingError(
            f"camera {camera.name!r}: {len(set(ids.tolist()))} corners of the board are seen (at "
            f"least {_LEAST_CORNERS}); check the number of squares, the dictionary "
            f"({board.dictionary}), light and focus"
        )
    points = board.corners[ids]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    # A distant plane has two poses that fit almost equally well. Refine both and keep the better.
    _, turns, shifts, *_ = cv2.solvePnPGeneric(
        points, pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    local = Camera(camera.name, camera.width, camera.height, camera.fx, camera.fy, camera.cx,
                   camera.cy)  # fmt: skip

    def off(pose: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " _"]:
        turned = points @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
        return (local.project(turned)[0] - pixels).ravel()

    starts = [np.concatenate([t.ravel(), s.ravel()]) for t, s in zip(turns, shifts, strict=True)]
    fits = [least_squares(off, start, method="lm") for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(best.x[:3])[0], best.x[3:]
    residual = float(np.sqrt(2.0 * best.cost / len(ids)))
    if residual > 3.0 or pose[2, 3] <= 0.0:
        raise InvalidRecordingError(
            f"camera {camera.name!r}: the board fits its corners only to {residual:.1f} pixels (at "
            "most 3); it moved between the pictures, or the intrinsics or its size are wrong"
        )
    return BoardPose(pose, len(ids), residual)


def locate_boards(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]], board: Board, camera: Camera
) -> list[BoardPose | None]:
    """Return the pose of a moving board in each picture; None where it is not found."""

    def one(picture: UInt8[np.ndarray, "height width 3"]) -> BoardPose | None:
        try:
            return locate_board([picture], board, camera)
        except InvalidRecordingError:
            return None

    return [one(picture) for picture in pictures]
