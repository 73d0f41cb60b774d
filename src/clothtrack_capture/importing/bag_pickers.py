"""The picker's path in a bag: from a pose topic or a TF frame, and a gripper topic."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from clothtrack.errors import InvalidConfigError
from clothtrack.recordings.recording import PickerPath
from clothtrack_capture.importing.bag_walk import Walk
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.messages import grip_of, gripper_joints
from clothtrack_capture.importing.topics import topic_list

PICKER = "picker"
_CLOCKS_DIFFER_NS = 10**9
_LONGEST_UNKNOWN_NS = 500_000_000


@dataclass(frozen=True)
class BagPaths:
    """The picker's path in a frame ("world", "camera" or another); times [s] from `start_ns`."""

    paths: Mapping[str, PickerPath] = field(default_factory=dict)
    start_ns: int = 0
    frame: str = ""
    origins: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()


def bag_paths(path: Path, walk: Walk, options: ImportOptions, camera_frame: str) -> BagPaths:
    """Return the requested picker path, if any."""
    if options.picker_topic is None and options.picker_frame is None:
        if options.gripper_topic is not None:
            raise InvalidConfigError(
                "--gripper-topic tells when, but not where: add --picker-topic or --picker-frame"
            )
        return BagPaths()
    world = options.world_frame
    target, frame = (world, "world") if world else (camera_frame, "camera")
    origins, notes = {}, list[str]()
    if options.picker_topic is not None:
        origins["picker"] = options.picker_topic
        times, positions, frame = _from_topic(path, walk, options.picker_topic, target, frame)
    else:
        assert options.picker_frame is not None
        origins["picker"] = f"TF frame {options.picker_frame}"
        if not target or not walk.tree.connects(target, options.picker_frame):
            raise InvalidConfigError(
                f"{path}: no TF ties --picker-frame {options.picker_frame!r} to {target!r}; "
                f"frames: {', '.join(walk.tree.frames) or 'none'}; name one of them"
            )
        times = walk.tree.moments(target, options.picker_frame)
        positions = walk.tree.lookup(target, options.picker_frame, times)[:, :3, 3]
    keep = np.diff(times, prepend=times[:1] - 1) > 0
    times, positions = times[keep], positions[keep]
    if len(times) < 2:
        raise InvalidConfigError(
            f"{path}: {origins['picker']} tells {len(times)} positions; a path has at least two"
        )
    closed = np.zeros(len(times), dtype=bool)
    if options.gripper_topic is not None:
        origins["gripper"] = options.gripper_topic
        closed, notes = _closed(path, walk, options, times)
    if walk.without_position:
        notes.append(f"{walk.without_position} poses of {options.picker_topic} are not numbers "
                     "and were left out")  # fmt: skip
    start_ns = int(times[0])
    paths = {PICKER: PickerPath((times - start_ns) / 1e9, positions, closed)}
    return BagPaths(paths, start_ns, frame, origins, notes)


def _from_topic(
    path: Path, walk: Walk, topic: str, target: str, frame: str
) -> tuple[Int64[np.ndarray, " times"], Float[np.ndarray, "times 3"], str]:
    if not walk.poses:
        raise InvalidConfigError(
            f"{path}: no position in topic {topic!r}; topics: {topic_list(walk.topics)}; name one "
            "of PoseStamped, PointStamped, TransformStamped or Odometry with --picker-topic"
        )
    poses = sorted(walk.poses, key=lambda pose: pose[0])
    times, positions = np.array([pose[0] for pose in poses]), np.array([pose[2] for pose in poses])
    origin = poses[0][1]
    for time_ns, other, _ in poses:
        if other != origin:
            raise InvalidConfigError(
                f"{path}: --picker-topic {topic!r} tells positions in frame {origin!r} and, from "
                f"{time_ns / 1e9:.3f} s on, in {other!r}; give --picker-frame with the tool's frame"
            )
    if not (target and origin and walk.tree.connects(target, origin)):
        # No TF ties its frame to the camera's: the user must say whether it is the world.
        return times, positions, "camera" if origin and origin == target else repr(origin)
    known = walk.tree.moments(target, origin)
    unknown_ns = max(known[0] - times[0], times[-1] - known[-1]) if len(known) > 1 else 0
    if unknown_ns > _LONGEST_UNKNOWN_NS:
        raise InvalidConfigError(
            f"{path}: TF from {origin!r} to {target!r} is known from {known[0] / 1e9:.3f} to "
            f"{known[-1] / 1e9:.3f} s, the positions from {times[0] / 1e9:.3f} to "
            f"{times[-1] / 1e9:.3f} s; record /tf as long as {topic}"
        )
    poses_at = walk.tree.lookup(target, origin, times)
    moved = np.einsum("tij,tj->ti", poses_at[:, :3, :3], positions) + poses_at[:, :3, 3]
    return times, moved, frame


