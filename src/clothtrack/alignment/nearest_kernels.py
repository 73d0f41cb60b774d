"""Warp kernels that keep nearest neighbors exact while vertices move a little at a time.

A search stores the distance of the runner-up. The runner-up can have come closer since then by at
most the traveled distance. If the current neighbor is closer than that bound, it is still the
nearest, and one distance replaces a search. This is the triangle inequality as in G. Hamerly,
"Making k-means even faster" (SDM 2010, doi:10.1137/1.9781611972801.12). Otherwise a uniform grid
is searched in a ball whose radius is the distance of the current neighbor. The grid may contain
positions from some steps ago, so the ball is enlarged by the largest motion of any vertex since.

The traveled distance sums, over the iterations, the longest step of the vertices nearby. It does
not use the longest step of all vertices, because one vertex that oscillates between two partners
would then cause a search for every point. A cell stores the longest step that ended in it or in a
neighboring cell. This bounds the motion of every vertex that was farther from a point of the cell
than some distance of at most the cell's edge, because a vertex that comes nearer ends its step
there.

Ties go to the lower index and sums are integers (fixed point), so the order of threads does not
matter: CPU and GPU find the same neighbors, and every run is reproducible.
"""

# Warp needs `float(0.0)` for a variable that changes in a loop, and kernels take many arrays.

from typing import no_type_check

import warp as wp

FIXED_POINT_LENGTH = 2.0**32
"""Units per meter of summed positions."""

FIXED_POINT_SQUARE = 2.0**44
"""Units per square meter of summed squares."""

_LENGTH = wp.constant(FIXED_POINT_LENGTH)
_SQUARE = wp.constant(wp.float64(FIXED_POINT_SQUARE))
_ROUNDING = wp.constant(1.0e-6)
_SURELY_BESIDE = wp.constant(0.999)
"""Points at most this many cell edges apart along an axis are in the same or in adjacent cells."""

_NOT_NEGATIVE = wp.constant(0x7FFFFFFF)
"""An index with this mask is never negative, so the compiler needs no check at every access."""


@no_type_check
@wp.struct
class Grid:
    """Box of cubic cells, x fastest; points outside belong to the nearest border cell."""

    origin: wp.vec3
    cells_per_meter: wp.float32
    width: wp.int32
    height: wp.int32
    depth: wp.int32
    first: wp.array(dtype=wp.int32)
    items: wp.array(dtype=wp.int32)


@no_type_check
@wp.struct
class Progress:
    """State on the device while the solver runs: arrays of one, or of one entry per cell.

    `traveled` [m] bounds, per cell of the vertices' grid, the path of any vertex in it or next to
    it since the start: the sum over the iterations of the longest step. `step` is the longest one
    of the current iteration. `stale` [m] is the largest distance of a vertex from its position in
    the grid, `next_stale` the same after the current step. `decays` contains 0.9 and 0.999 to the
    power of the number of iterations begun (Adam's bias correction).
    """

    iteration: wp.array(dtype=wp.int32)
    traveled: wp.array(dtype=wp.float32)
    step: wp.array(dtype=wp.float32)
    stale: wp.array(dtype=wp.float32)
    next_stale: wp.array(dtype=wp.float32)
    partners: wp.array(dtype=wp.int32)
    decays: wp.array(dtype=wp.float64)


@no_type_check
@wp.struct
class _Neighbor:
    """The nearest item (-1: none in reach), its distance, and a lower bound for all others [m]."""

    item: wp.int32
    distance: wp.float32
    others: wp.float32


@no_type_check
@wp.func
def _cell(grid: Grid, value: wp.float32, axis: wp.int32, count: wp.int32):
    place = wp.floor((value - grid.origin[axis]) * grid.cells_per_meter)
    return wp.int32(wp.clamp(place, 0.0, float(count - 1)))


@no_type_check
@wp.func
def _cell_of(grid: Grid, point: wp.vec3):
    x = _cell(grid, point[0], 0, grid.width)
    y = _cell(grid, point[1], 1, grid.height)
    z = _cell(grid, point[2], 2, grid.depth)
    return (z * grid.height + y) * grid.width + x


@no_type_check
@wp.kernel(enable_backward=False)
def count_in_cells(
    points: wp.array(dtype=wp.vec3),
    members: wp.array(dtype=wp.int32),
    grid: Grid,
    counts: wp.array(dtype=wp.int32),
):
    """Count the member points in each cell."""
    point = points[members[wp.tid()]]
    wp.atomic_add(counts, _cell_of(grid, point), 1)


