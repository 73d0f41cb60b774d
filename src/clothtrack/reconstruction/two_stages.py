"""Pretraining and fine-tuning: both stages in turn, and one file of weights at the end."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import made_with
from clothtrack.reconstruction.data.examples import collate
from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording, PseudoLabelExamples
from clothtrack.reconstruction.data.state_examples import StateExamples
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.learning_config import LearningConfig
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.model import MeshReconstructor
from clothtrack.reconstruction.model_card import PACKAGES, write_model_card
from clothtrack.reconstruction.networks.canonicalisation import Canonicaliser
from clothtrack.reconstruction.networks.network_config import PRESETS, NetworkConfig
from clothtrack.reconstruction.stages import (
    CanonicalisationStage,
    CompletionStage,
    canonicalisation_stage,
    completion_stage,
)
from clothtrack.reconstruction.training.batches import Examples, Mixture, Subset, split_by_group
from clothtrack.reconstruction.training.checkpoint import (
    Weights,
    check_tensors,
    load_weights,
    save_weights,
)
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train
from clothtrack.reconstruction.training.training_run import TrainingOutcome

MODEL = "model.safetensors"


def pretrain(
    states: Sequence[StateSet],
    network: NetworkConfig,
    config: LearningConfig,
    folder: Path,
    *,
    start: Path | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train both stages on simulated states, from nothing or further.

    Args:
        states: folders of one kind of garment.
        network: sizes of the networks.
        config: how.
        folder: gets a folder per stage and `model.safetensors`.
        start: weights of both stages to begin with, of the same garment and sizes.
        processes: who trains together.
        progress: called after every step.

    Raises:
        InvalidConfigError: the states are too few or of several kinds.
        InvalidResultError: states or progress are damaged or belong to another training, or the
            weights to begin with are of another garment or network.
        StorageError: when the disk refuses.
    """
    seed = config.canonicalisation.seed
    examples = StateExamples(
        states, network, config.examples, rendering=config.rendering, seed=seed
    )
    data = {
        "states": len(examples),
        "sets": [one.identity for one in states],
        "examples": asdict(config.examples),
        "rendering": config.rendering.as_dict(),
    }
    weights = None if start is None else load_weights(start)
    if weights is not None:
        _require_kind(weights, examples.kind, "states")
        if network_of(weights) != network:
            raise InvalidResultError(
                f"{start}: its network has other sizes than the one that is to be trained; give "
                "weights of the same preset"
            )
        data["start"] = _beginning(weights)
    learning = _Learning(network, config, folder, processes=processes, progress=progress)
    return learning.both(_Material(examples, examples.groups, data, weights))


