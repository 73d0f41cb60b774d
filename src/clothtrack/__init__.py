"""Know where every point of a crumpled cloth is, from one depth camera.

    import clothtrack as ct

    run = ct.track("my_recording")
    run.positions  # [m], (frames, vertices, 3)
    run.save("out/my_recording.zarr")

These names are the public interface. Everything else in the subpackages may change.
"""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names
from clothtrack.version import __version__

if TYPE_CHECKING:
    from clothtrack.api.garment import garment_template
    from clothtrack.api.inspection import inspect_many
    from clothtrack.api.learning import finetune, label, pretrain, reconstruct
    from clothtrack.api.live import LiveTracker
    from clothtrack.api.look import export, view, write_report
    from clothtrack.api.many import evaluate_many, label_many
    from clothtrack.api.play import play_live
    from clothtrack.api.run import Label, Run, evaluate, load, track
    from clothtrack.api.tracking import demo, track_many
    from clothtrack.api.verification import Verification, verify
    from clothtrack.errors import (
        ClothTrackError,
        InvalidConfigError,
        InvalidMeshError,
        InvalidRecordingError,
        InvalidResultError,
        SimulationDivergedError,
        StorageError,
    )
    from clothtrack.evaluation.label_quality import judge_labels
    from clothtrack.evaluation.truth import Truth
    from clothtrack.files.settings import with_settings
    from clothtrack.geometry.camera import Camera
    from clothtrack.geometry.mesh import ClothMesh
    from clothtrack.live.live_state import LiveState
    from clothtrack.live.live_stream import LiveStream
    from clothtrack.recordings.inspection import inspect as inspect_recording
    from clothtrack.recordings.pictures import read_color, read_depth
    from clothtrack.recordings.point_cloud import observe
    from clothtrack.recordings.recording import ClothDescription, PickerPath, Recording, Table
    from clothtrack.recordings.segmentation import ColorSegmenter
    from clothtrack.recordings.shipped import shipped_recording
    from clothtrack.recordings.store import RecordingWriter, read_recording
    from clothtrack.tracking.configuration import MODES, RunConfig, mode
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "MODES",
    "Camera",
    "ClothDescription",
    "ClothMesh",
    "ClothTrackError",
    "ColorSegmenter",
    "InvalidConfigError",
    "InvalidMeshError",
    "InvalidRecordingError",
    "InvalidResultError",
    "Label",
    "LiveState",
    "LiveStream",
    "LiveTracker",
    "PickerPath",
    "Recording",
    "RecordingWriter",
    "Run",
    "RunConfig",
    "SimulationDivergedError",
    "StorageError",
    "Table",
    "Truth",
    "Verification",
    "__version__",
    "demo",
    "evaluate",
    "evaluate_many",
    "export",
    "finetune",
    "garment_template",
    "inspect_many",
    "inspect_recording",
    "judge_labels",
    "label",
    "label_many",
    "load",
    "mode",
    "observe",
    "play_live",
    "pretrain",
    "read_color",
    "read_depth",
    "read_recording",
    "reconstruct",
    "shipped_recording",
    "track",
    "track_many",
    "verify",
    "view",
    "with_settings",
    "write_report",
]
