"""Find the side of an intersection contour on which each vertex lies, by flooding the mesh."""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})


@no_type_check
@wp.kernel
def flood(
    first: wp.array(dtype=int),
    edges: wp.array(dtype=int),
    seeds: wp.array2d(dtype=int),
    offsets: wp.array(dtype=int),
    neighbors: wp.array(dtype=int),
    joining: wp.array(dtype=int),
    cut: wp.array2d(dtype=wp.uint8),
    queue: wp.array2d(dtype=int),
    labels: wp.array2d(dtype=wp.int8),
):
    """Label each vertex 1 or 2 by the nearer side of a cut, in edges; 0: not reached.

    A thread handles one sheet of one contour. Its crossings are those from its `first` to the next
    thread's. The edges in them are cut. Their ends above the triangles that they pass through are
    seeds of label 1, those below are seeds of label 2. `offsets`, `neighbors` and `joining` are the
    mesh as a graph, with the edge to each neighbor. The last three arrays have shape (sheets, edges
    or vertices).
    """
    sheet = wp.tid()
    end = int(0)
    for number in range(first[sheet], first[sheet + 1]):
        cut[sheet, edges[number]] = wp.uint8(1)
        for side in range(2):
            seed = seeds[number, side]
            if labels[sheet, seed] == wp.int8(0):
                labels[sheet, seed] = wp.int8(side + 1)
                queue[sheet, end] = seed
                end += 1
    begin = int(0)
    while begin < end:
        vertex = queue[sheet, begin]
        begin += 1
        for place in range(offsets[vertex], offsets[vertex + 1]):
            other = neighbors[place]
            if labels[sheet, other] == wp.int8(0) and cut[sheet, joining[place]] == wp.uint8(0):
                labels[sheet, other] = labels[sheet, vertex]
                queue[sheet, end] = other
                end += 1