def _closed(
    path: Path, walk: Walk, options: ImportOptions, times: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    if not walk.grips:
        raise InvalidConfigError(
            f"{path}: no message in --gripper-topic {options.gripper_topic!r}; topics: "
            f"{topic_list(walk.topics)}"
        )
    unstamped = not hasattr(walk.grips[0][1], "header")
    gap = walk.clock_gap_ns if unstamped and abs(walk.clock_gap_ns) > _CLOCKS_DIFFER_NS else 0
    # Several nodes may publish on one topic of joints; those without the gripper's are passed over.
    told = [(time, grip) for time, message in walk.grips
            if (grip := grip_of(message, options.gripper_joints)) is not None]  # fmt: skip
    joints = _joints(path, walk, options, found=bool(told))
    closed = sorted((time - gap, _is_closed(path, grip, options)) for time, grip in told)
    when, what = (np.array(column) for column in zip(*closed, strict=True))
    # Before the first message, assume the state that this message reports.
    last = np.clip(np.searchsorted(when, times, side="right") - 1, 0, None)
    notes = [f"the gripper's joints in {options.gripper_topic}: {joints}"] if joints else []
    if gap:
        notes.append(
            f"{options.gripper_topic} has no time stamps of its own; its times of writing were "
            f"moved by {-gap / 1e9:.3f} s to the clock of the pictures"
        )
    if what.all() or not what.any():
        values, limit = [grip for _, grip in told], options.gripper_closed_below
        limits = "" if limit is None else f", --gripper-closed-below is {limit:g}"
        notes.append(
            f"the gripper is {'closed' if what.all() else 'open'} all the time: its values are "
            f"{float(min(values)):g} to {float(max(values)):g}{limits}"
        )
    return what[last], notes


def _joints(path: Path, walk: Walk, options: ImportOptions, *, found: bool) -> str:
    """Return the joints that were taken from a JointState with others, as text."""
    every = {name: None for _, message in walk.grips for name in getattr(message, "name", ())}
    chosen = gripper_joints(list(every), options.gripper_joints)
    if found:
        return ", ".join(chosen) if len(chosen) < len(every) else ""
    problem = "tells no number; name a topic of Bool, Float or JointState"
    if every:
        which = "no name tells which are the gripper's"
        if options.gripper_joints:
            which = f"none is called {', '.join(options.gripper_joints)}"
        problem = f"has the joints {', '.join(every)}, and {which}; name them with --gripper-joints"
    raise InvalidConfigError(f"{path}: --gripper-topic {options.gripper_topic!r} {problem}")


def _is_closed(path: Path, told: bool | float, options: ImportOptions) -> bool:
    if isinstance(told, bool):
        return told
    if options.gripper_closed_below is None:
        raise InvalidConfigError(
            f"{path}: --gripper-topic {options.gripper_topic!r} tells numbers, not closed or open; "
            "say below which value the gripper is closed: --gripper-closed-below"
        )
    return told < options.gripper_closed_below
