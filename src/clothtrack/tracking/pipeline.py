"""Run the method over a data set: from recordings to tracked trajectories."""

import hashlib
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import (
    InvalidConfigError,
    InvalidRecordingError,
    StorageError,
)
from clothtrack.files.atomic_write import content_hash, name_problem
from clothtrack.files.many_items import Attempt, attempts
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress, one_of
from clothtrack.files.provenance import made_with
from clothtrack.files.worker_pool import require_workers
from clothtrack.recordings.camera_view import camera_views
from clothtrack.recordings.geometry_checks.checks import UNIT_CHECKS, check_geometry
from clothtrack.recordings.geometry_checks.cloth import LARGEST_GAP_M, mesh_gap_m
from clothtrack.recordings.geometry_checks.finding import ObservedFrames
from clothtrack.recordings.geometry_checks.picker import gap_remedy, held_over
from clothtrack.recordings.identity import DIGEST_FIELD, recording_digest
from clothtrack.recordings.point_cloud import SPACING_M, Observation, observation_of
from clothtrack.recordings.point_following import PointFollower
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.configuration import InitialStateConfig, RunConfig
from clothtrack.tracking.initial_state import InitialState, find_initial_state
from clothtrack.tracking.methods import Assembled, Components
from clothtrack.tracking.protocols import Method, Watch
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack.tracking.tracker import Tracker

logger = logging.getLogger(__name__)

_CLOUDS_KEPT = 256
"""Maximum number of clouds in memory, about 100 MB with pictures of 640 x 480. Other clouds are
read and segmented again when they are needed."""

_LONGEST_HELD_GAP_S = 10.0
"""Longest time without a frame in which a picker may hold cloth [s]."""

Judge = Callable[..., Mapping[str, Any]]
"""Return the verdict on a trajectory, as it is stored: `judge(tracked, recording, segmenter=,
device=, frames=)`. It is passed in because tracking does not depend on evaluation."""

_PARTS = tuple(part.name for part in fields(Method))
"""The functions of Algorithm 1 that a caller may replace (`tracking.protocols.Method`)."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of tracking one recording.

    Attributes:
        result: the tracked trajectory on disk, or None after an error.
        error: the error in one line that names the recording.
        tracked_again: whether it had been finished before, but the recording has changed since.
    """

    recording: Path
    result: Path | None
    skipped: bool = False
    error: str = ""
    tracked_again: bool = False


def observer(
    recording: Recording,
    spacing_m: float,
    segmenter: Segmenter | None = None,
    *,
    color: bool = False,
    kept: int = _CLOUDS_KEPT,
    followed: int | None = None,
) -> Callable[[Frame], Observation]:
    """Return a function that gives the cloud of a frame and caches those of the latest frames.

    A search tracks one action several times and would segment every picture of it each time. The
    verdict on the trajectory also uses the same clouds.

    Args:
        spacing_m: clouds are thinned to one point per cube of this size [m]; 0 keeps all.
    """
    follower = PointFollower(recording, segmenter, kept=followed) if color else None

    @lru_cache(maxsize=kept)
    def seen(frame_index: int) -> Observation:
        frame = recording.frames[frame_index]
        looks = follower is not None and not follower.knows(frame)
        views = camera_views(recording, frame, segmenter, color=looks)
        observation = observation_of(recording, frame, views, spacing_m=spacing_m or None)
        if follower is None:
            return observation
        return replace(observation, followed=follower(frame, views))

    return lambda frame: seen(frame.index)


def track_recording(
    recording: Recording,
    config: RunConfig,
    *,
    device: str = "cpu",
    segmenter: Segmenter | None = None,
    progress: Progress | None = None,
    parts: Mapping[str, Any] | None = None,
    assemble: Callable[[Components], Assembled] | None = None,
    force: bool = True,
    watch: Watch | None = None,
    judge: Judge | None = None,
) -> TrackedTrajectory:
    """Track a recording: clouds, first mesh, calibration and tracking (Fig. 2 of the paper)."""
    for name in (parts := parts or {}):
        if name not in _PARTS:
            raise InvalidConfigError(
                f"Algorithm 1 has no part {name!r}; there are {', '.join(_PARTS)}"
            )
    if not force:
        _refuse_wrong_units(recording)
    _refuse_held_gaps(recording)
    clock = time.process_time()
    stamp = provenance(recording, config, device)
    cloud = observer(recording, config.cloud_spacing_m, segmenter, color=config.color)
    if progress is not None:
        progress(f"{recording.name}: first mesh", 0, 0)
    first, gap_m = checked_initial_state(
        recording, cloud(recording.frames[0]), config.initial_state, segmenter=segmenter,
        device=device, force=force,
    )  # fmt: skip
    tracker = Tracker(
        recording, first.mesh, config, cloud, start=first.positions, assemble=assemble,
        device=device,
    )  # fmt: skip
    if parts:
        tracker.method = replace(tracker.method, **parts)
    replaced = [*parts, *(["segmenter"] if segmenter else []), *(["method"] if assemble else [])]
    if replaced:
        stamp["replaced_parts"] = sorted(replaced)
    tracked = tracker.track(progress, watch)
    stamp |= {
        "initial_state": dict(first.origin),
        "first_mesh_gap_m": gap_m,
        "cpu_s": round(time.process_time() - clock, 2),
    }
    tracked = replace(tracked, config=asdict(config), provenance=stamp)
    if judge is None:
        return tracked
    # The verdict uses the recording with the default segmentation and cloud spacing.
    as_usual = segmenter is None and config.cloud_spacing_m == SPACING_M
    frames = ObservedFrames(recording, cloud if as_usual else None)
    verdict = judge(tracked, recording, segmenter=segmenter, device=device, frames=frames)
    return replace(tracked, verdict_fields=verdict)


