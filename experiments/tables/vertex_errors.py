"""Test whether the spread of the candidates shows which vertices of a label are wrong.

    clothtrack simulate OUT --benchmark dev
    clothtrack track OUT/recordings/*_dev_* --output TRACKED
    python experiments vertex_errors TRACKED/*.zarr --truth OUT/truth

For every label: correlation of the candidates' spread with the true error over its vertices, and
the true error, in parts of the label's mean, of the fifth of the vertices with the largest spread,
of the fifth with the smallest, and of the hidden ones. Then how far an expected error is off that
deals so much of the label's mean out by the spread. With `--recordings`, last: the share of the
vertices whose error is within what is said of each (`Label.vertex_bounds_m`), and the factor that
would have held 90 % of them.

    python experiments vertex_errors --hanging DATA/hanging-cloth-rgbd --out OUT

tracks the real hanging cloth without its color, and holds the slide of its print at the last frame
against the same intervals: no mark was seen by the tracker.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Bool, Float
from real import hanging_cloth
from scipy.spatial import cKDTree
from scipy.stats import spearmanr
from shared.figures import say

from clothtrack import load, track
from clothtrack.errors import ClothTrackError
from clothtrack.evaluation.label_quality import INTERVAL_FACTOR
from clothtrack.evaluation.truth import Truth, material_map, material_points
from clothtrack.geometry.devices import quiet_warp
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

HELD = 0.9
"""Share of the vertices that an interval is to hold."""

SHARES = (0.0, 0.2, 0.4, 0.6, 0.7, 0.8, 1.0)


@dataclass(frozen=True, eq=False)
class Label:
    """One label with what is known of its vertices.

    Attributes:
        spread_m: how far apart the candidates end [m].
        error_m: distance from the truth [m].
    """

    name: str
    spread_m: Float[np.ndarray, " vertices"]
    error_m: Float[np.ndarray, " vertices"]
    hidden: Bool[np.ndarray, " vertices"]

    @property
    def share(self) -> Float[np.ndarray, " vertices"]:
        """The errors in parts of their mean."""
        return self.error_m / self.error_m.mean()

    def row(self) -> list[float]:
        """Return error in mm, both correlations, and the three parts of the cloth."""
        spread, share = self.spread_m, self.share
        most, least = spread >= np.quantile(spread, 0.8), spread <= np.quantile(spread, 0.2)
        return [
            1e3 * float(self.error_m.mean()),
            float(np.corrcoef(spread, share)[0, 1]),
            float(spearmanr(spread, share)[0]),
            float(share[most].mean()),
            float(share[least].mean()),
            float(share[self.hidden].mean()) if self.hidden.any() else np.nan,
        ]

    def off_by(self, dealt: float) -> float:
        """Return the mean absolute error of the expectation, in parts of the label's mean error."""
        expected = 1.0 - dealt + dealt * self.spread_m / self.spread_m.mean()
        return float(np.abs(self.share - expected).mean())


def labels(path: Path, truths: Path) -> list[Label]:
    """Return the labels of a trajectory whose candidates were tracked."""
    tracked = TrackedTrajectory.load(path)
    truth = Truth.load(truths / f"{tracked.name}.npz")
    canonical = np.asarray(tracked.mesh.canonical, np.float64)
    where = material_map(truth.canonical, truth.faces, canonical)
    found = []
    for number, action in enumerate(tracked.actions):
        right = material_points(truth.at(action.last_frame), truth.faces, where)
        step = int(np.flatnonzero(tracked.frames == action.last_frame)[0])
        error = np.linalg.norm(action.positions_after_final_alignment - right, axis=1)
        if len(action.calibration.spread_m):
            spread, hidden = action.calibration.spread_m, ~tracked.visible[step]
            found.append(Label(f"{tracked.name} {number + 1}", spread, error, hidden))
    return found


