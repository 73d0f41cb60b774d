"""Components of a live tracker after the first picture."""

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
    """Method of a live tracker, with its state and records.

    Attributes:
        components: components shared by the functions of the method.
        state: the cloth between actions; during an action, at its beginning.
        gap_m: distance of the first mesh from its cloud [m].
        begun_anew: frames at which a new mesh replaced a lost one, with its source.
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
        """Return the setup of the search process; `seen` is the first cloud."""
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
        """Find the first mesh in the first picture, and create the method for it."""
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
        """Replace the live track of an action with its search result."""
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
        """Continue from a search result; return the mean shift of the mesh [m]."""
        before, end = self.state.positions[0], answer.end
        self.state, self.theta = end.state, end.theta
        self.components.anchors.bound = dict(end.bound)
        self.judge.end_otherwise(answer.best.positions[-1], end.state.positions[0])
        return mean_distance(end.state.positions[0].astype(float), before.astype(float))

    def begin_anew(self, found: Found, frame: Frame) -> None:
        """Continue from another mesh in a frame in which the cloth rests."""
        # No other thread may launch kernels while a solver is captured here.
        self.judge.wait()
        self.components = replace(self.components, start=found.positions, first_frame=frame.index)
        made = METHODS[self.components.config.mode](self.components)
        before, self.state = self.state.positions[0], made.state
        self.method = self.recorder.timed(made.method)
        self.recorder.begin_anew(frame, made.state)
        self.judge.end_action(np.asarray(before), made.state.positions[0])
        self.begun_anew.append({"frame": frame.index, **found.origin})
