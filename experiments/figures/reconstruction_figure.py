"""Ten crumpled states of held-out trajectories, before and after fine-tuning, in one picture.

    python experiments reconstruction_figure --bench OUT --weights BEFORE... --tuned AFTER... \
        --image docs/images/reconstruction.png

One line per state: depth, canonical picture and mesh before, both after, the truth. States are
taken evenly from the held-out trajectories, in the order of their names, and not by how they turned
out: what failed is in it.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.bench_runs import Trajectory
from shared.figures import say, write_png
from shared.learning_experiment import (
    LearningSetup,
    add_options,
    prepared,
    weights_of_garments,
)
from shared.learning_measures import Case, vertex_errors
from shared.learning_runs import Reconstructor, reconstruct_frame
from shared.reconstruction_pictures import (
    HEIGHT,
    WIDTH,
    Picture,
    canonical_picture,
    depth_picture,
    line,
    mesh_picture,
)

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation import Truth
from clothtrack.geometry import ClothMesh, quiet_warp
from clothtrack.reconstruction import NetworkMesh, load_model
from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
from clothtrack.recordings import read_recording
from clothtrack.report.viewpoint import three_quarter_view

STATES = 10


@dataclass(frozen=True)
class State:
    """One state of the picture.

    Attributes:
        trajectory: it is from.
        action: at whose end, from 0.
    """

    trajectory: Trajectory
    action: int


def states(trajectories: Sequence[Trajectory], count: int) -> list[State]:
    """So many ends of actions, evenly from all."""
    every = [
        State(one, number)
        for one in sorted(trajectories, key=lambda each: each.name)
        for number in range(len(read_recording(one.recording).actions))
    ]
    chosen = np.unique(np.linspace(0, len(every) - 1, min(count, len(every))).round().astype(int))
    return [every[index] for index in chosen]


def drawn(state: State, ways: Sequence[Reconstructor]) -> Picture:
    """The line of one state."""
    trajectory = state.trajectory
    recording, truth = read_recording(trajectory.recording), Truth.load(trajectory.truth)
    frame = recording.actions[state.action].last_frame
    case = Case(recording, truth, frame, trajectory.kind)
    surface = ClothMesh(truth.at(frame), truth.faces)
    camera = three_quarter_view(surface.vertices, width=WIDTH, height=HEIGHT)
    depth, mask, _ = cloth_picture(recording, recording.frames[frame])
    pictures, text = [depth_picture(depth, mask)], []
    for how in ways:
        model = load_model(trajectory.kind, how.weights)
        found = reconstruct_frame(model, recording, frame, trajectory.kind, how)
        status = found.reconstruction.status
        pictures += [
            canonical_picture(found.reconstruction, trajectory.kind),
            mesh_picture(found.mesh, camera, recording.table, status),
        ]
        text.append(f"{how.name} {_error(found, case)}")
    pictures.append(mesh_picture(surface, camera, recording.table, ""))
    words = f"{trajectory.name}, action {state.action + 1}: depth; {'; '.join(text)}"
    return line(pictures, (words, "truth"))


def _error(found: NetworkMesh, case: Case) -> str:
    if found.mesh is None:
        return "no mesh"
    _, best = vertex_errors(found.mesh, case)
    return f"{best['all'].mean:.0f} mm"


def networks(
    setup: LearningSetup, tuned: Sequence[Path], kind: str
) -> tuple[Reconstructor, Reconstructor]:
    """Before and after.

    Raises:
        InvalidConfigError: there is no fine-tuned network of the kind.
    """
    after = weights_of_garments(tuned, setup.tracking.bench)
    if setup.tracking.smoke and not after:
        after = setup.weights
    if kind not in after:
        raise InvalidConfigError(f"no fine-tuned weights for a {kind}; name some with --tuned")
    return Reconstructor("before", setup.weights[kind]), Reconstructor("after", after[kind])


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture and say where it is; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_options(parser)
    parser.add_argument("--tuned", type=Path, nargs="+", default=[], help="one per garment")
    parser.add_argument("--image", type=Path, default=Path("docs/images/reconstruction.png"))
    options = parser.parse_args(arguments)
    if not options.smoke and (options.bench is None or not options.weights):
        parser.error("give --bench FOLDER and --weights FILE... (one per garment), or --smoke")
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="reconstruction-figure-") as temporary:
        try:
            setup = prepared(options, Path(temporary))
            lines = []
            for number, kind in enumerate(setup.weights):
                # Half of the states for each of two garments, all of them for one.
                share = (STATES + number) // len(setup.weights)
                ways = networks(setup, options.tuned, kind)
                lines += [drawn(each, ways) for each in states(setup.held_out(kind), share)]
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
        write_png(options.image, np.vstack(lines))
    say(f"{options.image}: {len(lines)} states, {options.image.stat().st_size / 1e3:.0f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
