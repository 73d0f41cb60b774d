"""Getting better by doing: flatten, track what was done, label it, fine-tune, flatten again.

    OUT/round_0/flattening/    episodes with the weights at hand, as `clothtrack flatten` does
    OUT/round_0/hindsight/     what was made of the episodes backwards, their flattest cloth first:
        recordings/            they themselves
        tracked/               tracked from the network's own first mesh
        labels/                pseudo-labels
    OUT/round_0/worth.json     every label so far: its expected error and that of the network's own
                               mesh of the same picture; where the network's is smaller it is not
                               learned from
    OUT/round_0/tuned/         the network fine-tuned on all others; the next round's
    OUT/improvement.json       the curve
    OUT/asked.json             what all of it depends on
    OUT/garments/              the template of the one garment, where there is one

No truth is learned from: the score of a round is taken down and decides nothing.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation.label_worth import LabelWorth, Teaches, better_than_network
from clothtrack.files.atomic_write import content_hash, write_file
from clothtrack.files.bounds import Checked, Natural
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.files.run_manifest import begin_run
from clothtrack.garments.garment_meshes import GarmentKind
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of, episode_identity
from clothtrack.planning.flattening import improvement
from clothtrack.reconstruction.data.state_store import LIST_FILE
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.pipeline import counted_settings
from clothtrack_lab.world.one_garment import OneGarment
from clothtrack_lab.world.simulated_episodes import (
    SimulatedEpisode,
    flatten_simulated,
    knowing_the_garment,
    require_one_garment,
    shared_parts,
)
from clothtrack_lab.world.simulated_robot import SimulatedRobotConfig
from shared.round_labels import (
    EpisodeLabels,
    label_episodes,
    read_worth,
    taught,
    worth_of,
    write_worth,
)

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording

CURVE = "improvement.json"
ASKED = "asked.json"
MODEL = "model.safetensors"
WORTH = "worth.json"
STOPPED = "fewer than two recordings have a label that is expected to be better than the network"


def _finetune() -> Any:
    from clothtrack.reconstruction.tokens.learning_config import LearningConfig

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
        robot: of the simulated world.
        track: how their recordings are tracked.
        finetune: how the network is trained on the labels: the configuration of its design
            (`reconstruction.design.Design.configuration`); the token network's by default.
    """

    rounds: Natural = 1
    episodes: int = 5
    old_share: float = 0.25
    hindsight: bool = True
    flatten: FlattenConfig = field(default_factory=FlattenConfig)
    robot: SimulatedRobotConfig = field(default_factory=SimulatedRobotConfig)
    track: RunConfig = field(default_factory=RunConfig)
    finetune: Any = field(default_factory=_finetune)

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
    weights: Path | str,
    out: Path | str,
    kind: GarmentKind,
    config: ImprovementConfig,
    *,
    garment_seed: int | None = None,
    teaches: Teaches = better_than_network,
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
        garment_seed: of one garment for all episodes (`OneGarment`); None: each has its own.
        teaches: which labels are learned from, by their expected error and the network's.
        old: simulated states to mix in, against forgetting.
        device: where to compute.
        seed: of the first episode.
        progress: called while it is tracked and trained.

    Returns:
        Per round: mean and deviation of the normalised improvement, the weights' digest, and how
        many labels there were and were learned from. Where fewer than two recordings have a label
        that teaches, that round is the last, and `stopped` says so.

    Raises:
        InvalidResultError: the weights or the old states cannot be read; nothing is written.
        InvalidConfigError: the folder was begun with other settings, another process is at work in
            it, or both a template and a garment seed are given; nothing is written.
        ClothTrackError: a stage fails.
    """
    weights, out = Path(weights), Path(out)
    garment = None if garment_seed is None else OneGarment(kind, garment_seed)
    require_one_garment(config.flatten, garment)
    _require_inputs(weights, kind, config, old=old, device=device)
    asked = {"garment_seed": garment_seed, "teaches": teaches.__name__, "seed": seed}
    with locked_output(out):
        _take_up(out / ASKED, weights, kind, config, old=old, asked=asked)
        config = replace(config, flatten=knowing_the_garment(config.flatten, garment, out))
        template = config.flatten.perception.template
        curve: list[dict[str, Any]] = []
        labels: list[EpisodeLabels] = []
        for number in range(config.rounds + 1):
            folder = out / f"round_{number}"
            gained = _flattened(
                folder / "flattening", out / "starts", weights, kind, config,
                garment_seed=garment_seed, device=device, seed=seed,
            )  # fmt: skip
            curve.append(_row(number, weights, gained))
            _write(out / CURVE, curve)
            if number == config.rounds:
                break
            labels += label_episodes(
                folder, kind, weights, config.track, template=template, hindsight=config.hindsight,
                device=device, progress=progress,
            )  # fmt: skip
            if len(labels) < 2:
                raise ClothTrackError(
                    f"{folder}: {len(labels)} of {config.episodes} episodes could be labelled; "
                    "fine-tuning needs two, one of them to select by: give more --episodes"
                )
            worth = _weighed(
                folder, labels, weights, kind, teaches, template=template, device=device
            )
            used = [one for one in worth if one.used]
            curve[-1]["labels"] = {"made": len(worth), "used": len(used)}
            if len({one.recording for one in used}) < 2:
                curve[-1]["stopped"] = STOPPED
            _write(out / CURVE, curve)
            if "stopped" in curve[-1]:
                break
            weights = _tuned(
                weights, taught(labels, worth), folder / "tuned", config, old=old, device=device,
                progress=progress,
            )  # fmt: skip
        return curve


def _row(number: int, weights: Path, gained: Sequence[float]) -> dict[str, Any]:
    """Return one point of the curve."""
    return {
        "round": number,
        "weights": weights.name,
        "weights_sha256": content_hash(weights),
        "episodes": len(gained),
        "mean": float(np.mean(gained)),
        "deviation": float(np.std(gained, ddof=1)) if len(gained) > 1 else 0.0,
        "improvement": list(gained),
    }


def _require_inputs(
    weights: Path, kind: str, config: ImprovementConfig, *, old: Path | None, device: str
) -> None:
    """Refuse now what a round would trip over hours later."""
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.model_loading import design_of
    from clothtrack.reconstruction.training.checkpoint import load_weights
    from clothtrack.reconstruction.training.processes import require_torch_device

    require_torch_device(device)
    start = load_weights(weights)
    design = design_of(start)
    design.load(start, kind, device=device)
    wanted = type(design.configuration("finetune_short"))
    if not isinstance(config.finetune, wanted):
        raise InvalidConfigError(
            f"finetune is a {type(config.finetune).__name__}, and {weights} is fine-tuned by a "
            f"{wanted.__name__}; give {wanted.__name__}.preset('finetune_short')"
        )
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
    asked: dict[str, Any],
) -> None:
    """Note what the rounds depend on, or refuse to mix them with rounds of something else."""
    perceived = replace(config.flatten.perception, weights=str(weights))
    settings = {
        **asdict(config),
        "flatten": episode_identity(replace(config.flatten, perception=perceived)),
        "track": counted_settings(config.track),
    }
    # Each round depends on those before it alone.
    del settings["rounds"]
    states = None if old is None else content_hash(old / LIST_FILE)
    begin_run(path, {**asked, "garment": kind, "settings": settings, "old": states})


def _flattened(
    folder: Path,
    starts: Path,
    weights: Path,
    kind: GarmentKind,
    config: ImprovementConfig,
    *,
    garment_seed: int | None,
    device: str,
    seed: int,
) -> list[float]:
    """Return the normalised improvement of each episode with these weights."""
    perceived = replace(config.flatten.perception, weights=str(weights))
    flatten = replace(config.flatten, perception=perceived)
    parts = shared_parts(kind, flatten, starts=starts, device=device)
    gained = []
    for number in range(config.episodes):
        store = flatten_simulated(
            folder,
            SimulatedEpisode(kind, seed + number, garment_seed=garment_seed),
            flatten,
            robot_config=config.robot,
            parts=parts,
            device=device,
        )
        gained.append(improvement(store.steps)[-1])
    return gained


def _weighed(
    folder: Path,
    labels: Sequence[EpisodeLabels],
    weights: Path,
    kind: str,
    teaches: Teaches,
    *,
    template: str,
    device: str,
) -> list[LabelWorth]:
    """Return the worth of every label; that of an earlier run once the network is tuned."""
    path = folder / WORTH
    if path.exists() and (folder / "tuned" / MODEL).exists():
        return read_worth(path)
    worth = worth_of(labels, weights, kind, teaches, template=template, device=device)
    write_worth(path, worth)
    return worth


def _tuned(
    weights: Path,
    labels: "Sequence[LabelledRecording]",
    folder: Path,
    config: ImprovementConfig,
    *,
    old: Path | None,
    device: str,
    progress: Progress | None,
) -> Path:
    """Return the network fine-tuned on these labels.

    Raises:
        ClothTrackError: it was interrupted.
    """
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.model_loading import design_of
    from clothtrack.reconstruction.training.checkpoint import load_weights
    from clothtrack.reconstruction.training.processes import Processes

    tuned = folder / MODEL
    if tuned.exists():
        return tuned
    share = config.old_share if old is not None else 0.0
    learning = config.finetune.mixing(share)
    start = load_weights(weights)
    outcome = design_of(start).finetune(
        start,
        labels,
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
