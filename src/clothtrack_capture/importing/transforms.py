"""The ROS tree of frames (TF): the pose of one frame in another at any time."""

from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int64
from scipy.spatial.transform import Rotation, Slerp

from clothtrack.errors import TruncatedError
from clothtrack.geometry.camera import rigid_problem

# Smallest spacing of samples that a tip's path needs [ns]; joints are published at up to 1 kHz.
_CLOSEST_NS = 4_000_000


@dataclass
class _Edge:
    parent: str
    static: bool
    times: "array[int]" = field(default_factory=lambda: array("q"))
    numbers: "array[float]" = field(default_factory=lambda: array("d"))

    def at(self, times: Int64[np.ndarray, " times"]) -> Float[np.ndarray, "times 4 4"]:
        """Return the transform from child to parent at each time [ns]."""
        known, first = np.unique(np.frombuffer(self.times, dtype=np.int64), return_index=True)
        numbers = np.frombuffer(self.numbers, dtype=np.float64).reshape(-1, 7)[first]
        if len(known) == 1:
            known, numbers = known[0] + np.arange(2), numbers[[0, 0]]
        result = np.tile(np.eye(4), (len(times), 1, 1))
        inside = (np.clip(times, known[0], known[-1]) - known[0]) / 1e9
        seconds = (known - known[0]) / 1e9
        result[:, :3, :3] = Slerp(seconds, Rotation.from_quat(numbers[:, 3:]))(inside).as_matrix()
        for axis in range(3):
            result[:, axis, 3] = np.interp(inside, seconds, numbers[:, axis])
        return result


def rigid(rotation: Any, translation: Any) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a rotation (nine numbers) and a translation [m]; refuse another."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = np.reshape(rotation, (3, 3)), translation
    if problem := rigid_problem(result) if np.isfinite(result).all() else "is not finite":
        raise TruncatedError(f"a transform {problem}")
    return result


class TransformTree:
    """The frames and their transforms to their parents, collected message by message."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        return sorted({*self._edges, *(edge.parent for edge in self._edges.values())})

    def add(
        self, parent: str, child: str, time_ns: int, translation: Sequence[float],
        quaternion: Sequence[float], *, static: bool,
    ) -> None:  # fmt: skip
        """Add the pose of `child` in `parent`; ignore it if it is not rigid."""
        numbers = np.array([*translation, *quaternion], dtype=np.float64)
        if not np.isfinite(numbers).all() or not 0.5 < np.linalg.norm(numbers[3:]) < 2:
            return
        parent, child = parent.lstrip("/"), child.lstrip("/")
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent:
            edge = self._edges[child] = _Edge(parent, static)
        if edge.times and (edge.static or abs(time_ns - edge.times[-1]) < _CLOSEST_NS):
            return
        edge.times.append(time_ns)
        edge.numbers.extend(numbers.tolist())

    def add_message(self, stamped: Any, sent_ns: int, *, static: bool, written: bool = False
                    ) -> int:  # fmt: skip
        """Add a TransformStamped, at `sent_ns` if it has no time or if `written`; return that."""
        stamp = stamped.header.stamp
        time_ns = sent_ns if written else stamp.sec * 10**9 + stamp.nanosec or sent_ns
        t, q = stamped.transform.translation, stamped.transform.rotation
        self.add(stamped.header.frame_id, stamped.child_frame_id, time_ns, (t.x, t.y, t.z),
                 (q.x, q.y, q.z, q.w), static=static)  # fmt: skip
        return time_ns

    def forget(self, before_ns: int) -> None:
        """Remove samples before a time, except the last sample of each frame up to it."""
        for edge in self._edges.values():
            kept = max(bisect_right(edge.times, before_ns) - 1, 0)
            del edge.times[:kept]
            del edge.numbers[: 7 * kept]

    def root(self, frame: str) -> str:
        """Return the frame at the root of a frame's tree."""
        return self._chain(frame)[-1]

    def connects(self, first: str, other: str) -> bool:
        """Return whether both frames are in the same tree."""
        return self.root(first) == self.root(other)

    def moments(self, target: str, source: str) -> Int64[np.ndarray, " times"]:
        """Return the times [ns] at which two frames' transform is known; one time if static."""
        links = [self._edges[name] for name in {*self._chain(target)} ^ {*self._chain(source)}
                 if name in self._edges]  # fmt: skip
        known = [np.frombuffer(edge.times, dtype=np.int64) for edge in links if not edge.static]
        if not known:
            return np.zeros(1, dtype=np.int64)
        # The transform is known only where all moving links have samples.
        first, last = max(times.min() for times in known), min(times.max() for times in known)
        every = np.unique(np.concatenate(known))
        return every[(every >= first) & (every <= last)]

    def lookup(
        self, target: str, source: str, times: Int64[np.ndarray, " times"]
    ) -> Float[np.ndarray, "times 4 4"]:
        """Return the transform from frame `source` to frame `target` at each time [ns]."""
        return np.linalg.inv(self._to_root(target, times)) @ self._to_root(source, times)

    def _to_root(self, frame: str, times: np.ndarray) -> np.ndarray:
        result = np.tile(np.eye(4), (len(times), 1, 1))
        for name in self._chain(frame)[:-1]:
            result = self._edges[name].at(times) @ result
        return result

    def _chain(self, frame: str) -> list[str]:
        chain = [frame.lstrip("/")]
        while (edge := self._edges.get(chain[-1])) and edge.parent not in chain:
            chain.append(edge.parent)
        return chain