def checked_initial_state(
    recording: Recording,
    observation: Observation,
    config: InitialStateConfig,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
    force: bool = False,
) -> tuple[InitialState, float | None]:
    """Return the cloth that tracking starts from, and its distance from its cloud (rms) [m]."""
    first = find_initial_state(recording, observation, config, segmenter=segmenter, device=device)
    gap_m = _first_gap_m(first, observation, device)
    if not force and gap_m is not None and gap_m > LARGEST_GAP_M:
        raise _far_first_mesh(recording, first, gap_m)
    return first, gap_m


def _refuse_wrong_units(recording: Recording) -> None:
    """Reject times that are not in seconds, and depths that are not in the stated unit.

    Simulating a minute per frame would take hours, and so would the points of a cloth of 4 m.
    """
    for finding in check_geometry(recording, checks=UNIT_CHECKS):
        if finding.unit != "m/s":  # A tip that is too fast or too slow takes no longer.
            raise InvalidRecordingError(
                f"{recording.folder}: stopped, {finding.text}; --force tracks it as it is"
            )


def _refuse_held_gaps(recording: Recording) -> None:
    """Reject an action with held cloth that was not seen for long: simulating a day takes days."""
    for number, action in enumerate(recording.actions):
        times = [one.time_s for one in recording.frames[action.first_frame : action.last_frame + 1]]
        for frame, (before, after) in enumerate(pairwise(times), start=action.first_frame):
            if after - before <= _LONGEST_HELD_GAP_S or not (name := held_over(recording, frame)):
                continue
            raise InvalidRecordingError(
                f"{recording.folder}: stopped, picker {name!r} holds the cloth for "
                f"{after - before:.6g} s without a frame between frames {frame} and {frame + 1} of "
                f"action {number + 1} (at most {_LONGEST_HELD_GAP_S:g}): "
                f"{gap_remedy(after - before - float(np.median(np.diff(times))), held=True)}"
            )


def _first_gap_m(first: InitialState, observation: Observation, device: str) -> float | None:
    """Return the distance of the first mesh from its cloud (rms) [m]; None if unknown."""
    vertices = first.mesh.vertices if first.positions is None else first.positions
    return mesh_gap_m(vertices, first.mesh.faces, observation, device=device)


def _far_first_mesh(
    recording: Recording, first: InitialState, gap_m: float
) -> InvalidRecordingError:
    """Return the error for a first mesh far from its cloud, with distance and likely cause."""
    causes = check_geometry(recording)
    cause = causes[0].text if causes else "is its kind, its size or the mask another"
    return InvalidRecordingError(
        f"{recording.folder}: stopped, the first mesh ({first.origin['source']}) lies "
        f"{1e3 * gap_m:.0f} mm (rms) from the cloud of frame 0 (at most "
        f"{1e3 * LARGEST_GAP_M:.0f}): {cause}; --force tracks it all the same"
    )


