"""Output and style of an experiment's figures: terminal, files and pictures."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from clothtrack.report.palette import INK, PAPER

COLOR_STEP = 6
"""Colors of a picture in a document are rounded to this: nobody sees it, and files are small."""


def say(text: str) -> None:
    """Write to the terminal at once."""
    sys.stdout.write(text)
    sys.stdout.flush()


def write_json(file: Path, figures: Mapping[str, object]) -> None:
    """Write figures as JSON, what is not finite as null; the file is whole or absent."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.partial")
    temporary.write_text(json.dumps(_finite(figures), indent=1, allow_nan=False) + "\n")
    temporary.replace(file)


def write_png(file: Path, picture: UInt8[np.ndarray, "height width 3"]) -> None:
    """Write a picture (red first) for a document, small; the file is whole or absent."""
    file.parent.mkdir(parents=True, exist_ok=True)
    coarse = np.rint(picture / COLOR_STEP).clip(0, 255 // COLOR_STEP) * COLOR_STEP
    bgr = cv2.cvtColor(coarse.astype(np.uint8), cv2.COLOR_RGB2BGR)
    temporary = file.with_name(f".{file.stem}.partial.png")
    cv2.imwrite(str(temporary), bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    temporary.replace(file)


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def plot_style(*, title_size: float) -> dict[str, Any]:
    """Return the report's colors and plain frames, for matplotlib's `rc_context`.

    Args:
        title_size: of the panels' titles [points].
    """
    return {
        "font.size": 9, "axes.edgecolor": INK, "text.color": INK, "axes.labelcolor": INK,
        "xtick.color": INK, "ytick.color": INK, "axes.facecolor": PAPER,
        "figure.facecolor": PAPER, "axes.spines.top": False, "axes.spines.right": False,
        "axes.titlesize": title_size, "axes.titleweight": "bold", "axes.titlelocation": "left",
    }  # fmt: skip
