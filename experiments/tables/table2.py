"""Table 2: the network before and after fine-tuning on pseudo-labels of different trackers.

Claims judged: fine-tuning lowers Chamfer PC by 46 % and Chamfer Mesh by 45 % (paper, 3.0 to 1.6
and 2.2 to 1.2), and the true vertex error by 25 %; labels of our tracker are worth nearly as much
as the truth; the gain is not merely more training, which the control on as much of the old cloth
would show too. Chamfer hardly sees wrong correspondences: the error up to symmetry is what counts.

    python experiments table2 --bench OUT --weights TOWEL TSHIRT --old STATES STATES
"""

import sys
from collections.abc import Sequence

import _path  # noqa: F401
from shared.bench_measures import Row
from shared.learning_experiment import LearningSetup, run_learning
from shared.learning_labels import old_labels, tracked_labels, true_labels
from shared.learning_runs import Reconstructor

from clothtrack.errors import InvalidConfigError
from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording

BEFORE = "before"
CONTROL = "control: old cloth"
TRACKED = {
    "labels: open loop": ("open_loop", False),
    "labels: the paper's mode": ("paper", False),
    "labels: default": ("default", False),
    "labels: default, weighted": ("default", True),
}
TRUTH = "labels: the truth"


def plan(setup: LearningSetup) -> list[Row]:
    """Every kind of label, on the same held-out trajectories."""
    rows = []
    for kind, start in setup.weights.items():
        held_out = setup.held_out(kind)
        networks = {BEFORE: start}
        for name, labels in label_sets(setup, kind).items():
            networks[name] = setup.tuner.tuned(start, labels)
        for name, weights in networks.items():
            rows += setup.rows("table2", Reconstructor(name, weights), held_out)
        if CONTROL not in networks and not setup.only:
            rows.append(
                {
                    "experiment": "table2",
                    "variant": CONTROL,
                    "recording": f"any {kind}",
                    "kind": kind,
                    "split": "",
                    "error": f"no states of a {kind} are given with --old",
                }
            )
    return rows


def label_sets(setup: LearningSetup, kind: str) -> dict[str, list[LabelledRecording]]:
    """What is learned from, by name: the same frames of the same trajectories, but for the control.

    Trajectories that a mode cannot track are missing in that mode's labels.

    Raises:
        InvalidConfigError: `only` names labels that there are not.
    """
    names = (*TRACKED, TRUTH, CONTROL)
    if unknown := [name for name in setup.only if name not in names]:
        raise InvalidConfigError(f"--only {unknown[0]!r}: choose from {', '.join(names)}")
    wanted = setup.only or names
    training = setup.training(kind)
    modes = {"default", *(mode for name, (mode, _) in TRACKED.items() if name in wanted)}
    runs = {
        mode: setup.tracked(training, setup.tracking.variant(mode, mode)) for mode in sorted(modes)
    }
    sets = {
        name: [tracked_labels(task, weighted=weighted) for task in runs[mode]]
        for name, (mode, weighted) in TRACKED.items()
        if name in wanted
    }
    if TRUTH in wanted:
        sets[TRUTH] = [true_labels(task) for task in runs["default"]]
    states = setup.old_states(kind)
    if states is not None and CONTROL in wanted:
        like = [tracked_labels(task) for task in runs["default"]]
        sets[CONTROL] = old_labels(states, like)
    return sets


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_learning("table2", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
