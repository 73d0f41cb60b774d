"""What a live tracker is made of once the first picture is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from clothtrack.evaluation.label_evidence import mean_distance
from clothtrack.live.live_judge import LiveJudge
from clothtrack.live.recovery import Found
from clothtrack.live.search_beside import Asked, in_live_frames
from clothtrack.live.search_process import Answer, Setup
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.methods import METHODS, Components
from clothtrack.tracking.pipeline import checked_initial_state
from clothtrack.tracking.protocols import Method, Observe, State, Watch
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.theta import Theta


@dataclass(eq=False)
class LiveParts:
    """The method, its state and its records.

    Attributes:
        components: what the functions of the method share.
        method: the functions of Algorithm 1.
        state: the cloth between actions; where an action is under way, at its beginning.
        theta: its parameters.
        recorder: keeps what was tracked.
        judge: says how far to trust the mesh.
        gap_m: how far the first mesh lay from its cloud [m].
        origin: where the first mesh is from.
        begun_anew: the frames at which another mesh took the place of one that was lost, and where
            it was from.
    """

    components: Components
    method: Method
    state: State
    theta: Theta
    recorder: Recorder
    judge: LiveJudge
    gap_m: float | None
    origin: Mapping[str, object]
    begun_anew: list[dict[str, object]] = field(default_factory=list)

    def setup(self, seen: Observation) -> Setup:
        """Return what the process that searches needs; `seen` is the first cloud."""
        parts, first = self.components, self.components.recording.frames[0]
        cloth = replace(parts.recording.cloth, template=None)
        recording = replace(
            parts.recording, frames=(Frame(0, first.time_s),), actions=(), picker_paths={},
            cloth=cloth,
        )  # fmt: skip
        return Setup(recording, parts.mesh, parts.config, parts.start, seen, parts.device)

    @classmethod
    def of_first(
        cls,
        recording: Recording,
        config: RunConfig,
        observe: Observe,
        *,
        segmenter: Segmenter | None,
        device: str,
        force: bool,
        watch: Watch | None,
    ) -> "LiveParts":
        """Find the first mesh in the first picture, and make the method for it.

        Args:
            recording: what there is of it.
            config: the settings.
            observe: the cloud of a frame.
            segmenter: finds the cloth; the recording's own way by default.
            device: "cpu" or "cuda:0".
            force: take a mesh that lies beside its cloud, too.
            watch: is shown every mesh.

        Raises:
            InvalidRecordingError: there is no first mesh, or it lies beside its cloud.
        """
        first, gap_m = checked_initial_state(
            recording, observe(recording.frames[0]), config.initial_state, segmenter=segmenter,
            device=device, force=force,
        )  # fmt: skip
        components = Components(recording, first.mesh, config, observe, first.positions, device)
        made = METHODS[config.mode](components)
        recorder = Recorder(
            recording, first.mesh, made.state, components.visible, watch=watch, on_disk=True
        )
        return cls(
            components, recorder.timed(made.method), made.state, made.theta, recorder,
            LiveJudge(first.mesh, device), gap_m, first.origin,
        )  # fmt: skip

    def keep_searched(self, asked: Asked, answer: Answer) -> None:
        """Keep what a search has found in the place of what was tracked live."""
        recording = self.components.recording
        last, count = asked.frames[-1], len(recording.frames)
        others = [one.first_frame + 1 for one in recording.actions]
        others += [int(str(one["frame"])) for one in self.begun_anew]
        self.recorder.keep(
            in_live_frames(answer, asked.frames, count), answer.end.state,
            answer.losses, answer.calibration, again=asked.number,
            until=min([frame for frame in others if frame > last], default=count),
        )  # fmt: skip

    def stand(self, answer: Answer) -> float:
        """Go on from what a search has found; return how far the mesh moves on average [m]."""
        before, end = self.state.positions[0], answer.end
        self.state, self.theta = end.state, end.theta
        self.components.anchors.bound = dict(end.bound)
        self.judge.end_otherwise(answer.best.positions[-1], end.state.positions[0])
        return mean_distance(end.state.positions[0].astype(float), before.astype(float))

    def begin_anew(self, found: Found, frame: Frame) -> None:
        """Go on from another mesh in a frame in which the cloth rests."""
        # A solver is captured here, and no other thread may launch kernels meanwhile.
        self.judge.wait()
        self.components = replace(self.components, start=found.positions, first_frame=frame.index)
        made = METHODS[self.components.config.mode](self.components)
        before, self.state = self.state.positions[0], made.state
        self.method = self.recorder.timed(made.method)
        self.recorder.begin_anew(frame, made.state)
        self.judge.end_action(np.asarray(before), made.state.positions[0])
        self.begun_anew.append({"frame": frame.index, **found.origin})
