"""The model card of a network: training data, method, accuracy and limits.

It is written next to the weights, only from the content of the weights file and the training.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clothtrack.files.atomic_write import atomic_file
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M
from clothtrack.reconstruction.training.checkpoint import Weights
from clothtrack_lab.model_cards import CARD, made_in_words, markdown_table
from clothtrack_lab.published_networks.published_config import STAGES

NAMES = {"towel": "towel", "tshirt": "T-shirt"}

_LIMITS = """\
- It has seen simulated {name}s only, lying on a table, from a camera that looks down on them. Other
  garments, cloth that hangs, and tables that are not level are outside of what it knows.
- Layers that nobody sees are guessed, and so is which of two look-alike sides faces up.
- A small Chamfer distance says little about whether the right points are in the right places: the
  errors above are those of material points, up to the symmetries of the garment."""


def model_card(weights: Weights, cpu_s: Mapping[str, float], made: Mapping[str, Any]) -> str:
    """Return the card as Markdown.

    Args:
        cpu_s: CPU time of each stage [s], by name.
    """
    name = NAMES.get(weights.kind, weights.kind)
    content = weights.path.read_bytes()
    count = sum(value.numel() for value in weights.tensors.values())
    data = weights.provenance[STAGES[0]]["data"]
    parts = [
        f"# Reconstruction network: {name}",
        "From one depth picture of a crumpled cloth to its canonical coordinates, winding numbers "
        f"and the place of every point, hidden ones too. {count / 1e6:.2f} million numbers, "
        f"{len(content) / 1e6:.1f} MB.",
        f"`{weights.path.name}`, SHA-256 `{hashlib.sha256(content).hexdigest()}`",
        "## Data\n\n" + _data(data, weights.kind),
        "## Held-out measures\n\n"
        "One example in ten, by whole episodes or trajectories, which training never saw and by "
        "which the weights were selected.\n\n" + _measures(weights),
        "## Training\n\n" + _training(weights, cpu_s),
        "## Made with\n\n" + made_in_words(made),
        "## What it cannot do\n\n" + _LIMITS.format(name=name),
        "## Network\n\n```json\n" + json.dumps(dict(weights.network), indent=1) + "\n```",
    ]
    return "\n\n".join(parts) + "\n"


def _data(data: Mapping[str, Any], kind: str) -> str:
    if "recordings" in data:
        return (
            f"{data['labels']} pseudo-labels of {len(data['recordings'])} tracked recordings, "
            "beginning with a trained network."
        )
    size = " by ".join(f"{100 * length:.0f}" for length in DEFAULT_SIZES_M[kind])
    return (
        f"{data['states']} simulated states (`clothtrack simulate --states`), each drawn anew in "
        f"every epoch: turned, mirrored, filmed by another camera with noise. Garments vary in "
        f"size, around {size} cm.{_begun(data)}"
    )


def _begun(data: Mapping[str, Any]) -> str:
    """Return the weights that a pretraining started from, if any."""
    if "start" not in data:
        return ""
    earlier = data["start"]["trained"].get(STAGES[0], {}).get("data", {}).get("states")
    of = f" of {earlier} other simulated states" if earlier else ""
    return f" Training went on, beginning with a trained network{of}."


def _measures(weights: Weights) -> str:
    rows = [
        (stage, name.replace("_", " "), f"{value:.4g}")
        for stage in STAGES
        for name, value in weights.provenance[stage]["held_out"].items()
    ]
    return markdown_table(("stage", "measure", "value"), rows)


def _training(weights: Weights, cpu_s: Mapping[str, float]) -> str:
    fields = ("epochs", "batch_size", "low_rate", "high_rate", "rise_epochs", "bfloat16", "seed")
    rows = []
    for stage in STAGES:
        provenance = weights.provenance[stage]
        values = [str(provenance["training"][name]) for name in fields]
        rows.append((stage, *values, str(provenance["step"]), f"{cpu_s[stage] / 60:.0f}"))
    titles = [name.replace("_", " ") for name in fields]
    return markdown_table(("stage", *titles, "kept step", "CPU minutes"), rows)


def write_model_card(weights: Weights, cpu_s: Mapping[str, float], made: Mapping[str, Any]) -> Path:
    """Write the card next to the weights, completely or not at all."""
    path = weights.path.with_name(CARD)
    with atomic_file(path) as unfinished:
        unfinished.write_text(model_card(weights, cpu_s, made), encoding="utf-8")
    return path
