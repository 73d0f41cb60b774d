"""Nearest neighbors between a cloud and a moving mesh, exact in every iteration of a solver."""

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp
from jaxtyping import Bool, Float

from clothtrack.alignment import nearest_kernels as kernels

_MOST_CELLS = 1 << 17


Command = Callable[[], object]


def launching(
    kernel: wp.Kernel, dim: int, inputs: list[object], device: str | wp.Device
) -> Command:
    """Return the launch of a kernel as a command for later."""
    return partial(wp.launch, kernel, dim=dim, inputs=inputs, device=device)


def do_all(commands: list[Command]) -> None:
    """Run the commands one after another."""
    for command in commands:
        command()


def made_ready(commands: list[Command]) -> list[Command]:
    """Return the commands with packed launch arguments; repeating them costs a tenth.

    Do not use this for a capture, which would not record them.
    """
    return [
        command(record_cmd=True).launch if getattr(command, "func", None) is wp.launch else command
        for command in commands
    ]


class MovingGrid:
    """Grid of some of an array's points, which may move until the grid is built again.

    Args:
        members: indices of the points in the grid.
        lower: lower corner of the box that contains the initial points [m].
        upper: its upper corner [m].
        cell_m: edge of a cell [m]; increased if the box would need too many cells.
    """

    def __init__(
        self,
        members: np.ndarray,
        lower: Float[np.ndarray, " 3"],
        upper: Float[np.ndarray, " 3"],
        *,
        cell_m: float,
        points: int,
        device: str | wp.Device,
    ) -> None:
        extent = np.asarray(upper, np.float64) - lower
        counts = np.floor(extent / cell_m).astype(np.int64) + 1
        while counts.prod() > _MOST_CELLS:
            cell_m *= 1.25
            counts = np.floor(extent / cell_m).astype(np.int64) + 1
        self.count = cells = int(counts.prod())
        self.members = wp.array(members.astype(np.int32), dtype=wp.int32, device=device)
        self.recorded = wp.zeros(points, dtype=wp.vec3, device=device)
        self.cells = kernels.Grid()
        self.cells.origin = wp.vec3(*np.asarray(lower, np.float64).tolist())
        self.cells.cells_per_meter = 1.0 / cell_m
        self.cells.width, self.cells.height, self.cells.depth = (int(c) for c in counts)
        # One entry more than there are cells: the scan's last entry is the end of the last cell.
        self.cells.first = wp.zeros(cells + 1, dtype=wp.int32, device=device)
        self.cells.items = wp.zeros(len(members), dtype=wp.int32, device=device)
        self._room = wp.zeros(cells + 1, dtype=wp.int32, device=device)
        self._device = device

    def build(self, positions: wp.array) -> None:
        """Sort the members into cells by their current positions [m]."""
        do_all(self.building(positions))

    def building(self, positions: wp.array) -> list[Command]:
        """Return the commands of `build`."""
        count, fill = (
            launching(
                kernel,
                len(self.members),
                [positions, self.members, self.cells, *rest],
                self._device,
            )
            for kernel, rest in (
                (kernels.count_in_cells, [self._room]),
                (kernels.fill_cells, [self._room, self.recorded]),
            )
        )

        def scan() -> None:
            wp.utils.array_scan(self._room, self.cells.first, inclusive=False)

        return [self._room.zero_, count, scan, fill]


