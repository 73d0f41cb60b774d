"""Live tracking of the cloth seen by a ROS 2 camera: the verb `live-ros2`."""

from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clothtrack.api.options import Mode, Settings, configured_by
from clothtrack.api.results import Result
from clothtrack.api.tracking import tracking_config
from clothtrack.errors import InvalidConfigError

if TYPE_CHECKING:
    import numpy as np

    from clothtrack.live.live_state import LiveState
    from clothtrack.recordings.recording import ClothDescription, Table
    from clothtrack_capture.ros2.source_config import Ros2SourceConfig

Kind = Literal["towel", "tshirt", "trousers", "other"]


@configured_by(tracking_config)
def live_ros2(
    output: Path | str,
    *,
    kind: Kind = "other",
    cloth_color: str = "",
    depth: str = "/camera/aligned_depth_to_color/image_raw",
    color: str = "/camera/color/image_raw",
    camera_info: str = "/camera/color/camera_info",
    world_frame: str = "",
    pose: str = "",
    tool_frame: str = "",
    gripper: str = "",
    closed_below: float | None = None,
    seconds: float | None = None,
    mode: Mode = "default",
    template: Path | str | None = None,
    weights: Path | str | None = None,
    settings: Settings = (),
    device: str = "cpu",
    opened: "Callable[[str], None] | None" = None,
    cloth: "ClothDescription | None" = None,
    world_from_camera: "np.ndarray | None" = None,
    table: "Table | None" = None,
    config: "Ros2SourceConfig | None" = None,
) -> Result:
    """Track the cloth seen by a ROS 2 camera and publish its mesh, until depth ends or Ctrl-C.

    The mesh goes to /clothtrack/mesh and /clothtrack/vertices at the rate of the pictures, and to a
    page on this machine. An action begins when the gripper closes and ends when it has opened.

    Args:
        output: trajectory to write at the end (NAME.zarr); must not exist.
        kind: kind of cloth; its first mesh is fitted to the first picture.
        cloth_color: named color of the cloth, such as blue; by default everything on the table is
            cloth.
        depth: topic of depth, registered to color.
        color: topic of color; empty for depth alone.
        camera_info: topic of the pictures' intrinsics.
        world_frame: TF frame of the world, with z up; required with a tool. By default the table in
            the first picture defines the world.
        pose: topic of the tool tip's pose, in the world.
        tool_frame: TF frame of the tool's tip, instead of a topic.
        gripper: topic of the gripper.
        closed_below: value of the gripper, or sum of its joints, below which it is closed.
        seconds: end after this many seconds of pictures.
        mode: our default, the paper's method, or its dynamics alone.
        template: mesh of this garment (`clothtrack garment`), fitted to the flat cloth in the first
            picture.
        weights: weights of the network that makes the first mesh.
        settings: changes to the mode, such as color=false.
        device: device to compute on: cpu, or cuda:0.
        opened: function called with the address of the page; without it there is no page.
        cloth: everything known about the cloth, instead of `kind` and `cloth_color`.
        world_from_camera: camera pose, instead of TF.
        table: plane that the cloth lies on; found in the first picture by default.
        config: settings for reading and joining messages.

    Raises:
        InvalidConfigError: an argument is wrong, the result exists already, or the extra [ros2] is
            not installed.
        InvalidRecordingError: a topic is silent, or the first picture cannot be used.
        StorageError: the disk refuses.
    """
    from dataclasses import replace

    from clothtrack.api.live import LiveTracker
    from clothtrack.live.live_stream import LiveStream
    from clothtrack.live.playback import Latencies
    from clothtrack.recordings.recording import ClothDescription
    from clothtrack.report.live_tracking import live_tracking
    from clothtrack_capture.ros2 import Ros2Sink, Ros2Source, Ros2SourceConfig, Ros2Topics

    path = Path(output)
    if path.exists():
        raise InvalidConfigError(f"{path} is there already; remove it, or name another output")
    if (pose or tool_frame) and not world_frame and world_from_camera is None:
        raise InvalidConfigError(
            f"the tool is at {pose or tool_frame}, in a world that the camera must be placed in: "
            "give --world-frame, the TF frame that is the world"
        )
    topics = Ros2Topics(
        depth, color or None, camera_info, pose=pose or None, tool_frame=tool_frame or None,
        gripper=gripper or None, world_frame=world_frame or None,
    )  # fmt: skip
    joined = config or Ros2SourceConfig()
    if closed_below is not None:
        joined = replace(joined, closed_below=closed_below)
    described = cloth or ClothDescription(kind, cloth_color or None)
    latencies, words, newest = Latencies(), ["waiting for the first picture"], [-1]
    page = live_tracking(lambda: words[0], None, opened=opened) if opened else nullcontext()
    with (
        page as shown,
        Ros2Sink(frame_id=world_frame or "world") as sink,
        Ros2Source(topics, world_from_camera=world_from_camera, config=joined) as source,
    ):
        tracker = LiveTracker(
            described, source.camera, table=table or "find", device=device, name=path.stem,
            config=tracking_config(mode, template, weights, settings),
            watch=None if shown is None else shown.watch,
        )  # fmt: skip

        def served(state: "LiveState") -> None:
            stalled = f"; nothing from {' and '.join(state.stalled)}" if state.stalled else ""
            latencies.add(state)
            said = "".join(f"; {note}" for note in state.notes)
            words[0] = f"at {state.time_s:.1f} s: latency {latencies.text()}{stalled}{said}"
            if state.frame == newest[0] or tracker.mesh is None:
                return
            newest[0] = state.frame
            sink.publish(
                source.stamp_ns(state.time_s), state.positions, tracker.mesh.faces,
                state.expected_error_m, state.visible,
            )  # fmt: skip

        with LiveStream(tracker, served) as stream, suppress(KeyboardInterrupt):
            for picture in source:
                if seconds is not None and picture.time_s > seconds:
                    break
                stream.put(**vars(picture))
                if newest[0] < 0:
                    stream.wait()  # the first mesh takes longer than any later one
        run = tracker.close()
        run.save(path)
        text = f"latency  {latencies.text()}\ntracked  {path}\nverdict  {run.verdict}"
        if shown:
            shown.end(text)
    report = {"result": path, "latency": latencies.as_dict(), "verdict": run.verdict.as_dict()}
    return Result(text, report)