def coverage(paths: Sequence[Path], recordings: Path, truths: Path) -> str:
    """Say how many vertices lie within their interval, all and by what cameras see of them."""
    times, hidden, by_label = [], [], []
    for path in paths:
        run = load(path, recordings / path.stem)
        truth = Truth.load(truths / f"{run.name}.npz")
        where = material_map(truth.canonical, truth.faces, np.asarray(run.mesh.canonical))
        for label in run.labels:
            right = material_points(truth.at(label.frame), truth.faces, where)
            error = np.linalg.norm(label.positions - right, axis=1)
            times.append(error / label.vertex_errors_m)
            by_label.append(float((error <= label.vertex_bounds_m).mean()))
            hidden.append(~run.visible[int(np.flatnonzero(run.frames == label.frame)[0])])
    every, unseen = np.concatenate(times), np.concatenate(hidden)
    within = every <= INTERVAL_FACTOR
    return (
        f"{len(times)} labels, {len(every)} vertices: {100 * within.mean():.1f} % within "
        f"{INTERVAL_FACTOR:g} times the expected error\n({100 * within[~unseen].mean():.1f} % of "
        f"the visible, {100 * within[unseen].mean():.1f} % of the hidden; of single labels "
        f"{100 * min(by_label):.0f} to {100 * max(by_label):.0f} %);\n"
        f"{np.quantile(every, HELD):.2f} times would have held {100 * HELD:.0f} %"
    )


def withheld_marks(folder: Path, out: Path) -> str:
    """Say how many patches of the hanging cloth's print slid by less than what is said of them."""
    recording = out / hanging_cloth.NAME
    if not recording.exists():
        hanging_cloth.convert(folder, recording)
    run = track(recording, settings=("color=false",))
    (label,) = run.labels
    last = np.array([label.frame])
    drift = hanging_cloth.score(
        label.positions[None], run.mesh.faces, folder,
        material=np.asarray(run.mesh.canonical)[:, :2], frames=last,
    ).drift[label.frame]  # fmt: skip
    flat = np.asarray(run.mesh.canonical, np.float64)[:, :2]
    nearest = cKDTree(flat - flat.min(axis=0)).query(drift.center_m)[1]
    found = drift.correlation > drift.matched_above
    slide_m, expected_m = drift.slide_m[found], label.vertex_errors_m[nearest[found]]
    times = slide_m / expected_m
    return (
        f"hanging cloth, marks withheld: {int(found.sum())} of {len(found)} patches of the print "
        f"found, mean slide {1e3 * slide_m.mean():.1f} mm, expected "
        f"{1e3 * expected_m.mean():.1f};\n{100 * (times <= INTERVAL_FACTOR).mean():.1f} % within "
        f"{INTERVAL_FACTOR:g} times the expected error; {np.quantile(times, HELD):.2f} times would "
        f"have held {100 * HELD:.0f} %"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tracked", type=Path, nargs="*", help="NAME.zarr, tracked by the default")
    parser.add_argument("--recordings", type=Path, help="folder of the recordings")
    parser.add_argument("--truth", type=Path, help="folder of NAME.npz")
    parser.add_argument("--hanging", type=Path, help="the set hanging-cloth-rgbd")
    parser.add_argument("--out", type=Path, help="folder of its recording")
    options = parser.parse_args(arguments)
    quiet_warp()
    if options.hanging is not None:
        if options.out is None:
            parser.error("--hanging needs --out FOLDER")
        say(withheld_marks(options.hanging, options.out) + "\n")
        return 0
    if not options.tracked or options.truth is None:
        parser.error("give NAME.zarr and --truth, or --hanging")
    try:
        found = [one for path in options.tracked for one in labels(path, options.truth)]
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    if not found:
        sys.stderr.write("no label has a spread: track with the default mode, which searches\n")
        return 1
    say("| label | error mm | correlation | rank | widest fifth | narrowest fifth | hidden |\n")
    say("|---|---:|---:|---:|---:|---:|---:|\n")
    rows = np.array([one.row() for one in found])
    names = [*(one.name for one in found), f"mean of {len(found)}"]
    for name, row in zip(names, [*rows, np.nanmean(rows, axis=0)], strict=True):
        say(f"| {name} | {row[0]:.1f} | " + " | ".join(f"{each:.2f}" for each in row[1:]) + " |\n")
    say("\n| dealt out by the spread | off by, of the label's mean error |\n|---:|---:|\n")
    for dealt in SHARES:
        off = np.mean([one.off_by(dealt) for one in found])
        say(f"| {dealt:.1f} | {off:.3f} |\n")
    if options.recordings is not None:
        say("\n" + coverage(options.tracked, options.recordings, options.truth) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