class Matcher:
    """Matches of cloud to visible vertices and of trusted vertices to cloud, updated by `launch`.

    Args:
        cloud: observed points [m], on the device.
        positions: vertices [m], on the device; the solver overwrites them.
        visible: vertices that a cloud point can belong to; at least one.
        trusted: vertices that are matched to a cloud point.
        spacing_m: typical distance of neighboring vertices [m]; it sets the size of the cells.
        range_m: smallest and largest distance of a vertex's partner [m].
    """

    def __init__(
        self,
        cloud: wp.array,
        positions: wp.array,
        visible: Bool[np.ndarray, " vertices"],
        trusted: Bool[np.ndarray, " vertices"],
        *,
        spacing_m: float,
        range_m: tuple[float, float],
    ) -> None:
        device, vertices = positions.device, len(positions)
        self._device = device
        self._strip = 64 if wp.get_device(device).is_cpu else 1
        self._range, self._reach = range_m, 0.3 * spacing_m
        members, seekers = np.flatnonzero(visible), np.flatnonzero(trusted)
        seen, points = positions.numpy()[members], cloud.numpy()
        self.grid = MovingGrid(
            members, *_box(seen), cell_m=spacing_m, points=vertices, device=device
        )
        self._cloud_grid = MovingGrid(
            np.arange(len(points)), *_box(points),
            cell_m=spacing_m, points=len(points), device=device,
        )  # fmt: skip
        self._cloud_grid.build(cloud)
        self._cloud, self.searched = cloud, wp.array(visible, dtype=wp.bool, device=device)
        self._nearest = wp.full(len(points), -1, dtype=wp.int32, device=device)
        self._cells = wp.zeros(len(points), dtype=wp.int32, device=device)
        self._limit = wp.zeros(len(points), dtype=wp.float32, device=device)
        self.pulled_count = wp.zeros(vertices, dtype=wp.int32, device=device)
        self.pulled_sum = wp.zeros(3 * vertices, dtype=wp.int64, device=device)
        self._seekers = wp.array(seekers.astype(np.int32), dtype=wp.int32, device=device)
        self._seeker_nearest = wp.full(len(seekers), -1, dtype=wp.int32, device=device)
        self._seeker_others = wp.full(len(seekers), -1.0, dtype=wp.float32, device=device)
        self._seeker_from = wp.zeros(len(seekers), dtype=wp.vec3, device=device)
        self.partner = wp.full(vertices, -1, dtype=wp.int32, device=device)
        self.progress = kernels.Progress()
        self.progress.iteration = wp.full(1, -1, dtype=wp.int32, device=device)
        self.progress.traveled = wp.zeros(self.grid.count, dtype=wp.float32, device=device)
        self.progress.step = wp.zeros(self.grid.count, dtype=wp.float32, device=device)
        self.progress.stale = wp.zeros(1, dtype=wp.float32, device=device)
        self.progress.next_stale = wp.zeros(1, dtype=wp.float32, device=device)
        self.progress.partners = wp.zeros(1, dtype=wp.int32, device=device)
        self.progress.decays = wp.ones(2, dtype=wp.float64, device=device)
        self.rebuild(positions)

    def rebuild(self, positions: wp.array) -> None:
        """Sort the visible vertices anew; this affects speed only, not the result."""
        do_all(self.rebuilding(positions))

    def rebuilding(self, positions: wp.array) -> list[Command]:
        """Return the commands of `rebuild`."""
        return [*self.grid.building(positions), self.progress.next_stale.zero_]

    def launch(self, positions: wp.array, sums: wp.array) -> None:
        """Begin an iteration: match at these positions [m] and add data residuals to the sums."""
        do_all(self.matching(positions, sums))

    def matching(self, positions: wp.array, sums: wp.array) -> list[Command]:
        """Return the commands of `launch`."""
        advance = launching(kernels.advance, self.grid.count, [self.progress], self._device)
        match_points = launching(
            kernels.match_points,
            -(-len(self._cloud) // self._strip),
            [
                self._cloud,
                positions,
                self.grid.cells,
                self.progress,
                self._reach,
                self._nearest,
                self._cells,
                self._limit,
                self.pulled_count,
                self.pulled_sum,
                sums,
                self._strip,
            ],
            self._device,
        )
        if not len(self._seekers):
            return [advance, match_points]
        match_vertices = launching(
            kernels.match_vertices,
            len(self._seekers),
            [
                self._seekers,
                positions,
                self._cloud,
                self._cloud_grid.cells,
                self.progress,
                self._reach,
                *self._range,
                self._seeker_nearest,
                self._seeker_others,
                self._seeker_from,
                self.partner,
            ],
            self._device,
        )
        return [advance, match_points, match_vertices]

    def nearest_vertices(self) -> np.ndarray:
        """Return the vertex that each cloud point belongs to."""
        return self._nearest.numpy()

    def partners(self) -> np.ndarray:
        """Return the cloud point that each vertex is pulled to, or -1."""
        return self.partner.numpy()


def _box(
    points: Float[np.ndarray, "points 3"],
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Return lower and upper corner of the box around points [m]."""
    # Process axis by axis, because extremes along rows of three are slow.
    return np.array([axis.min() for axis in points.T]), np.array([axis.max() for axis in points.T])
