"""Where the cloth is, before each action: the network, the tracker, or a named control.

Perceptions use recordings and weights only, except the control `truth`: it gets the true cloth from
a simulated robot, and all its results are labeled "control".
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidRecordingError
from clothtrack.files.bounds import Checked, Count, Positive
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.from_picture import LOOSE_FIT_M, distance_from_cloud
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.template_file import read_template
from clothtrack.simulation.parameters import RESTING_HEIGHT_M
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.tracker import Tracker

logger = logging.getLogger(__name__)

PerceptionName = Literal["network", "tracker", "truth"]

LONGEST_PATH_M = 0.06
"""Cloth that was carried farther than this between two pictures is perceived anew [m]: a tracker
that is shown the end alone loses it."""

ONE_CANDIDATE = RunConfig(search=SearchConfig(method="none"))
"""The default tracker without a search: a decision must not wait for one."""

TrueCloth = Callable[[], tuple[ClothMesh, Float[np.ndarray, "vertices 3"]]]


@dataclass(frozen=True)
class PerceptionConfig(Checked):
    """How the cloth is found.

    Attributes:
        name: "network": reconstructed anew from each picture; "tracker": reconstructed once, then
            followed through every action; "truth": the control.
        weights: file with the network's weights; empty: those that come with the package, if any.
        template: file of the garment's own template (`clothtrack garment`); empty: a garment of
            usual cut, in the size that the recording says.
        refined: fine-tune the network's mesh to the picture.
        vertex_count: of the network's mesh, about.
        lost_m: a tracked mesh that is farther from its cloud than this is lost, and the cloth is
            perceived anew (root mean square, cloud to mesh) [m].
    """

    name: PerceptionName = "network"
    weights: str = ""
    template: str = ""
    refined: bool = True
    vertex_count: Count = 1000
    lost_m: Positive = LOOSE_FIT_M


@dataclass(frozen=True, eq=False)
class Estimate:
    """One belief of where the cloth is.

    Attributes:
        flat: the garment at rest, on the table [m]; canonical coordinates filled.
        positions: its vertices [m].
        source: "network", "tracker", or "control: truth".
        expected_error_m: mean error of the vertices that the network expects [m]; None where
            nothing says.
        opposite: the vertices with their layers in the opposite order [m], where that is as likely;
            None: it is not.
    """

    flat: ClothMesh
    positions: Float[np.ndarray, "vertices 3"]
    source: str
    expected_error_m: float | None = None
    opposite: Float[np.ndarray, "vertices 3"] | None = None


@dataclass(frozen=True, eq=False)
class Look:
    """What perception is shown.

    Attributes:
        recording: of the latest action, or of the cloth before any.
        acted: whether there is an action in it.
        before: what was believed before the action, if anything was.
    """

    recording: Recording
    acted: bool
    before: Estimate | None = None

    @property
    def frame(self) -> Frame:
        """The latest picture."""
        return self.recording.frames[-1]

    def observation(self) -> Observation:
        """Return the cloud of the latest picture."""
        return observe(self.recording, self.frame)


@runtime_checkable
class Perception(Protocol):
    """Finds the cloth."""

    def perceive(self, look: Look) -> Estimate:
        """Return where the cloth is believed to be."""
        ...


class NetworkPerception:
    """The network's mesh of the latest picture, fine-tuned to it. Needs [learn] and weights."""

    def __init__(self, kind: str, config: PerceptionConfig, *, device: str = "cpu") -> None:
        """Load the networks.

        Raises:
            InvalidResultError: there are no weights, or not for this garment.
        """
        from clothtrack.reconstruction.model_loading import load_model

        self._kind, self._config, self._device = kind, config, device
        path = Path(config.weights) if config.weights else None
        self._network = load_model(kind, path, device=device)
        self._template = read_template(Path(config.template)) if config.template else None

    def perceive(self, look: Look) -> Estimate:
        """Reconstruct the latest picture alone.

        Raises:
            InvalidRecordingError: there is no cloth in the picture, or no mesh comes of it.
        """
        from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
        from clothtrack.reconstruction.depth_input import DepthInput
        from clothtrack.reconstruction.first_mesh import laid_flat

        config, recording = self._config, look.recording
        depth, mask, camera = cloth_picture(recording, look.frame)
        result = self._network.mesh(
            DepthInput(depth, mask, camera, recording.table, self._kind),
            self._kind,
            size_m=None if self._template is not None else recording.cloth.size_m,
            template=self._template,
            vertex_count=config.vertex_count,
            refined=config.refined,
            observation=look.observation(),
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
        # Depth hardly tells a fold that lies on top from one that lies below.
        opposite = None if result.opposite is None else result.opposite()
        return Estimate(flat, positions, "network", result.expected_error_m, opposite)


class TrackerPerception:
    """What was believed before the action, carried through it by Algorithm 1."""

    def __init__(
        self,
        first: Perception,
        *,
        lost_m: float = LOOSE_FIT_M,
        tracker: RunConfig = ONE_CANDIDATE,
        device: str = "cpu",
    ) -> None:
        """Track with `tracker`; `first` estimates at the start and where tracking fails."""
        self._first, self._lost_m = first, lost_m
        self._tracker, self._device = tracker, device

    def perceive(self, look: Look) -> Estimate:
        """Return the tracked estimate; a fresh one before any action, or if tracking fails."""
        recording, start = look.recording, look.before
        if start is None or not look.acted or not recording.actions:
            return self._first.perceive(look)
        path_m = unseen_path_m(recording)
        if path_m > LONGEST_PATH_M:
            logger.warning(
                "%s: cloth is carried %.2f m between two pictures (limit %.2f m); take pictures "
                "all through an action to track it: perceived anew", recording.folder, path_m,
                LONGEST_PATH_M,
            )  # fmt: skip
            return self._first.perceive(look)
        try:
            tracker = Tracker(
                recording,
                start.flat,
                self._tracker,
                lambda frame: observe(recording, frame),
                start=start.positions,
                device=self._device,
            )
            tracked = tracker.track()
        except ClothTrackError as error:
            logger.warning("%s cannot be tracked (%s): perceived anew", recording.folder, error)
            return self._first.perceive(look)
        positions = tracked.actions[-1].positions_after_final_alignment.astype(np.float64)
        if not np.isfinite(positions).all():
            logger.warning("%s: tracking diverged: perceived anew", recording.folder)
            return self._first.perceive(look)
        tracked_mesh = start.flat.with_vertices(positions)
        apart_m = distance_from_cloud(tracked_mesh, look.observation().points)
        if apart_m > self._lost_m:
            logger.warning(
                "%s: the tracked mesh is %.0f mm from its cloud (limit %.0f mm): perceived anew",
                recording.folder, 1e3 * apart_m, 1e3 * self._lost_m,
            )  # fmt: skip
            return self._first.perceive(look)
        return Estimate(start.flat, positions, "tracker")


def unseen_path_m(recording: Recording) -> float:
    """Return how far a picker carries cloth between two pictures of an action, at most [m]."""
    longest = 0.0
    for action in recording.actions:
        frames = recording.frames[action.first_frame : action.last_frame + 1]
        for picker in action.pickers:
            path = recording.picker_paths[picker]
            legs = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) * path.closed[:-1]
            carried = np.interp(
                [frame.time_s for frame in frames], path.time_s, np.append(0.0, np.cumsum(legs))
            )
            longest = max(longest, float(np.diff(carried).max(initial=0.0)))
    return longest


class _ControlPerception:
    """The true cloth: the upper bound of all perception, and no result."""

    def __init__(self, true_cloth: TrueCloth) -> None:
        """Ask a simulated robot for the true cloth."""
        self._true_cloth = true_cloth

    def perceive(self, look: Look) -> Estimate:
        """Return the truth, labeled as a control."""
        del look
        flat, positions = self._true_cloth()
        return Estimate(flat, np.array(positions), "control: truth")


def perception_of(
    kind: str,
    config: PerceptionConfig,
    *,
    true_cloth: TrueCloth | None = None,
    device: str = "cpu",
) -> Perception:
    """Return the perception that a configuration names; `true_cloth` is for the control only.

    Raises:
        InvalidConfigError: the control is asked for where no truth is, or a GPU for the network.
        InvalidResultError: there are no weights, or not for this garment.
    """
    if config.name == "truth":
        if true_cloth is None:
            raise InvalidConfigError(
                "perception is truth, a control that only the simulated robot can give; choose "
                "network or tracker"
            )
        return _ControlPerception(true_cloth)
    network = NetworkPerception(kind, config, device=device)
    if config.name == "network":
        return network
    return TrackerPerception(network, lost_m=config.lost_m, device=device)
