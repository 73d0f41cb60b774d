"""Another cloth that a page shows beside the tracked one: the truth, or a second run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.truth import Truth
from clothtrack.report.coloring import Coloring, graded_limit, true_positions
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


@dataclass(frozen=True, eq=False)
class Ghost:
    """A cloth to compare with, at the frames of another one.

    Attributes:
        title: what it is.
        faces: vertex indices per triangle.
        positions: vertices [m]; where nobody knows them, those of a frame nearby.
        known: whether somebody knows where it is.
    """

    title: str
    faces: Int[np.ndarray, "faces 3"]
    positions: Float[np.ndarray, "frames vertices 3"]
    known: Bool[np.ndarray, " frames"]

    def at(self, steps: Sequence[int]) -> "Ghost":
        """The same at some of the frames."""
        return Ghost(self.title, self.faces, self.positions[steps], self.known[steps])


def true_ghost(tracked: TrackedTrajectory, truth: Truth) -> Ghost:
    """The truth with the triangles of the tracked mesh.

    Raises:
        InvalidResultError: the truth is of another garment or another recording.
    """
    return _filled("the truth", tracked.mesh.faces, true_positions(tracked, truth))


def second_ghost(tracked: TrackedTrajectory, second: TrackedTrajectory) -> Ghost:
    """A second run, at the frames of the first.

    Raises:
        InvalidResultError: the two runs have no frame in common.
    """
    place = {frame: step for step, frame in enumerate(second.frames.tolist())}
    positions = np.full((len(tracked.frames), second.mesh.vertex_count, 3), np.nan, np.float32)
    for step, frame in enumerate(tracked.frames.tolist()):
        if frame in place:
            positions[step] = second.positions[place[frame]]
    if not np.isfinite(positions).any():
        raise InvalidResultError(
            f"{second.name}: has no frame of {tracked.name}; compare two runs of one recording"
        )
    return _filled("the second run", second.mesh.faces, positions)


def run_differences(tracked: TrackedTrajectory, ghost: Ghost) -> list[Coloring]:
    """Distance [mm] of each vertex to the same one of a second run; none where meshes differ."""
    if not np.array_equal(ghost.faces, tracked.mesh.faces):
        return []
    values = 1e3 * np.linalg.norm(tracked.positions - ghost.positions, axis=2).astype(np.float32)
    values[~ghost.known] = np.nan
    note = "Where two runs disagree, at least one of them is wrong."
    title = "Distance to the second run [mm]"
    return [Coloring("second", title, note, graded_limit(values), values)]


def _filled(
    title: str,
    faces: Int[np.ndarray, "faces 3"],
    positions: Float[np.ndarray, "frames vertices 3"],
) -> Ghost:
    known = np.isfinite(positions).all(axis=(1, 2))
    steps = np.arange(len(known))
    nearest = np.abs(steps[:, None] - steps[known][None]).argmin(axis=1)
    return Ghost(title, np.asarray(faces), positions[steps[known][nearest]], known)