@no_type_check
@wp.kernel(enable_backward=False)
def fill_cells(
    points: wp.array(dtype=wp.vec3),
    members: wp.array(dtype=wp.int32),
    grid: Grid,
    room: wp.array(dtype=wp.int32),
    recorded: wp.array(dtype=wp.vec3),
):
    """Put each member into its cell, counting down free places in `room`; record its position."""
    member = members[wp.tid()]
    point = points[member]
    cell = _cell_of(grid, point)
    place = wp.atomic_sub(room, cell, 1)
    grid.items[grid.first[cell] + place - 1] = member
    recorded[member] = point


@no_type_check
@wp.func
def _search(
    point: wp.vec3,
    points: wp.array(dtype=wp.vec3),
    grid: Grid,
    radius: wp.float32,
    stale: wp.float32,
):
    """Return the nearest item within a radius; items outside are at least the radius away."""
    reach = radius + stale
    x0 = _cell(grid, point[0] - reach, 0, grid.width)
    x1 = _cell(grid, point[0] + reach, 0, grid.width)
    y0 = _cell(grid, point[1] - reach, 1, grid.height)
    y1 = _cell(grid, point[1] + reach, 1, grid.height)
    z0 = _cell(grid, point[2] - reach, 2, grid.depth)
    z1 = _cell(grid, point[2] + reach, 2, grid.depth)
    best = radius * radius
    second = radius * radius
    found = int(-1)
    for z in range(z0, z1 + 1):
        for y in range(y0, y1 + 1):
            row = (z * grid.height + y) * grid.width
            following = grid.first[row + x0]
            end = grid.first[row + x1 + 1]
            while following < end:
                item = grid.items[following & _NOT_NEGATIVE] & _NOT_NEGATIVE
                following += 1
                offset = points[item] - point
                square = wp.dot(offset, offset)
                if square < best or (square == best and item < found):
                    second = best
                    best = square
                    found = item
                elif square < second:
                    second = square
    result = _Neighbor()
    result.item = found
    result.distance = wp.sqrt(best)
    result.others = wp.sqrt(second)
    return result


@no_type_check
@wp.func
def _search_far(
    point: wp.vec3,
    points: wp.array(dtype=wp.vec3),
    grid: Grid,
    radius: wp.float32,
    farthest: wp.float32,
    stale: wp.float32,
):
    """Return the nearest item up to a distance; double the ball until it contains one."""
    ball = wp.min(radius, farthest)
    result = _search(point, points, grid, ball, stale)
    while result.item < 0 and ball < farthest:
        ball = wp.min(2.0 * ball, farthest)
        result = _search(point, points, grid, ball, stale)
    return result


@no_type_check
@wp.kernel(enable_backward=False)
def advance(progress: Progress):
    """Start the next iteration, a thread per cell: add up steps, reset the partner count."""
    cell = wp.tid()
    progress.traveled[cell] = progress.traveled[cell] + progress.step[cell]
    progress.step[cell] = 0.0
    if cell > 0:
        return
    progress.iteration[0] = progress.iteration[0] + 1
    progress.stale[0] = progress.next_stale[0]
    progress.next_stale[0] = 0.0
    progress.partners[0] = 0
    progress.decays[0] = progress.decays[0] * wp.float64(0.9)
    progress.decays[1] = progress.decays[1] * wp.float64(0.999)


@no_type_check
@wp.func
def record_step(grid: Grid, progress: Progress, before: wp.vec3, after: wp.vec3):
    """Record the length of a vertex's step [m] in the cell in which it ends and its neighbors."""
    way = wp.length(after - before)
    # This also skips NaN, which has no cell.
    if not way > 0.0:
        return
    column = _cell(grid, after[0], 0, grid.width)
    row = _cell(grid, after[1], 1, grid.height)
    layer = _cell(grid, after[2], 2, grid.depth)
    for z in range(wp.max(layer - 1, 0), wp.min(layer + 2, grid.depth)):
        for y in range(wp.max(row - 1, 0), wp.min(row + 2, grid.height)):
            for x in range(wp.max(column - 1, 0), wp.min(column + 2, grid.width)):
                cell = (z * grid.height + y) * grid.width + x
                if way > progress.step[cell]:
                    wp.atomic_max(progress.step, cell, way)


