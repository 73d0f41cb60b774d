"""Whether a label teaches anything: its expected error against that of the network it would teach.

A label that is farther off than the network's own mesh of the same picture makes the network worse.
Nobody knows either error; both are told without the truth. What decides is handed in (`Teaches`),
so that an ablation is another function.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack.errors import InvalidRecordingError, InvalidResultError
from clothtrack.geometry.mesh import ClothMesh

if TYPE_CHECKING:
    from clothtrack.reconstruction.design import Reconstructor

Teaches = Callable[[float, float | None], bool]
"""Decides by the expected errors [mm] of label and network; the latter is None where the network
states none."""


@dataclass(frozen=True)
class LabelWorth:
    """One label beside the network that it would teach.

    Attributes:
        recording: name.
        frame: of the recording.
        label_mm: expected error of the label [mm].
        network_mm: expected error of the network's mesh of the same picture [mm]; None where it
            states none or makes no mesh.
        used: whether it is learned from.
    """

    recording: str
    frame: int
    label_mm: float
    network_mm: float | None
    used: bool


def better_than_network(label_mm: float, network_mm: float | None) -> bool:
    """Whether the label is expected to be nearer to the truth; so is every one that nobody doubts.

    Args:
        label_mm: expected error of the label [mm].
        network_mm: of the network's mesh [mm]; None: it says nothing.
    """
    return network_mm is None or label_mm < network_mm


def with_first_mesh(label_mm: float, origin: Mapping[str, Any]) -> float:
    """Expected error of a label [mm] that began with a mesh which was not known well itself.

    The quality model is fitted on trajectories that begin with a template 2 to 3 mm off. A tracker
    keeps the error of its first mesh: where that is the network's, both are added as independent
    errors are.

    Args:
        label_mm: what the quality model expects [mm].
        origin: of the first mesh, as the result stores it (`initial_state` of its provenance).
    """
    return math.hypot(label_mm, 1e3 * (origin.get("expected_error_m") or 0.0))


def network_error_mm(
    network: "Reconstructor",
    recording: Path,
    frame: int,
    *,
    kind: str,
    template: ClothMesh | None = None,
    device: str = "cpu",
) -> float | None:
    """The error that the network expects of its own mesh of one picture [mm].

    Args:
        network: one that states no error is not asked.
        recording: its folder.
        frame: of the recording.
        kind: "towel", "tshirt" or "trousers".
        template: the garment's own mesh; one of the recording's size when None.
        device: where to compute.

    Returns:
        None where the network states no error or makes no mesh.
    """
    from clothtrack.reconstruction.depth_input import from_recording

    if not network.states_error:
        return None
    picture = from_recording(recording, frame)
    try:
        found = network.mesh(picture, kind, size_m=picture.size_m, template=template, device=device)
    except (InvalidRecordingError, InvalidResultError):
        return None
    return None if found.expected_error_m is None else 1e3 * found.expected_error_m
