"""The closed loop: observe, reconstruct, plan and act until the cloth is flat.

All decisions use only the robot's pictures. A simulated robot's true coverage is recorded for the
score but never used for a decision.
"""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from clothtrack.errors import InvalidConfigError, InvalidRecordingError, InvalidResultError
from clothtrack.files.progress import Progress
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, garment
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.action_space import PickPlace, SeenCloth
from clothtrack.planning.episode_store import EpisodeStore, write_step
from clothtrack.planning.flatten_config import FlattenConfig, episode_identity, weights_used
from clothtrack.planning.perception import Estimate, Perception
from clothtrack.planning.planner import Decision, Hypothesis, Planner, PlannerConfig
from clothtrack.planning.planning_dynamics import PlanningDynamics
from clothtrack.planning.robots.robot import Execution, PickPlaceRobot
from clothtrack.planning.seen import seen_area, seen_cloth
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import ClothDescription, Recording, Table
from clothtrack.recordings.store import read_recording

logger = logging.getLogger(__name__)

ENOUGH = 0.95
"""An episode ends when the cloth covers this share of the flat garment's area."""

_OF_EPISODES = 0xEF15
"""Seed component that separates this module's random draws from others with the same seed."""


Propose = Callable[[SeenCloth, PlannerConfig, np.random.Generator], Sequence[PickPlace]]
"""A policy without a mesh: returns actions for the visible cloth, the best first."""


@runtime_checkable
class Checkpoint(Protocol):
    """Storage of state outside the episode's own files, such as a simulated world."""

    def save(self, step: int) -> None:
        """Save the world after a step."""
        ...

    def restore(self, step: int) -> None:
        """Restore the world to its state after a step."""
        ...


Watch = Callable[[EpisodeStore, Decision | None], None]
"""Callback after every step with the episode and the next decision, if there is one."""


@dataclass(frozen=True, eq=False)
class EpisodeScene:
    """Constants of an episode.

    Attributes:
        flat_area_m2: area that the flat garment covers [m^2]; None: taken from the estimates.
    """

    cloth: ClothDescription
    table: Table
    flat_area_m2: float | None = None


def flat_area(cloth: ClothDescription) -> float | None:
    """Return the area of the flat garment [m^2]; None if its kind or size is unknown."""
    if cloth.kind not in DEFAULT_SIZES_M or cloth.size_m is None:
        return None
    mesh = garment(cloth.kind, vertex_count=300, size_m=cloth.size_m)
    return projected_area(mesh.vertices, mesh.faces)


