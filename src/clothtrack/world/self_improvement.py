"""Getting better by doing: flatten, track what was done, label it, fine-tune, flatten again.

    OUT/round_0/flattening/    episodes with the weights at hand, as `clothtrack flatten` does
    OUT/round_0/hindsight/     what was made of the episodes backwards, their flattest cloth first:
        recordings/            they themselves
        tracked/               tracked from the network's own first mesh
        labels/                pseudo-labels
    OUT/round_0/tuned/         the network fine-tuned on all labels so far; the next round's
    OUT/improvement.json       the curve
    OUT/asked.json             what all of it depends on

No truth is learned from: the score of a round is taken down and decides nothing.
"""

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_quality import judge_labels
from clothtrack.files.atomic_write import content_hash, write_file
from clothtrack.files.bounds import Checked, Natural
from clothtrack.files.progress import Progress
from clothtrack.files.run_manifest import begin_run
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of, episode_identity
from clothtrack.planning.flattening import improvement
from clothtrack.reconstruction.data.state_store import LIST_FILE
from clothtrack.recordings.reversal import reversed_recording
from clothtrack.recordings.store import read_recording
from clothtrack.simulation.garments import GarmentKind
from clothtrack.tracking.artefacts import load_tracked
from clothtrack.tracking.pipeline import RunConfig, counted_settings, track_recordings
from clothtrack.world.simulated_episodes import (
    SimulatedEpisode,
    flatten_simulated,
    shared_parts,
)
from clothtrack.world.simulated_robot import SimulatedRobotConfig

if TYPE_CHECKING:
    from clothtrack.reconstruction.learning_config import LearningConfig

logger = logging.getLogger(__name__)

CURVE = "improvement.json"
ASKED = "asked.json"


def _finetune() -> "LearningConfig":
    from clothtrack.reconstruction.learning_config import LearningConfig

    return LearningConfig.preset("finetune_short")


@dataclass(frozen=True)
class ImprovementConfig(Checked):
    """How a network gets better by flattening.

    Attributes:
        rounds: of fine-tuning; one more flattening follows, to see what the last was worth.
        episodes: per round, of the same starts in every round.
        old_share: how often an example is one of the old states, where there are some.
        hindsight: track each episode from its end to its beginning. At its end the cloth is
            flattest, and the network knows it best.
        flatten: how episodes are done.
        robot: of the stand-in world.
        track: how their recordings are tracked.
        finetune: how the network is trained on the labels.
    """

    rounds: Natural = 1
    episodes: int = 5
    old_share: float = 0.25
    hindsight: bool = True
    flatten: FlattenConfig = field(default_factory=FlattenConfig)
    robot: SimulatedRobotConfig = field(default_factory=SimulatedRobotConfig)
    track: RunConfig = field(default_factory=RunConfig)
    finetune: "LearningConfig" = field(default_factory=_finetune)

    def __post_init__(self) -> None:
        """Refuse rounds that cannot end well before the first is begun.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        fewest = 2 if self.rounds else 1
        if self.episodes < fewest:
            raise InvalidConfigError(
                f"episodes is {self.episodes}; give at least {fewest}: fine-tuning needs two "
                "labelled episodes, one of them to select by"
            )


def improve_rounds(
    weights: Path,
    out: Path,
    kind: GarmentKind,
    config: ImprovementConfig,
    *,
    old: Path | None = None,
    device: str = "cpu",
    seed: int = 0,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Flatten and learn in turns; what is finished is kept, so that a broken run goes on.

    A folder goes on with the settings that it was begun with; more rounds can be asked for.

    Args:
        weights: of the network to begin with.
        out: folder of the rounds.
        kind: the garment.
        config: how.
        old: simulated states to mix in, against forgetting.
        device: where to compute.
        seed: of the first episode.
        progress: called while it is tracked and trained.

    Returns:
        Per round: mean and deviation of the normalised improvement, and the weights' digest.

    Raises:
        InvalidResultError: the weights or the old states cannot be read; nothing is written.
        InvalidConfigError: the folder was begun with other settings; nothing is written.
        ClothTrackError: a stage fails.
    """
    _require_inputs(weights, kind, config, old=old, device=device)
    _take_up(out / ASKED, weights, kind, config, old=old, seed=seed)
    curve: list[dict[str, Any]] = []
    labels: list[Path] = []
    for number in range(config.rounds + 1):
        folder = out / f"round_{number}"
        gained = _flattened(
            folder / "flattening", out / "starts", weights, kind, config, device=device, seed=seed
        )
        curve.append(
            {
                "round": number,
                "weights": weights.name,
                "weights_sha256": content_hash(weights),
                "episodes": len(gained),
                "mean": float(np.mean(gained)),
                "deviation": float(np.std(gained, ddof=1)) if len(gained) > 1 else 0.0,
                "improvement": gained,
            }
        )
        _write(out / CURVE, curve)
        if number == config.rounds:
            break
        labels += _labelled(folder, kind, weights, config, device=device, progress=progress)
        if len(labels) < 2:
            raise ClothTrackError(
                f"{folder}: {len(labels)} of {config.episodes} episodes could be labelled; "
                "fine-tuning needs two, one of them to select by: give more --episodes"
            )
        weights = _tuned(
            weights, labels, folder / "tuned", config, old=old, device=device, progress=progress
        )
    return curve