@no_type_check
@wp.func
def _match_point(
    number: wp.int32,
    cloud: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    grid: Grid,
    progress: Progress,
    reach: wp.float32,
    nearest: wp.array(dtype=wp.int32),
    cells: wp.array(dtype=wp.int32),
    limit: wp.array(dtype=wp.float32),
    pulled_count: wp.array(dtype=wp.int32),
    pulled_sum: wp.array(dtype=wp.int64),
):
    point = cloud[number]
    stale = progress.stale[0]
    before = nearest[number]
    offset = wp.vec3()
    search = before < 0
    distance = float(0.0)
    if before >= 0:
        offset = positions[before] - point
        distance = wp.length(offset)
        search = distance + progress.traveled[cells[number]] + _ROUNDING > limit[number]
    else:
        cells[number] = _cell_of(grid, point)
    if search:
        found = _Neighbor()
        if before < 0:
            found = _search_far(point, positions, grid, 4.0 * reach, 1.0e6, stale)
        else:
            found = _search(point, positions, grid, distance + reach, stale)
        others = wp.min(found.others, _SURELY_BESIDE / grid.cells_per_meter)
        limit[number] = others + progress.traveled[cells[number]]
        vertex = found.item
        if vertex != before and vertex >= 0:
            x = wp.int64(point[0] * _LENGTH)
            y = wp.int64(point[1] * _LENGTH)
            z = wp.int64(point[2] * _LENGTH)
            if before >= 0:
                wp.atomic_sub(pulled_count, before, 1)
                wp.atomic_sub(pulled_sum, 3 * before, x)
                wp.atomic_sub(pulled_sum, 3 * before + 1, y)
                wp.atomic_sub(pulled_sum, 3 * before + 2, z)
            wp.atomic_add(pulled_count, vertex, 1)
            wp.atomic_add(pulled_sum, 3 * vertex, x)
            wp.atomic_add(pulled_sum, 3 * vertex + 1, y)
            wp.atomic_add(pulled_sum, 3 * vertex + 2, z)
            nearest[number] = vertex
            offset = positions[vertex] - point
    return offset


@no_type_check
@wp.kernel(enable_backward=False)
def match_points(
    cloud: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    grid: Grid,
    progress: Progress,
    reach: wp.float32,
    nearest: wp.array(dtype=wp.int32),
    cells: wp.array(dtype=wp.int32),
    limit: wp.array(dtype=wp.float32),
    pulled_count: wp.array(dtype=wp.int32),
    pulled_sum: wp.array(dtype=wp.int64),
    sums: wp.array2d(dtype=wp.int64),
    strip: wp.int32,
):
    """Find the nearest visible vertex of each cloud point; update point counts and sums.

    Args:
        cloud: the observed points [m].
        positions: the current vertices [m].
        reach: distance beyond the neighbor that a search covers [m].
        limit: runner-up distance at the last search plus `traveled` in the cell at that time [m].
    """
    start = wp.tid() * strip
    total = wp.float64(0.0)
    for number in range(start, wp.min(start + strip, cloud.shape[0])):
        offset = _match_point(
            number,
            cloud,
            positions,
            grid,
            progress,
            reach,
            nearest,
            cells,
            limit,
            pulled_count,
            pulled_sum,
        )
        square = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
        total += wp.float64(square)
    wp.atomic_add(sums, progress.iteration[0], 0, wp.int64(total * _SQUARE))


@no_type_check
@wp.kernel(enable_backward=False)
def match_vertices(
    vertices: wp.array(dtype=wp.int32),
    positions: wp.array(dtype=wp.vec3),
    cloud: wp.array(dtype=wp.vec3),
    grid: Grid,
    progress: Progress,
    reach: wp.float32,
    shortest: wp.float32,
    longest: wp.float32,
    nearest: wp.array(dtype=wp.int32),
    others: wp.array(dtype=wp.float32),
    searched_from: wp.array(dtype=wp.vec3),
    partner: wp.array(dtype=wp.int32),
):
    """Find the nearest cloud point of each trusted vertex: its partner if it is in range.

    Args:
        positions: all current vertices [m].
        cloud: the observed points [m].
        reach: distance beyond the neighbor that a search covers [m].
        shortest: smallest distance of partners [m].
        longest: largest distance of partners [m].
        others: runner-up distance at the last search [m]; -1 before the first search.
        searched_from: position of the vertex at that search [m].
    """
    number = wp.tid()
    vertex = vertices[number]
    position = positions[vertex]
    item = nearest[number]
    moved = wp.length(position - searched_from[number])
    bound = longest
    distance = longest + 1.0
    if item >= 0:
        distance = wp.length(cloud[item] - position)
        bound = distance
    # Without a neighbor in reach, the nearest relevant point is at `longest`.
    if bound + moved + _ROUNDING > others[number]:
        # The earlier neighbor bounds the ball; the first search starts with a small one.
        ball = wp.where(item >= 0, distance, 3.0 * reach)
        ball = wp.where(item < 0 and others[number] >= 0.0, longest, ball)
        found = _search_far(position, cloud, grid, ball + reach, longest + reach, 0.0)
        item = found.item
        distance = found.distance
        if item < 0:
            distance = longest + 1.0
        nearest[number] = item
        others[number] = found.others
        searched_from[number] = position
    if item >= 0 and distance >= shortest and distance <= longest:
        partner[vertex] = item
        wp.atomic_add(progress.partners, 0, 1)
    else:
        partner[vertex] = -1
