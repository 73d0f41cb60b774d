"""Recordings of camera and picker: the format, its reader, segmentation and point clouds."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.recordings.colors import ColorRange
    from clothtrack.recordings.identity import recording_digest
    from clothtrack.recordings.inspection import Inspection, inspect
    from clothtrack.recordings.mesh_file import read_mesh, write_mesh
    from clothtrack.recordings.pictures import (
        encode_png,
        read_cloud,
        read_color,
        read_depth,
        read_mask,
    )
    from clothtrack.recordings.point_cloud import Observation, observe, thin
    from clothtrack.recordings.recording import (
        ClothDescription,
        Frame,
        ObservedRegion,
        PickAndPlace,
        PickerPath,
        Recording,
        Table,
    )
    from clothtrack.recordings.segmentation import (
        ColorSegmenter,
        HeightSegmenter,
        MaskFolder,
        Segmenter,
    )
    from clothtrack.recordings.shipped import shipped_recording
    from clothtrack.recordings.store import RecordingWriter, read_recording, write_recording
    from clothtrack.recordings.template_file import read_obj
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "ClothDescription",
    "ColorRange",
    "ColorSegmenter",
    "Frame",
    "HeightSegmenter",
    "Inspection",
    "MaskFolder",
    "Observation",
    "ObservedRegion",
    "PickAndPlace",
    "PickerPath",
    "Recording",
    "RecordingWriter",
    "Segmenter",
    "Table",
    "encode_png",
    "inspect",
    "observe",
    "read_cloud",
    "read_color",
    "read_depth",
    "read_mask",
    "read_mesh",
    "read_obj",
    "read_recording",
    "recording_digest",
    "shipped_recording",
    "thin",
    "write_mesh",
    "write_recording",
]
