"""Estimate the cloth state before each action, with the network or a named control.

A perception uses only recordings and weights. The exception is the control `truth`, which gets the
true cloth from a simulated robot; all its results are labeled "control".
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.files.bounds import Checked, Count
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.template_file import read_template
from clothtrack.simulation.parameters import RESTING_HEIGHT_M

logger = logging.getLogger(__name__)

PerceptionName = Literal["network", "truth"]

TrueCloth = Callable[[], tuple[ClothMesh, Float[np.ndarray, "vertices 3"]]]


@dataclass(frozen=True)
class PerceptionConfig(Checked):
    """Settings of the perception.

    Attributes:
        name: "network": reconstruct the cloth from each picture; "truth": the control.
        weights: file with the network's weights; empty: those shipped with the package, if any.
        template: file of the garment's own template (`clothtrack garment`); empty: a garment of
            usual cut, in the size given by the recording.
        refined: fine-tune the network's mesh to the picture.
        vertex_count: approximate vertex count of the network's mesh.
    """

    name: PerceptionName = "network"
    weights: str = ""
    template: str = ""
    refined: bool = True
    vertex_count: Count = 1000


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated cloth state.

    Attributes:
        flat: the garment at rest, on the table [m]; canonical coordinates filled.
        positions: estimated vertex positions [m].
        expected_error_m: mean vertex error predicted by the network [m]; None if there is no
            prediction.
        opposite: vertex positions with the layers in the opposite order [m], if that order is
            equally likely; otherwise None.
    """

    flat: ClothMesh
    positions: Float[np.ndarray, "vertices 3"]
    source: str
    expected_error_m: float | None = None
    opposite: Float[np.ndarray, "vertices 3"] | None = None


@runtime_checkable
class Perception(Protocol):
    """Estimator of the cloth state."""

    def perceive(self, recording: Recording) -> Estimate:
        """Return the estimated cloth state in the recording's last picture."""
        ...


class NetworkPerception:
    """Perception by the network, from the last picture. Needs [learn] and weights."""

    def __init__(self, kind: str, config: PerceptionConfig, *, device: str = "cpu") -> None:
        """Load the networks."""
        from clothtrack.reconstruction.model_loading import load_model

        self._kind, self._config, self._device = kind, config, device
        path = Path(config.weights) if config.weights else None
        self._network = load_model(kind, path, device=device)
        self._template = read_template(Path(config.template)) if config.template else None

    def perceive(self, recording: Recording) -> Estimate:
        """Reconstruct the cloth from the last picture alone."""
        from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
        from clothtrack.reconstruction.depth_input import DepthInput
        from clothtrack.reconstruction.first_mesh import laid_flat

        config, last = self._config, recording.frames[-1]
        depth, mask, camera = cloth_picture(recording, last)
        result = self._network.mesh(
            DepthInput(depth, mask, camera, recording.table, self._kind),
            self._kind,
            size_m=None if self._template is not None else recording.cloth.size_m,
            template=self._template,
            vertex_count=config.vertex_count,
            refined=config.refined,
            observation=observe(recording, last),
            device=self._device,
        )
        rest = result.reconstruction.rest
        if result.mesh is None or rest is None or recording.table is None:
            raise InvalidRecordingError(
                f"{recording.folder}: the network makes no mesh of it "
                f"({result.reconstruction.status}); flattening needs a table and a mesh"
            )
        positions = result.mesh.vertices.astype(np.float64)
        flat = laid_flat(rest, positions, recording.table, RESTING_HEIGHT_M)
        # Depth hardly distinguishes a fold on top from a fold below.
        opposite = None if result.opposite is None else result.opposite()
        return Estimate(flat, positions, "network", result.expected_error_m, opposite)


class _ControlPerception:
    """Control that returns the true cloth; an upper bound for perception, not a result."""

    def __init__(self, true_cloth: TrueCloth) -> None:
        """Set the function that returns the simulated robot's true cloth."""
        self._true_cloth = true_cloth

    def perceive(self, recording: Recording) -> Estimate:
        """Return the truth, labeled as a control."""
        del recording
        flat, positions = self._true_cloth()
        return Estimate(flat, np.array(positions), "control: truth")


def perception_of(
    kind: str,
    config: PerceptionConfig,
    *,
    true_cloth: TrueCloth | None = None,
    device: str = "cpu",
) -> Perception:
    """Return the configured perception; `true_cloth` is for the control only."""
    if config.name == "truth":
        if true_cloth is None:
            raise InvalidConfigError(
                "perception is truth, a control that only the simulated robot can give; choose "
                "network"
            )
        return _ControlPerception(true_cloth)
    return NetworkPerception(kind, config, device=device)