class Flattening:
    """One episode with one robot."""

    def __init__(
        self,
        robot: PickPlaceRobot,
        scene: EpisodeScene,
        config: FlattenConfig,
        *,
        perception: Perception | None,
        dynamics: PlanningDynamics | None = None,
        propose: Propose | None = None,
        seed: int = 0,
        score: Callable[[], float] | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        """Assemble the episode.

        Args:
            score: true coverage [m^2] of a simulated robot; recorded and never used.
        """
        is_planned = config.policy == "planned"
        if is_planned and (perception is None or dynamics is None):
            raise InvalidConfigError("policy is planned; it needs a perception and dynamics")
        if not is_planned and propose is None:
            raise InvalidConfigError(
                f"policy is {config.policy}; hand in what it proposes (clothtrack_lab.flattening)"
            )
        self._robot, self._scene, self._config = robot, scene, config
        self._perception = perception if is_planned else None
        self._planner = (
            Planner(dynamics, config.planner) if is_planned and dynamics is not None else None
        )
        self._propose = propose
        self._seed, self._score, self._checkpoint = seed, score, checkpoint
        self._progress: Progress | None = None

    def run(
        self, folder: Path, *, watch: Watch | None = None, progress: Progress | None = None
    ) -> EpisodeStore:
        """Run the episode, or resume it where it stopped; leave a finished one unchanged."""
        # The truth is an upper bound that no camera can reach, so it is labeled a control.
        name = "none" if self._perception is None else self._config.perception.name
        label = {"perception": name, "control": name == "truth"}
        cloth = self._scene.cloth
        store = EpisodeStore(
            folder,
            {**episode_identity(self._config), "seed": self._seed, "label": label,
             "cloth": {"kind": cloth.kind, "size_m": cloth.size_m}},
            weights=weights_used(self._config),
        )  # fmt: skip
        if store.finished:
            return store
        self._progress = progress
        done = len(store.steps) - 1
        if done >= 0:
            store.clear_after(done)
            if self._checkpoint is not None:
                self._checkpoint.restore(done)
            estimate = store.estimate(done)
            shown = read_recording(store.recording_path(done))
        else:
            store.clear_after(-1)
            shown, estimate = self._first_look(store)
        while not store.finished:
            shown, estimate = self._advance(store, shown, estimate, watch)
        return store

    def _tell(self, actions: int, phase: str) -> None:
        """Report how many actions are done, and the phase of the next one."""
        if self._progress is None:
            return
        most, phases = self._config.actions, ("look", "plan", "act")
        planned = f" among {self._config.planner.candidates} candidates" if phase == "plan" else ""
        self._progress(
            f"action {min(actions + 1, most)}/{most} at most: {phase}{planned}",
            len(phases) * actions + phases.index(phase),
            len(phases) * most + 1,
        )

    def _first_look(self, store: EpisodeStore) -> tuple[Recording, Estimate | None]:
        """Observe the cloth before any action."""
        self._tell(0, "look")
        self._robot.home()
        recording = write_step(
            store.recording_path(0), [self._robot.observe()], cloth=self._scene.cloth,
            table=self._scene.table,
        )  # fmt: skip
        return recording, self._finish_step(store, recording, {"step": 0, "action": None})

    def _advance(
        self, store: EpisodeStore, shown: Recording, estimate: Estimate | None, watch: Watch | None
    ) -> tuple[Recording, Estimate | None]:
        """Decide, act and observe, or end the episode."""
        number = len(store.steps) - 1
        row = store.steps[number]
        decision = None
        status = self._ended(store, row)
        if not status:
            self._tell(number, "plan")
            decision = self._decide(shown, estimate, number)
            status = "" if decision.action is not None else "no action is within reach"
        if status:
            store.document["status"] = status
            store.write()
        if watch is not None:
            watch(store, decision)
        if status or decision is None or decision.action is None:
            return shown, estimate
        self._tell(number, "act")
        execution = self._robot.execute(decision.action)
        if not execution.error:
            # After a fault the arm must not move until a person has looked.
            self._robot.home()
        frames = [*execution.film, self._robot.observe()]
        recording = write_step(
            store.recording_path(number + 1), frames, cloth=self._scene.cloth,
            table=self._scene.table, execution=execution,
        )  # fmt: skip
        self._tell(number + 1, "look")
        row = _step_row(number + 1, decision, decision.action, execution)
        return recording, self._finish_step(store, recording, row)

    def _decide(self, shown: Recording, estimate: Estimate | None, number: int) -> Decision:
        """Return the decision, with the best action that the robot can carry out."""
        rng = np.random.default_rng([_OF_EPISODES, self._seed, number, 0])
        seen = seen_cloth(shown, observe(shown, shown.frames[-1]))
        if self._planner is None:
            assert self._propose is not None  # __init__ refuses neither
            proposed = self._propose(seen, self._config.planner, rng)
            return Decision(self._reachable(proposed), 0.0)
        if estimate is None:
            raise InvalidResultError(
                f"{shown.folder}: what was believed of it is missing; remove the episode"
            )
        belief = Hypothesis(
            estimate.flat, estimate.positions, self._scene.cloth.kind, estimate.opposite
        )
        decision = self._planner.decide(belief, seen, rng)
        action = self._reachable(decision.candidates)
        if action is None or action is decision.action:
            return replace(decision, action=action)
        gain = decision.gains_m2[[one is action for one in decision.candidates].index(True)]
        return replace(decision, action=action, gain_m2=float(gain))

    def _reachable(self, actions: Sequence[PickPlace]) -> PickPlace | None:
        """Return the first of the actions that the robot does not refuse."""
        for action in actions:
            reachability = self._robot.check(action)
            if reachability.reachable:
                return action
            logger.info("an action is not reachable: %s", reachability.reason)
        return None

    def _finish_step(
        self, store: EpisodeStore, shown: Recording, row: dict[str, Any]
    ) -> Estimate | None:
        """Perceive and measure the cloth, and write the finished step."""
        clock, cpu = time.perf_counter(), time.process_time()
        estimate = None if self._perception is None else self._perception.perceive(shown)
        row["perception_s"] = time.perf_counter() - clock
        row["perception_cpu_s"] = time.process_time() - cpu
        row["sources"] = [] if estimate is None else [estimate.source]
        row["expected_error_m"] = None if estimate is None else estimate.expected_error_m
        flat = self._scene.flat_area_m2
        if flat is None and estimate is not None:
            flat = projected_area(estimate.flat.vertices, estimate.flat.faces)
        row["seen_m2"] = seen_area(shown, shown.frames[-1])
        row["flat_m2"] = flat
        row["true_m2"] = None if self._score is None else self._score()
        if estimate is not None:
            store.add_estimate(row["step"], estimate)
        if self._checkpoint is not None:
            self._checkpoint.save(row["step"])
        store.steps.append(row)
        store.write()
        return estimate

    def _ended(self, store: EpisodeStore, row: dict[str, Any]) -> str:
        """Return why the episode is over; empty if it is not."""
        flat = row["flat_m2"]
        if flat is not None and row["seen_m2"] >= ENOUGH * flat:
            return "flat"
        if row.get("error"):
            return f"the robot stopped: {row['error']}"
        if len(store.steps) - 1 >= self._config.actions:
            return "all actions are used up"
        return ""


def _step_row(
    number: int, decision: Decision, action: PickPlace, execution: Execution
) -> dict[str, Any]:
    return {
        "step": number,
        "action": action.as_dict(),
        "gain_m2": decision.gain_m2,
        "candidates": len(decision.candidates),
        "decision_s": decision.seconds,
        "decision_cpu_s": decision.cpu_s,
        "grasped": execution.grasped,
        "error": execution.error,
    }


def improvement(steps: Sequence[dict[str, Any]], key: str = "true_m2") -> list[float]:
    """Return the normalized improvement per step: (c - c0) / (c_flat - c0) (Sec. IV-B.2)."""
    first = steps[0]
    flat, start = first["flat_m2"], first[key]
    if flat is None or start is None:
        raise InvalidRecordingError(
            f"{key} or the flat area is not known; give the garment's size, or use seen_m2"
        )
    return [float((row[key] - start) / max(flat - start, 1e-12)) for row in steps]
