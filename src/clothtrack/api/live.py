"""Live tracking of the whole cloth, from a driver's pictures or from a played recording."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from clothtrack.api.run import Run, run_config
from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.verdict import judged
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.devices import quiet_warp, require_device
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.live import live_tracker
from clothtrack.recordings.recording import ClothDescription, Recording, Table
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.protocols import Watch


class LiveTracker(live_tracker.LiveTracker):
    """A tracker of one moving cloth: the full mesh, hidden layers included, at every picture.

    Call `update` with every picture, in order. An action begins with the first picture in which a
    picker is closed and ends 0.2 s after all have opened; between actions the mesh rests. Without a
    gripper, call `begin_action` and `end_action` instead. Candidates are not searched; the settings
    of the search have no effect. If no picture is missing, the result for a recording is that of
    `track` with `search.method=none`. `close` returns a `Run`.
    """

    def __init__(
        self,
        cloth: ClothDescription | ClothMesh | str,
        camera: Camera,
        *,
        table: Table | Literal["find"] | None = None,
        mode: str = "default",
        settings: Sequence[str] = (),
        config: RunConfig | None = None,
        segmenter: Segmenter | None = None,
        device: str = "cpu",
        watch: Watch | None = None,
        name: str = "live",
        keep_pictures: bool = False,
        force: bool = False,
    ) -> None:
        """Load and warm up everything that the first picture needs; this takes a second or two.

        Args:
            cloth: its template in the world [m], its kind, or its full description. Its color, a
                mask with each picture, the table or a segmenter distinguishes it from the rest.
            camera: intrinsics, and the pose in the world.
            table: the plane that the cloth lies on, or None when it hangs. "find": the plane of
                most of the first picture outside the cloth; a camera without a pose (the identity)
                then defines the world, too: z up, the table at z = 0, and `camera` has its pose.
            mode: one of `MODES`.
            settings: changes to the configuration, such as "color=false".
            config: the whole configuration, in place of a mode.
            segmenter: finds the cloth in a picture.
            device: "cpu" or "cuda:0".
            watch: called with each mesh: the recording so far, the flat mesh, the frame and the
                vertices [m].
            name: name of the run.
            keep_pictures: keep all pictures in memory, some 60 MB per second, instead of only those
                where actions begin and end.
            force: track although the first mesh lies more than 2 cm (rms) from its cloud.

        Raises:
            InvalidConfigError: unknown mode, setting or device; or both a config and a mode.
        """
        quiet_warp()
        require_device(device)
        if config is not None and (mode != "default" or settings):
            raise InvalidConfigError(
                f"both a config and mode={mode!r} or settings were given; leave one out"
            )
        super().__init__(
            _described(cloth), camera, table=table, config=config or run_config(mode, settings),
            segmenter=segmenter, device=device, watch=watch, name=name,
            keep_pictures=keep_pictures, force=force,
        )  # fmt: skip

    def close(self, recording: Recording | None = None) -> Run:
        """End an action in progress, and return the run with its verdict.

        Args:
            recording: the recording that was played, frame by frame, if any; by default, the
                pictures received.

        Raises:
            InvalidConfigError: there was no picture.
        """
        tracked, source = self.tracked(recording, judge=judged)
        return replace(Run.of(tracked, source), segmenter=self.segmenter)


def _described(cloth: ClothDescription | ClothMesh | str) -> ClothDescription:
    if isinstance(cloth, ClothMesh):
        return ClothDescription(template=cloth)
    return ClothDescription(cloth) if isinstance(cloth, str) else cloth
