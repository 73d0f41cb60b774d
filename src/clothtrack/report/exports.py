"""Export of a tracked trajectory as arrays, meshes, a contact sheet or a video."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import atomic_file, atomic_folder
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.mesh_file import write_mesh
from clothtrack.recordings.recording import Recording
from clothtrack.report.overlay import (
    Overlay,
    OverlayConfig,
    write_contact_sheet,
    write_overlay_video,
)
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

ExportFormat = Literal["npz", "obj", "ply", "glb"]
PictureFormat = Literal["sheet", "mp4"]
_SUFFIXES = {"sheet": ".png", "mp4": ".mp4"}


def export(tracked: TrackedTrajectory, out: Path, format: ExportFormat) -> Path:  # noqa: A002
    """Write a tracked trajectory for other programs and return its path.

    `npz`: one file; docs/result_format.md lists its arrays.

    `obj`, `ply`, `glb`: a folder with `frame_000000.obj` and so on, numbered as in the recording,
    and for each action `action_00_before.obj` and `action_00_after.obj`, the mesh around the final
    alignment. The vertex order is the same in all of them.
    """
    if format not in get_args(ExportFormat):
        raise InvalidConfigError(
            f"format is {format!r}; choose one of {', '.join(get_args(ExportFormat))}"
        )
    if format == "npz":
        out = _with_suffix(out, ".npz")
        with atomic_file(out) as temporary:
            np.savez_compressed(temporary, allow_pickle=False, **_arrays(tracked))
        return out
    with atomic_folder(out) as folder:
        for name, positions in _named_meshes(tracked):
            mesh = ClothMesh(positions, tracked.mesh.faces)
            write_mesh(mesh, folder / f"{name}.{format}")
    return out


def _with_suffix(out: Path, suffix: str) -> Path:
    return out if out.suffix == suffix else Path(f"{out}{suffix}")


def _arrays(tracked: TrackedTrajectory) -> dict[str, np.ndarray]:
    before = [action.positions_before_final_alignment for action in tracked.actions]
    canonical = tracked.mesh.canonical
    named = {} if canonical is None else {"canonical": canonical.astype(np.float32)}
    return {
        **named,
        "rest_positions": tracked.mesh.vertices.astype(np.float32),
        "positions": tracked.positions.astype(np.float32),
        "positions_before_final_alignment": np.reshape(
            np.asarray(before, dtype=np.float32), (-1, tracked.mesh.vertex_count, 3)
        ),
        "faces": tracked.mesh.faces.astype(np.int32),
        "frames": tracked.frames,
        "visible": tracked.visible,
        "time_s": tracked.time_s,
    }


def _named_meshes(
    tracked: TrackedTrajectory,
) -> Iterator[tuple[str, Float[np.ndarray, "vertices 3"]]]:
    for frame, positions in zip(tracked.frames, tracked.positions, strict=True):
        yield f"frame_{frame:06d}", positions
    for number, action in enumerate(tracked.actions):
        yield f"action_{number:02d}_before", action.positions_before_final_alignment
        yield f"action_{number:02d}_after", action.positions_after_final_alignment


def export_pictures(
    tracked: TrackedTrajectory,
    recording: Recording,
    out: Path,
    kind: PictureFormat,
    *,
    rows: int = 6,
) -> Path:
    """Write a trajectory drawn over its recording, and return the path with its suffix."""
    out = _with_suffix(out, _SUFFIXES[kind])
    overlay = Overlay(tracked, recording, config=OverlayConfig())
    if kind == "sheet":
        return write_contact_sheet(overlay, out, rows=rows)
    write_overlay_video(overlay, out)
    return out
