"""The whole cloth while it moves: from a driver's pictures, or from a recording that is played."""

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
    """Tracks one cloth while it moves: the full mesh, hidden layers included, at every picture.

    Call `update` with every picture, in order. An action begins with the first picture in which a
    picker is closed and ends 0.2 s after all have opened; between actions the mesh rests.
    `begin_action` and `end_action` say it instead, where no gripper does. Candidates are searched
    beside the stream (`settings=["search.method=none"]`: never); where no picture is missing, what
    comes of a recording is what `track` makes of it. `close` waits for the searches, and gives a
    `Run`.
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
        """Load and warm everything that the first picture needs; a second or two.

        Args:
            cloth: its template in the world [m], its kind, or all that is known of it. Its color, a
                mask with each picture, the table or a segmenter tell it from the rest.
            camera: intrinsics, and the pose in the world.
            table: the plane that the cloth lies on, or None when it hangs. "find": what most of the
                first picture that is not cloth lies on; a camera without a pose (the identity) then
                gives the world, too: z up, the table at z = 0, and `camera` has its pose.
            mode: one of `MODES`.
            settings: changes to the configuration, such as "color=false".
            config: the whole configuration, in place of a mode.
            segmenter: finds the cloth in a picture.
            device: "cpu" or "cuda:0".
            watch: called with each mesh: the recording so far, the flat mesh, the frame and the
                vertices [m].
            name: of what is tracked.
            keep_pictures: keep all of them in memory, some 60 MB a second, and not only those where
                actions begin and end.
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
        """End an action that is under way, and return what was tracked, with its verdict.

        Args:
            recording: what was played, frame by frame, where it was one; what was seen by default.

        Raises:
            InvalidConfigError: there was no picture.
        """
        tracked, source = self.tracked(recording, judge=judged)
        return replace(Run.of(tracked, source), segmenter=self.segmenter)


def _described(cloth: ClothDescription | ClothMesh | str) -> ClothDescription:
    if isinstance(cloth, ClothMesh):
        return ClothDescription(template=cloth)
    return ClothDescription(cloth) if isinstance(cloth, str) else cloth
