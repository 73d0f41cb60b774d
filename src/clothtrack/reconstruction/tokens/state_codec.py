"""Vertices of a mesh in many states as small numbers: each is predicted from others before it.

Across an edge from a triangle, the fourth corner of the parallelogram is near the next vertex (C.
Touma, C. Gotsman, "Triangle mesh compression", 1998). What is left takes a third of the bytes.
Numbers wrap around at 16 bits on both ways, so that every state comes back exactly.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, Int16, UInt8

from clothtrack.errors import InvalidResultError


class Prediction(NamedTuple):
    """How vertices are predicted.

    Attributes:
        order: of all vertices, those that others are predicted from before them.
        corners: of each vertex, three before it: it is predicted as first + second - third; -1
            where none is before it, which is predicted as zero.
    """

    order: Int[np.ndarray, " vertices"]
    corners: Int[np.ndarray, "vertices 3"]


def prediction(faces: Int[np.ndarray, "faces 3"], vertices: int) -> Prediction:
    """Find for each vertex a triangle that it lies across an edge from.

    Args:
        faces: vertices of each triangle; every vertex is in one.
        vertices: their number.
    """
    corners = np.full((vertices, 3), -1)
    known = np.zeros(vertices, bool)
    order: list[int] = []
    for vertex, before in _walk([tuple(row) for row in faces.tolist()]):
        if not known[vertex]:
            known[vertex] = True
            corners[vertex] = before
            order.append(vertex)
    return Prediction(np.array(order), corners)


Triangle = tuple[int, int, int]


def _walk(faces: Sequence[Triangle]) -> Iterator[tuple[int, Triangle]]:
    """Yield corners of all faces with what is before them, from each face across its edges."""
    across: dict[tuple[int, int], list[int]] = {}
    for number, face in enumerate(faces):
        for one, two, _ in _edges(face):
            across.setdefault((min(one, two), max(one, two)), []).append(number)
    done = [False] * len(faces)
    for start, (first, *others) in enumerate(faces):
        if done[start]:
            continue
        # A piece of its own: its first triangle has no other to lean on.
        done[start] = True
        yield first, (-1, -1, -1)
        yield from ((vertex, (first, first, first)) for vertex in others)
        waiting = deque([start])
        while waiting:
            for one, two, opposite in _edges(faces[waiting.popleft()]):
                for number in across[min(one, two), max(one, two)]:
                    if not done[number]:
                        done[number] = True
                        waiting.append(number)
                        (vertex,) = set(faces[number]) - {one, two}
                        yield vertex, (one, two, opposite)


def _edges(face: Triangle) -> tuple[Triangle, Triangle, Triangle]:
    """The ends of each edge, and the corner opposite."""
    a, b, c = face
    return (a, b, c), (b, c, a), (c, a, b)


def coded(
    states: Int16[np.ndarray, "states vertices 3"], how: Prediction
) -> UInt8[np.ndarray, " bytes"]:
    """Write states as what their prediction leaves, all low bytes before all high ones."""
    whole = states.astype(np.int32)
    leans = how.corners[:, 0] >= 0
    first, second, third = how.corners[leans].T
    left = whole.copy()
    left[:, leans] -= whole[:, first] + whole[:, second] - whole[:, third]
    left = np.moveaxis(left.astype(np.int16)[:, how.order], 2, 0)
    # Small numbers of both signs become small ones without a sign.
    unsigned = ((left << 1) ^ (left >> 15)).view(np.uint16)
    return np.concatenate([(unsigned & 255).ravel(), (unsigned >> 8).ravel()]).astype(np.uint8)


def decoded(
    content: UInt8[np.ndarray, " bytes"], how: Prediction
) -> Int16[np.ndarray, "states vertices 3"]:
    """Read states that `coded` has written.

    Raises:
        InvalidResultError: the bytes are not those of whole states.
    """
    vertices = len(how.order)
    if len(content) % (6 * vertices):
        raise InvalidResultError(
            f"{len(content)} bytes are no whole number of states of {vertices} vertices; pack the "
            "states again"
        )
    low, high = content.reshape(2, 3, -1, vertices).astype(np.uint16)
    unsigned = low | (high << 8)
    left = (unsigned >> 1).view(np.int16) ^ -(unsigned & 1).view(np.int16)
    # Vertices first: each is one row, which is read and written at once.
    found = np.zeros((vertices, left.shape[1], 3), np.int16)
    rows = np.ascontiguousarray(np.moveaxis(left, (0, 2), (2, 0)))
    for row, vertex in zip(rows, how.order.tolist(), strict=True):
        first, second, third = how.corners[vertex].tolist()
        found[vertex] = row
        if first >= 0:
            found[vertex] += found[first] + found[second] - found[third]
    return np.ascontiguousarray(np.swapaxes(found, 0, 1))
