"""The ablations: named methods in which some functions of Algorithm 1 are replaced.

The paper's four ablate its own method (Table 1). `DEFAULT` removes one part of ours each. `STEPS`
add our changes to the paper's method, one after the other.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import PickAndPlace
from clothtrack.tracking.calibration import OpenLoopCalibration, Uncalibrated
from clothtrack.tracking.configuration import RunConfig, mode
from clothtrack.tracking.ensemble import best_candidate
from clothtrack.tracking.final_alignment import no_final_alignment
from clothtrack.tracking.line_search import PseudoActionSearch
from clothtrack.tracking.methods import METHODS, SOFT, Assembled, Components, default, paper
from clothtrack.tracking.picking import HeldCloth, StillCloth
from clothtrack.tracking.protocols import Correction, Prediction, State
from clothtrack.tracking.rest import never_at_rest
from clothtrack.tracking.search import Axes, Proposal
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.visible_alignment import no_alignment, only_at

Assemble = Callable[[Components], Assembled]


def settings_of(name: str) -> RunConfig:
    """Return the settings of a mode, or of one of the paper's ablations."""
    return mode("paper" if name in PAPER else name)


def changed(assembled: Assembled, **functions: object) -> Assembled:
    """Return the same with some functions of its method replaced."""
    return replace(assembled, method=replace(assembled.method, **functions))


def without_pseudo_action(components: Components, base: Assemble) -> Assembled:
    """Return the dynamics alone inside an action, with TTO2 at its end ("No Pseudo Act")."""
    ends = {action.last_frame for action in components.recording.actions}
    seen = only_at(ends, components.observe, components.recording)
    return changed(base(components), align=no_alignment, observe=seen)


def without_dynamics_initialization(components: Components, base: Assemble) -> Assembled:
    """Return an alignment that starts from the last mesh ("No Dyn Init")."""
    assembled = base(components)
    align = assembled.method.align

    def aligned(predicted: Prediction, observation: Observation) -> Correction | None:
        return align(replace(predicted, positions=predicted.started_at), observation)

    return changed(assembled, align=aligned)


def without_action(components: Components, base: Assemble) -> Assembled:
    """Return dynamics that are not given the pickers' actions ("No Act Cond")."""

    def still(action: PickAndPlace, state: State, theta: Theta) -> HeldCloth:
        held = components.pick(action, state, theta)
        return StillCloth(held.grasps, held.offset)

    return changed(base(components), calibrate=Uncalibrated(still))


def without_final_alignment(components: Components, base: Assemble) -> Assembled:
    """Return the method without TTO2 ("No TTO2")."""
    return changed(base(components), align_last=no_final_alignment)


PAPER: Mapping[str, Assemble] = {
    "no_pseudo_action": partial(without_pseudo_action, base=paper),
    "no_dynamics_initialization": partial(without_dynamics_initialization, base=paper),
    "no_action_conditioning": partial(without_action, base=paper),
    "no_final_alignment": partial(without_final_alignment, base=paper),
}
"""The four ablations of the paper's Table 1."""


def soft(components: Components) -> Assembled:
    """Return the paper's method with vertices that are pulled and not placed."""
    return changed(paper(components), line_search=PseudoActionSearch(SOFT))


def observed(components: Components) -> Assembled:
    """Return the same, attaching only vertices that are observed and not crossed."""
    assembled = soft(components)
    align = replace(assembled.method.align, observed_only=True, uncrossed_only=True)
    return changed(assembled, align=align)


def rolled(components: Components) -> Assembled:
    """Return ours without the slide, with the paper's grasp."""
    return replace(unslid(components), theta=components.config.cloth.theta(held_layers=0))


def unslid(components: Components) -> Assembled:
    """Return ours without the slide to the outline."""
    assembled = default(components)
    return changed(assembled, align_last=replace(assembled.method.align_last, slide=False))


STEPS: Mapping[str, Assemble] = {
    "soft": soft, "observed": observed, "rolled": rolled, "unslid": unslid,
}  # fmt: skip
"""Between the paper's method and ours."""


def unaligned_first(components: Components) -> Assembled:
    """Return ours with the first mesh as it comes."""
    assembled = default(components)
    solver = components.simulator(velocity_kept=0.0).solver
    return replace(assembled, state=solver.save())


def best_only(components: Components) -> Assembled:
    """Return ours, continuing from the best candidate instead of the mean."""
    assembled = default(components)
    return changed(assembled, calibrate=replace(assembled.method.calibrate, combine=best_candidate))


def tangled(components: Components) -> Assembled:
    """Return ours without the untangling."""
    assembled = default(components)
    return changed(assembled, align_last=replace(assembled.method.align_last, untangle=False))


def every_frame(components: Components) -> Assembled:
    """Return ours with every frame tracked, even where the pictures do not change."""
    return changed(default(components), at_rest=never_at_rest)


DEFAULT: Mapping[str, Assemble] = {
    "default_no_pseudo_action": partial(without_pseudo_action, base=default),
    "default_no_dynamics_initialization": partial(without_dynamics_initialization, base=default),
    "default_no_action": partial(without_action, base=default),
    "default_no_final_alignment": partial(without_final_alignment, base=default),
    "default_unaligned_first": unaligned_first,
    "default_best_only": best_only,
    "default_tangled": tangled,
    "default_every_frame": every_frame,
}
"""Ours without one part each."""


def ranked(components: Components, rank: float, *, final: bool) -> Assembled:
    """Return the paper's method with the candidate of the grid that a share `rank` outscores."""
    assembled = paper(components)
    calibrate = assembled.method.calibrate
    assert isinstance(calibrate, OpenLoopCalibration)

    def propose(axes: Axes, start: Theta) -> Proposal:  # noqa: ARG001
        candidates = list(itertools.product(*axes.values()))
        return _of_rank(candidates, rank)

    functions = {} if final else {"align_last": no_final_alignment}
    return changed(assembled, calibrate=replace(calibrate, propose=propose), **functions)


def _of_rank(candidates: list[tuple[float | int, ...]], rank: float) -> Proposal:
    scores = np.array((yield candidates))
    last = max(0, int(np.isfinite(scores).sum()) - 1)
    return candidates[int(np.argsort(scores, kind="stable")[round(rank * last)])]


RANKS = {"best": 0.0, "50 %": 0.5, "90 %": 0.9}
"""Share of the grid's candidates that score better than the one that is taken."""

RANKED: Mapping[str, Assemble] = {
    f"ranked_{label}_{'with' if final else 'without'}_TTO2": partial(ranked, rank=rank, final=final)
    for final in (True, False)
    for label, rank in RANKS.items()
}
"""How much TTO2 makes up for a bad calibration."""


def exploding_at(components: Components, speed: float) -> Assembled:
    """Return ours with one threshold of the line search [m/s], whatever the picker does."""
    search = PseudoActionSearch(SOFT, lambda *_: speed)
    return changed(default(components), line_search=search)


EXPLOSION_M_S = (0.3, 1.0, 3.0, 10.0)

EXPLODING: Mapping[str, Assemble] = {
    f"exploding_at_{speed:g}": partial(exploding_at, speed=speed) for speed in EXPLOSION_M_S
}
"""Sensitivity to what counts as an explosion."""

ALL: Mapping[str, Assemble] = {**METHODS, **PAPER, **STEPS, **DEFAULT, **RANKED, **EXPLODING}
"""Every method of the experiments, by name."""
