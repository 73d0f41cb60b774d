"""From the paper's method to our default, one change after the other; and the default, ablated.

Claim judged: each change earns its place; and the order of the paper's Table 1, which its method
does not show on the benchmark, depends on how the visible vertices are held. The first half starts
at the paper's method and keeps every change it has made; the last one, the slide to the outline,
makes it the default. The second half takes away from the default the parts of the paper's Table 1,
then its own: the alignment of the first mesh, the mean of the candidates, the search among them,
the untangling, the points followed in colour, the cloth's stretch; and lets slow cloth sleep.

    python experiments default_ablations --bench OUT --split test --workers 2
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.experiment import Run, Setup, run_experiment

from clothtrack.tracking import TrackerConfig, mode
from tables.collision import weighted


def plan(setup: Setup) -> list[Run]:
    """The steps, then the ablations of where they end."""
    configs = {**steps(), **ablations()}
    variants = [setup.variant(name, config) for name, config in configs.items()]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def steps() -> dict[str, TrackerConfig]:
    """The paper's method and, one added to the other, what the default does differently."""
    paper, default = mode("full_held_paper"), mode("default")
    soft = replace(paper, attachment_strength=default.attachment_strength)
    observed = replace(
        soft,
        attach_observed_only=default.attach_observed_only,
        attach_crossed=default.attach_crossed,
    )
    losses = weighted(
        observed,
        two_way_weight=default.alignment.two_way_weight,
        length_weight=default.alignment.length_weight,
    )
    unslid = replace(default.final_alignment, slide=False)
    # Everything that is left but the search and the slide: release of velocity, TTO2 rolled out.
    rolled = replace(
        default,
        final_alignment=unslid,
        score_frames=paper.score_frames,
        parameters=paper.parameters,
        calibration=paper.calibration,
    )
    return {
        "paper": paper,
        "+ soft attachments": soft,
        "+ only observed and uncrossed vertices": observed,
        "+ two-way loss and edge lengths": losses,
        "+ TTO2 carried out by the dynamics": rolled,
        "+ parameters and layers searched by tracking": replace(default, final_alignment=unslid),
        "default": default,
    }


def ablations() -> dict[str, TrackerConfig]:
    """The default without one part of the method each."""
    default = mode("default")
    without = {
        "pseudo-action": "use_pseudo_action",
        "dynamics initialisation": "use_dynamics_initialisation",
        "action": "use_action",
        "TTO2": "use_final_alignment",
        "first alignment": "align_first_mesh",
        "mean of candidates": "average_candidates",
    }
    one_pass = replace(default.calibration, method="none")
    tangled = replace(default.final_alignment, untangle=False)
    return {
        **{
            f"default without {part}": replace(default, **{field: False})
            for part, field in without.items()
        },
        "default without search": replace(default, calibration=one_pass),
        "default without untangling": replace(default, final_alignment=tangled),
        "default without colour": weighted(default, marks_weight=0.0),
        "default without stretch": replace(
            default, parameters={**default.parameters, "stretch_compliance": 0.0}
        ),
        "default with sleep": replace(default, solver=mode("full_held_paper").solver),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("default_ablations", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