def track_recordings(
    recordings: Sequence[Path],
    output: Path,
    config: RunConfig,
    *,
    workers: int = 1,
    device: str = "cpu",
    progress: Progress | None = None,
    force: bool = True,
    watch: Watch | None = None,
    judge: Judge | None = None,
    ray: str = "",
) -> list[Outcome]:
    """Track many recordings; skip finished ones, and continue after an error in one of them.

    A finished recording that has changed since is tracked again.
    """
    require_workers(workers)
    if watch is not None and workers > 1:
        raise InvalidConfigError(
            f"workers is {workers}; one recording after the other can be watched: --workers 1"
        )
    if watch is not None and ray:
        raise InvalidConfigError("only what this process tracks can be watched; leave out --ray")
    folders = [Path(folder) for folder in recordings]
    names = [folder.resolve().name for folder in folders]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InvalidConfigError(
            f"two recordings are called {min(twice)!r}, their results would overwrite each "
            "other; rename one folder"
        )
    for name in names:
        if problem := name_problem(name):
            raise InvalidConfigError(
                f"a recording is called {name!r}, and no result can be named after it ({problem}); "
                "rename the folder"
            )
    alone = not ray and (workers == 1 or len(folders) == 1)
    work = _Tracking(
        output, config, device, force, judge, *((progress, watch, folders) if alone else ())
    )
    tracked = attempts(
        work, folders, kind="recordings", workers=workers, ray=ray, device=device,
        progress=None if alone else progress,
    )  # fmt: skip
    with locked_output(output), closing(tracked) as tries:
        outcomes = {one.item: _outcome(one) for one in tries}
    return [outcomes[folder] for folder in folders]


def _outcome(attempt: Attempt[Path, Outcome]) -> Outcome:
    if attempt.result is not None:
        return attempt.result
    folder, error = attempt.item, str(attempt.error)
    return Outcome(folder, None, error=error if str(folder) in error else f"{folder}: {error}")


@dataclass(frozen=True)
class _Tracking:
    """Tracking of a folder, as `clothtrack.files.many_items.Work`.

    It reports progress itself if everything is tracked in one process.
    """

    output: Path
    config: RunConfig
    device: str
    force: bool
    judge: Judge | None
    progress: Progress | None = None
    watch: Watch | None = None
    folders: Sequence[Path] = ()

    def name(self, folder: Path) -> str:
        """Return the name of the recording and of its result."""
        return folder.resolve().name

    def paths(self, folder: Path) -> list[Path]:
        """Return the path of the tracked trajectory."""
        return [result_path(folder, self.output)]

    def kept(self, folder: Path) -> Outcome | None:
        """Return an earlier outcome from the same files with the same settings, or None."""
        path = result_path(folder, self.output)
        earlier = self._earlier(path)
        if earlier is None or earlier.get(DIGEST_FIELD) != recording_digest(read_recording(folder)):
            return None
        logger.info("%s: finished before, skipped", path)
        return Outcome(folder, path, skipped=True)

    def do(self, folder: Path) -> Outcome:
        """Track the recording."""
        path = result_path(folder, self.output)
        again = self._earlier(path) is not None
        progress = self.progress
        if self.folders:
            progress = one_of(progress, self.folders.index(folder), len(self.folders))
        tracked = track_recording(
            read_recording(folder), self.config, device=self.device, progress=progress,
            force=self.force, watch=self.watch, judge=self.judge,
        )  # fmt: skip
        tracked.save(path)
        return Outcome(folder, path, tracked_again=again)

    def _earlier(self, path: Path) -> Mapping[str, Any] | None:
        """Return the provenance of an earlier result; reject one with other settings."""
        if not path.exists():
            return None
        earlier = TrackedTrajectory.load(path).provenance
        _refuse_other_settings(path, earlier, self.config)
        return earlier


def result_path(recording: Path, output: Path) -> Path:
    """Return the path of a recording's tracked trajectory."""
    return output / f"{recording.resolve().name}.zarr"


def _refuse_other_settings(path: Path, earlier: Mapping[str, Any], config: RunConfig) -> None:
    earlier_hash = earlier.get("config_hash")
    if earlier_hash != config_hash(config):
        raise InvalidConfigError(
            f"{path} was tracked with other settings or by another version (hash {earlier_hash}, "
            f"now {config_hash(config)}); choose another --output, or remove it and track again"
        )


def config_hash(config: RunConfig) -> str:
    """Return ten hexadecimal digits that change with any setting."""
    text = json.dumps(counted_settings(config), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def counted_settings(config: RunConfig) -> dict[str, Any]:
    """Return the settings that identify a stored result; files count by their content."""
    settings = asdict(config)
    first = settings["initial_state"]
    for name in ("weights", "template"):
        if first[name]:
            with suppress(StorageError):
                first[name] = content_hash(Path(first[name]))
    return settings


def provenance(recording: Recording, config: RunConfig, device: str) -> dict[str, object]:
    """Return what is needed to reproduce a result: versions, commit, seed, device, source."""
    packages = ("numpy", "scipy", "warp-lang", "opencv-python-headless", "zarr")
    return {
        **made_with(packages),
        "device": device,
        "seed": config.seed,
        "config_hash": config_hash(config),
        "recording": dict(recording.provenance),
        DIGEST_FIELD: recording_digest(recording),
    }
