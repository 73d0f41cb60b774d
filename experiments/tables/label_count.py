"""How many tracked trajectories fine-tuning needs: 5, 10, 20 and 45 of each garment.

The paper learns from 45. Labels are those of our default, weighted by their quality; fewer are the
first of more. Beyond the split's own trajectories more are filmed, as the benchmark's are.

    python experiments label_count --bench OUT --weights TOWEL TSHIRT --workers 2
"""

import sys
from collections.abc import Sequence

import _path  # noqa: F401
from shared.bench_measures import Row
from shared.learning_experiment import LearningSetup, run_learning
from shared.learning_labels import tracked_labels
from shared.learning_runs import Reconstructor


def plan(setup: LearningSetup) -> list[Row]:
    """The network before, and after so many trajectories."""
    rows = []
    for kind, start in setup.weights.items():
        held_out = setup.held_out(kind)
        rows += setup.rows("label_count", Reconstructor("trajectories=0", start), held_out)
        default = setup.tracking.variant("default", "default")
        for count in setup.counts:
            tasks = setup.tracked(setup.more(kind, count), default)
            labels = [tracked_labels(task, weighted=True) for task in tasks]
            weights = setup.tuner.tuned(start, labels)
            how = Reconstructor(f"trajectories={count}", weights)
            rows += setup.rows("label_count", how, held_out)
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_learning("label_count", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
