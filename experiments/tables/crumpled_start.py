"""Compare tracking from a crumpled first frame with a start from the flat cloth.

Each recording is tracked twice. From flat, it is tracked unchanged from its template. From
crumpled, it is tracked from the frame before its second action on, without a template; the first
mesh is the network's, from that one picture and the garment's size. Both are compared with the
truth after the same actions, under the best-fitting symmetry.

    clothtrack simulate OUT --garment towel --trajectories 10 --seed 700
    clothtrack simulate OUT --garment tshirt --trajectories 10 --seed 700
    python experiments crumpled_start --bench OUT --weights FILE

Runs are stored next to the recordings, and a second call resumes.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.bench_measures import Row
from shared.bench_runs import (
    Task,
    Trajectory,
    Variant,
    kept_labels,
    run_all,
    track,
    trajectories,
    write_meshes,
)
from shared.figures import say, write_json
from shared.table_column import paired, table

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation.truth import Truth, material_map, material_points
from clothtrack.files.atomic_write import content_hash
from clothtrack.files.provenance import commit
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.availability import shipped_weights
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.configuration import InitialStateConfig, RunConfig
from tables.network_on_states import look_alikes

FLAT = Variant("from flat")


def crumpled(recording: Recording) -> Recording:
    """Return the recording from the frame before its second action on, without its template."""
    if len(recording.actions) < 2:
        raise InvalidConfigError(
            f"{recording.folder}: has {len(recording.actions)} actions; a crumpled start needs 2"
        )
    start = recording.actions[1].first_frame
    frames = [replace(one, index=one.index - start) for one in recording.frames[start:]]
    actions = [
        replace(one, first_frame=one.first_frame - start, last_frame=one.last_frame - start)
        for one in recording.actions[1:]
    ]
    cloth = replace(recording.cloth, template=None, held_vertices={})
    return replace(recording, frames=tuple(frames), actions=tuple(actions), cloth=cloth)


def errors_mm(
    mesh: ClothMesh, ends: Sequence[tuple[int, Float[np.ndarray, "vertices 3"]]], truth: Truth
) -> list[float]:
    """Return the mean vertex error [mm] at frames, under the symmetry with the least mean.

    Args:
        ends: frames of the truth, with the vertices [m] at each.
    """
    canonical = np.asarray(mesh.canonical, np.float64)
    found = []
    for turn in look_alikes(mesh):
        where = material_map(truth.canonical, truth.faces, canonical @ turn.T)
        found.append([
            1e3 * np.linalg.norm(
                positions - material_points(truth.at(frame), truth.faces, where), axis=1
            ).mean()
            for frame, positions in ends
        ])  # fmt: skip
    return min(found, key=np.mean)


def run(options: argparse.Namespace) -> list[Row]:
    """Return one row per recording."""
    weights = options.weights or shipped_weights()
    if weights is None:
        raise InvalidConfigError("no weights come with clothtrack; name some with --weights")
    found = trajectories(options.bench, options.split, options.limit)
    store, rows = options.bench / "experiments", []
    for number, trajectory in enumerate(found, start=1):
        row: Row = {"recording": trajectory.name, "kind": trajectory.kind}
        try:
            row |= measured(trajectory, weights, store)
        except ClothTrackError as error:
            row["error"] = str(error)
        rows.append(row)
        if options.json is not None:
            stamp = {"commit": commit(), "weights_sha256": content_hash(weights)}
            write_json(options.json, {**stamp, "rows": rows})
        sys.stderr.write(f"{number} of {len(found)}\n")
    return rows


def measured(trajectory: Trajectory, weights: Path, store: Path) -> Row:
    """Return the errors [mm] of both starts of a recording, after the same actions."""
    recording, truth = read_recording(trajectory.recording), Truth.load(trajectory.truth)
    late = crumpled(recording)
    start = recording.actions[1].first_frame
    task = Task(trajectory, FLAT, store / "runs")
    (flat_rows,) = run_all([task])
    if "error" in flat_rows[0]:
        return {"error": flat_rows[0]["error"]}
    mesh, labels = kept_labels(task.file.with_suffix(".npz"))
    row: Row = {
        "flat_mm": errors_mm(mesh, [(one.frame, one.vertices) for one in labels], truth)[1:]
    }
    kept = store / "crumpled" / f"{trajectory.name}-{content_hash(weights)[:12]}.npz"
    if not kept.exists():
        config = RunConfig(initial_state=InitialStateConfig(source="network", weights=str(weights)))
        tracked = track(late, Variant("from crumpled", config), device="cpu")
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_meshes(tracked, kept)
    mesh, labels = kept_labels(kept)
    ends = [(one.frame + start, one.vertices) for one in labels]
    return row | {"crumpled_mm": errors_mm(mesh, ends, truth)}


def markdown(rows: Sequence[Row]) -> str:
    """Return one line per garment and number of actions since the start."""
    lines = []
    good = [row for row in rows if "error" not in row]
    for kind in dict.fromkeys(row["kind"] for row in good):
        own = [row for row in good if row["kind"] == kind]
        for after in range(max(len(row["crumpled_mm"]) for row in own)):
            pairs = np.array([
                (row["crumpled_mm"][after], row["flat_mm"][after])
                for row in own if after < len(row["crumpled_mm"])
            ])  # fmt: skip
            gaps = pairs[:, 0] - pairs[:, 1]
            ours, theirs = pairs.mean(axis=0)
            lines.append([
                kind, str(after + 1), str(len(pairs)), f"{ours:.1f}", f"{theirs:.1f}",
                f"{np.median(pairs[:, 0]):.1f}", *paired(gaps),
            ])  # fmt: skip
    head = ["garment", "actions", "recordings", "from crumpled, mm", "from flat, mm",
            "from crumpled, median", "difference", "crumpled nearer in"]  # fmt: skip
    failed = [f"- {row['recording']}: {row['error']}" for row in rows if "error" in row]
    return "\n".join([table(head, lines), "", *failed])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bench", type=Path, required=True, help="folder of clothtrack simulate")
    parser.add_argument("--split", help="of a benchmark: dev, test or hard")
    parser.add_argument("--limit", type=int, help="so many recordings, garments taking turns")
    parser.add_argument("--weights", type=Path, help="other than those that are shipped")
    parser.add_argument("--json", type=Path, help="file that gets the rows")
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        rows = run(options)
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{__doc__.splitlines()[0]}\n\n{markdown(rows)}\n")
    return 0 if any("error" not in row for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
