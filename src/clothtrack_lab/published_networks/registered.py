"""Registration of the published networks under an entry point of `clothtrack.networks`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack.reconstruction.design import Design, Reconstructor

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
    from clothtrack.reconstruction.data.state_store import StateSet
    from clothtrack.reconstruction.learning_outcome import LearningOutcome
    from clothtrack.reconstruction.training.checkpoint import Weights
    from clothtrack_lab.published_networks.published_config import PublishedConfig

SHIPPED = Path(__file__).parent / "weights"
"""Folder of the shipped weights KIND.safetensors, with a card each."""


def _recognizes(weights: "Weights") -> bool:
    return any(name.startswith("canonicaliser.") for name in weights.tensors)


def _load(weights: "Weights", kind: str, *, device: str = "cpu") -> Reconstructor:
    from clothtrack_lab.published_networks.published_meshes import PublishedMeshes

    return PublishedMeshes.load(weights, kind, device=device)


def _configuration(training: str, *, network: str = "small", seed: int = 0) -> "PublishedConfig":
    from clothtrack_lab.published_networks.published_config import PublishedConfig

    return PublishedConfig.preset(training, network=network, seed=seed)


def _pretrain(
    states: "Sequence[StateSet]", config: "PublishedConfig", folder: Path, **options: Any
) -> "LearningOutcome":
    from clothtrack_lab.published_networks.training import pretrain

    return pretrain(states, config, folder, **options)


def _finetune(
    start: "Weights",
    labels: "Sequence[LabeledRecording]",
    config: "PublishedConfig",
    folder: Path,
    **options: Any,
) -> "LearningOutcome":
    from clothtrack_lab.published_networks.training import finetune

    return finetune(start, labels, config, folder, **options)


PUBLISHED = Design(
    name="published",
    networks=("small",),
    extra="published",
    modules=("torch", "safetensors", "igl", "skimage"),
    recognizes=_recognizes,
    load=_load,
    configuration=_configuration,
    pretrain=_pretrain,
    finetune=_finetune,
)
"""One network per kind of garment: towels and T-shirts."""
