"""The model card of learned mesh dynamics: training data, accuracy and limits.

It is written next to the weights, from the content of the weights file and the roll-outs.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clothtrack.files.atomic_write import write_file
from clothtrack.reconstruction.training.checkpoint import Weights
from clothtrack_lab.model_cards import CARD, made_in_words, markdown_table

_LIMITS = """\
- It has learned from our simulator, where materials were drawn at random, and knows none of them.
- The mesh has edges of about 25 mm; folds that are finer are not in it.
- It predicts one gripper that takes one point, on a level table.
- Whether to plan in it or in the simulator, `python experiments planning_dynamics` tells."""


def _learned_in_words(whole: Mapping[str, float]) -> str:
    """Return how much of the motion is learned, if both measures are known."""
    if "whole_untrained_mm" not in whole:
        return ""
    alone, whole_mm = whole["whole_untrained_mm"], whole["whole_error_mm"]
    return (
        "\n- Much of it is the plain cloth that the network corrects (`mesh_prior.py`): "
        f"alone it\n  ends {alone:.1f} mm from the simulator, with the network {whole_mm:.1f} mm."
    )


def write_dynamics_card(
    weights: Weights, whole: Mapping[str, float], cpu_s: float, made: Mapping[str, Any]
) -> Path:
    """Write the card next to the weights, completely or not at all.

    Args:
        cpu_s: CPU time of the training [s].
    """
    content = weights.path.read_bytes()
    count = sum(value.numel() for value in weights.tensors.values())
    provenance = weights.provenance
    data, training = provenance["data"], provenance["training"]
    measures = {**provenance["held_out"], **whole}
    names = ("epochs", "low_rate", "high_rate", "rise_epochs", "bfloat16", "seed")
    asked = {name.replace("_", " "): str(training[name]) for name in names}
    asked |= {name.replace("_", " "): str(data[name]) for name in ("windows", "unrolled")}
    asked["noise mm"] = f"{1e3 * data['noise_m']:g}"
    asked |= {"kept step": str(provenance["step"]), "CPU minutes": f"{cpu_s / 60:.0f}"}
    parts = [
        "# Learned mesh dynamics",
        "Where the vertices of a coarse garment are after a pick-and-place. "
        f"{count / 1e3:.0f} thousand numbers, {len(content) / 1e6:.1f} MB.",
        f"`{weights.path.name}`, SHA-256 `{hashlib.sha256(content).hexdigest()}`",
        "## Data\n\n"
        f"{data['roll_outs']} roll-outs of the simulator (`clothtrack_lab.train_dynamics`) in "
        f"{data['shards']} shards of one garment each: {weights.kind}.",
        "## Held-out measures\n\n"
        "One shard in ten, which training never saw and by which the weights were selected.\n\n"
        + markdown_table(
            ("measure", "value"),
            [(name.replace("_", " "), f"{value:.4g}") for name, value in measures.items()],
        ),
        "## Training\n\n" + markdown_table(list(asked), [list(asked.values())]),
        "## Made with\n\n" + made_in_words(made),
        "## What it cannot do\n\n" + _LIMITS + _learned_in_words(whole),
        "## Network\n\n```json\n" + json.dumps(dict(weights.network), indent=1) + "\n```",
    ]
    path = weights.path.with_name(CARD)
    write_file(path, ("\n\n".join(parts) + "\n").encode())
    return path