def finetune_two_stages(
    start: Weights,
    labels: Sequence[LabelledRecording],
    config: LearningConfig,
    folder: Path,
    *,
    old: Sequence[StateSet] = (),
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train both stages further on pseudo-labels (paper, Sec. III-C).

    Arguments and errors are those of `fine_tuning.finetune`, but that the weights are read.
    """
    network = network_of(start)
    seed = config.canonicalisation.seed
    examples = PseudoLabelExamples(labels, network, config.examples, seed=seed)
    _require_kind(start, examples.kind, "labels")
    others = None
    if old:
        others = StateExamples(old, network, config.examples, rendering=config.rendering, seed=seed)
        if others.kind != examples.kind:
            raise InvalidConfigError(f"old states are of {others.kind!r}, not {examples.kind!r}")
    elif config.canonicalisation.old_share or config.completion.old_share:
        raise InvalidConfigError("old_share is above 0, but no old states are given; name them")
    data = {
        "start": _beginning(start),
        "recordings": sorted(set(examples.groups)),
        "labels": len(examples),
        "old_states": 0 if others is None else len(others),
        "examples": asdict(config.examples),
    }
    learning = _Learning(network, config, folder, processes=processes, progress=progress)
    return learning.both(_Material(examples, examples.groups, data, start, others))


def _require_kind(weights: Weights, kind: str, material: str) -> None:
    if kind != weights.kind:
        raise InvalidResultError(
            f"{weights.path} is for {weights.kind!r}, the {material} are of {kind!r}; give weights "
            "of the same garment"
        )


def _beginning(weights: Weights) -> Mapping[str, Any]:
    """What is stored of the weights that a training begins with."""
    return {"kind": weights.kind, "trained": _plain(dict(weights.provenance))}


def network_of(weights: Weights) -> NetworkConfig:
    """The configuration of the networks that weights of both stages belong to.

    The weights are compared with it before any network is built: what is built then is as large
    as the file, and not as large as the file claims.

    Raises:
        InvalidResultError: it is none that this version knows, or its weights are others.
    """
    try:
        values = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in weights.network.items()
        }
        network = NetworkConfig(**values)
        with torch.device("meta"):
            shapes = MeshReconstructor(network, weights.kind)
    except (TypeError, InvalidConfigError) as error:
        raise InvalidResultError(
            f"{weights.path}: its network is none that this version knows ({error}); give weights "
            f"of one of {', '.join(PRESETS)}"
        ) from error
    check_tensors(shapes, weights.tensors, weights.path)
    return network


@dataclass(frozen=True, eq=False)
class _Material:
    """What both stages learn from.

    Attributes:
        examples: all of them.
        groups: of each: episode or trajectory.
        data: what they are made of, stored with the weights.
        start: weights to begin with; fresh ones when None.
        others: examples of the old cloth to mix in.
    """

    examples: StateExamples | PseudoLabelExamples
    groups: Sequence[Any]
    data: Mapping[str, Any]
    start: Weights | None = None
    others: StateExamples | None = None


class _Learning:
    """Both stages of one training, one after the other."""

    def __init__(
        self,
        network: NetworkConfig,
        config: LearningConfig,
        folder: Path,
        *,
        processes: Processes | None,
        progress: Progress | None,
    ) -> None:
        self.network, self.config, self.folder = network, config, folder
        self.processes = processes or Processes()
        self.progress = progress
        self.outcomes: dict[str, TrainingOutcome] = {}

    def both(self, material: _Material) -> LearningOutcome:
        """Train stage 1, then stage 2 behind its best weights, and write both as one file."""
        seed, kind = self.config.canonicalisation.seed, material.examples.kind
        first = canonicalisation_stage(self.network, kind, seed=seed)
        if material.start is not None:
            material.start.load_into(first.canonicaliser, prefix="canonicaliser.")
        best = self._one(first, self.config.canonicalisation, material)
        if best is None:
            return LearningOutcome(self.outcomes, None)
        canonicaliser = Canonicaliser(self.network)
        best.load_into(canonicaliser, prefix="canonicaliser.")
        second = completion_stage(canonicaliser, kind, seed=seed)
        if material.start is not None:
            for name, module in second.trained.named_children():
                material.start.load_into(module, prefix=f"{name}.")
        behind = {**material.data, "canonicaliser_step": best.provenance["step"]}
        rest = self._one(second, self.config.completion, replace(material, data=behind))
        if rest is None:
            return LearningOutcome(self.outcomes, None)
        path = self.folder / MODEL
        if self.processes.writes:
            save_weights(
                path,
                {**best.tensors, **rest.tensors},
                self.network,
                kind=kind,
                provenance={one.provenance["stage"]: one.provenance for one in (best, rest)},
            )
            write_model_card(
                load_weights(path),
                {name: outcome.cpu_s for name, outcome in self.outcomes.items()},
                {**made_with(PACKAGES), "device": self.processes.machine},
            )
        self.processes.wait()
        return LearningOutcome(self.outcomes, path)

    def _one(
        self,
        stage: CanonicalisationStage | CompletionStage,
        config: TrainingConfig,
        material: _Material,
    ) -> Weights | None:
        """Train one stage; its best weights, or None after an interrupt."""
        # The order of memory in which convolutions are faster, 1.4 times on a processor.
        stage.canonicaliser.to(memory_format=torch.channels_last)
        training, held_out = split_by_group(material.groups, config.held_out_share, config.seed)
        chosen: Examples = Subset(material.examples, training)
        if material.others is not None and config.old_share > 0.0:
            chosen = Mixture(chosen, material.others, config.old_share, seed=config.seed)
        outcome = train(
            stage.to(self.processes.device),
            chosen,
            Subset(material.examples, held_out),
            config,
            self.folder / stage.name,
            collate=collate,
            data=material.data,
            processes=self.processes,
            progress=self.progress,
        )
        self.outcomes[stage.name] = outcome
        if outcome.status == "interrupted" or outcome.weights is None:
            return None
        return load_weights(outcome.weights)


def _plain(value: Any) -> Any:
    """Tuples as lists, as they come back from a file."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value