def _require_inputs(
    weights: Path, kind: str, config: ImprovementConfig, *, old: Path | None, device: str
) -> None:
    """Refuse now what a round would trip over hours later."""
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.model_loading import load_model
    from clothtrack.reconstruction.training.processes import require_torch_device

    require_torch_device(device)
    load_model(kind, weights, device=device)
    dynamics_of(config.flatten, device=device)
    if old is not None:
        states = open_states(old)
        if states.kind != kind:
            raise InvalidConfigError(
                f"{old}: its states are of a {states.kind!r}, not of a {kind!r}; name others"
            )


def _take_up(
    path: Path,
    weights: Path,
    kind: str,
    config: ImprovementConfig,
    *,
    old: Path | None,
    seed: int,
) -> None:
    """Note what the rounds depend on, or refuse to mix them with rounds of something else."""
    perceived = replace(config.flatten.perception, weights=str(weights))
    settings = {
        **asdict(config),
        "flatten": episode_identity(replace(config.flatten, perception=perceived), kind),
        "track": counted_settings(config.track),
    }
    # Each round depends on those before it alone.
    del settings["rounds"]
    asked = {
        "garment": kind, "seed": seed, "settings": settings,
        "old": None if old is None else content_hash(old / LIST_FILE),
    }  # fmt: skip
    begin_run(path, asked)


def _flattened(
    folder: Path,
    starts: Path,
    weights: Path,
    kind: GarmentKind,
    config: ImprovementConfig,
    *,
    device: str,
    seed: int,
) -> list[float]:
    """Normalised improvement of each episode with these weights."""
    perceived = replace(config.flatten.perception, weights=str(weights))
    flatten = replace(config.flatten, perception=perceived)
    parts = shared_parts(kind, flatten, starts=starts, device=device)
    gained = []
    for number in range(config.episodes):
        store = flatten_simulated(
            folder,
            SimulatedEpisode(kind, seed + number),
            flatten,
            robot_config=config.robot,
            parts=parts,
            device=device,
        )
        gained.append(improvement(store.steps)[-1])
    return gained


def _labelled(
    folder: Path,
    kind: str,
    weights: Path,
    config: ImprovementConfig,
    *,
    device: str,
    progress: Progress | None,
) -> list[Path]:
    """Track the episodes of a round and label them; what cannot be tracked has no label."""
    from clothtrack.evaluation.label_selection import pseudo_labels_of
    from clothtrack.reconstruction.data.pseudo_labels import label_recording, write_labels

    recordings = sorted((folder / "flattening" / "recordings").glob("[!.]*"))
    if config.hindsight:
        # Apart from what was tracked forwards: names of recordings, and of frames, are the same.
        folder = folder / "hindsight"
        recordings = [
            reversed_recording(read_recording(one), folder / "recordings" / one.name).folder
            for one in recordings
        ]
    first = replace(config.track.initial_state, source="network", weights=str(weights))
    outcomes = track_recordings(
        recordings, folder / "tracked", replace(config.track, initial_state=first), device=device,
        progress=progress,
    )  # fmt: skip
    written = []
    for outcome in outcomes:
        if outcome.result is None:
            logger.warning("no label: %s", outcome.error)
            continue
        path = folder / "labels" / f"{outcome.recording.name}.labels.npz"
        if outcome.tracked_again or not path.exists():
            tracked = load_tracked(outcome.result)
            recording = read_recording(outcome.recording)
            judged = judge_labels(tracked, recording, device=device)
            try:
                chosen = pseudo_labels_of(tracked, judged, (), weighted=True, flat_weight=0.0)
            except InvalidResultError as error:
                # An episode in which nothing promised a gain has no action, and so no label.
                logger.warning("no label: %s", error)
                continue
            labelled = label_recording(
                recording, tracked.mesh, chosen, kind=kind,
                provenance={"tracked": dict(tracked.provenance), "weighted": True},
            )  # fmt: skip
            write_labels(labelled, path)
        written.append(path)
    return written


def _tuned(
    weights: Path,
    labels: Sequence[Path],
    folder: Path,
    config: ImprovementConfig,
    *,
    old: Path | None,
    device: str,
    progress: Progress | None,
) -> Path:
    """The network fine-tuned on all labels so far.

    Raises:
        ClothTrackError: it was interrupted.
    """
    from clothtrack.reconstruction.data.pseudo_labels import read_labels
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.fine_tuning import finetune
    from clothtrack.reconstruction.training.processes import Processes

    tuned = folder / "model.safetensors"
    if tuned.exists():
        return tuned
    share = config.old_share if old is not None else 0.0
    learning = config.finetune.mixing(share)
    outcome = finetune(
        weights,
        [read_labels(path) for path in labels],
        learning,
        folder,
        old=[] if old is None else [open_states(old)],
        processes=Processes(device=device),
        progress=progress,
    )
    if outcome.model is None:
        raise ClothTrackError("fine-tuning was interrupted; the same command goes on from there")
    return outcome.model


def _write(path: Path, curve: list[dict[str, Any]]) -> None:
    write_file(path, json.dumps(curve, indent=1).encode())
