"""Changes to an existing recording that keep it valid even when they are interrupted.

Each new file is written next to the old one and then renamed over it. `recording.json` is written
last because it names the other files. Everything that a change does not concern stays as it was,
including remarks.
"""

import copy
from collections.abc import Callable, Mapping
from json import dumps
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from clothtrack.errors import InvalidRecordingError
from clothtrack.files.atomic_write import atomic_folder, storage, write_file
from clothtrack.recordings.frame_files import PICTURE_KINDS
from clothtrack.recordings.picker_table import PICKER_FILE, picker_text
from clothtrack.recordings.pictures import encode_png
from clothtrack.recordings.recording import Frame, PickAndPlace, PickerPath, Recording
from clothtrack.recordings.recording_file import document_violations, load_document
from clothtrack.recordings.violation import DOCUMENT

Change = Callable[[dict[str, Any]], None]


def amend_document(folder: Path, change: Change) -> None:
    """Change the content of `recording.json`, replacing the file completely or not at all.

    Args:
        folder: folder of the recording.
        change: function that changes the content in place.

    Raises:
        InvalidRecordingError: the content cannot be read, or the change would break the format's
            rules.
        StorageError: the disk refuses.
    """
    document, violations = load_document(folder)
    if document is None:
        raise InvalidRecordingError(f"{folder}: {violations[0].message}")
    changed = copy.deepcopy(document)
    change(changed)
    broken = document_violations(changed)
    if broken:
        raise InvalidRecordingError(f"{folder}: the change is refused: {broken[0].message}")
    text = dumps(changed, indent=1, ensure_ascii=False, allow_nan=False)
    write_file(folder / DOCUMENT, text.encode())


def set_actions(
    recording: Recording,
    paths: Mapping[str, PickerPath],
    actions: tuple[PickAndPlace, ...],
    *,
    provenance: Mapping[str, object],
) -> None:
    """Replace the pickers' paths and the actions of a recording.

    The old actions are removed first, so the recording never combines old actions with new paths.

    Args:
        recording: recording to change.
        paths: path per picker name; they replace all existing paths.
        actions: actions in order.
        provenance: provenance entries to add.

    Raises:
        InvalidRecordingError: the change would break the format's rules.
        StorageError: the disk refuses.
    """

    def without_actions(document: dict[str, Any]) -> None:
        document.pop("actions", None)
        # The held vertices and the grasp uncertainty describe the old paths.
        for field in ("held_vertices", "grasp_uncertainty_m"):
            document.get("cloth", {}).pop(field, None)

    def with_actions(document: dict[str, Any]) -> None:
        document["actions"] = [
            {
                "first_frame": action.first_frame,
                "last_frame": action.last_frame,
                "pickers": list(action.pickers),
            }
            for action in actions
        ]
        document.setdefault("provenance", {}).update(provenance)

    amend_document(recording.folder, without_actions)
    write_file(recording.folder / PICKER_FILE, picker_text(paths).encode())
    amend_document(recording.folder, with_actions)


def set_masks(
    recording: Recording,
    camera: str,
    mask_of: Callable[[Frame], Bool[np.ndarray, "height width"] | None],
    *,
    color: str | None = None,
    provenance: Mapping[str, object],
) -> int:
    """Write masks for one camera, replacing existing ones.

    Args:
        recording: recording to change.
        camera: name of the camera that the masks belong to.
        mask_of: function that returns the cloth mask of a frame; None or empty where there is none.
        color: name of the cloth's color to store, if any.
        provenance: provenance entries to add.

    Returns:
        The number of masks written.

    Raises:
        InvalidRecordingError: the change would break the format's rules.
        StorageError: the disk refuses.
    """
    folder, name = recording.folder, _free_name(recording.folder)
    single = len(recording.cameras) == 1
    files: dict[int, str] = {}
    with atomic_folder(folder / name) as unfinished:
        (unfinished if single else unfinished / camera).mkdir(exist_ok=True)
        for frame in recording.frames:
            mask = mask_of(frame)
            if mask is not None and mask.any():
                file = f"{frame.index:06d}.png" if single else f"{camera}/{frame.index:06d}.png"
                (unfinished / file).write_bytes(encode_png(mask.astype(np.uint8) * 255))
                files[frame.index] = f"{name}/{file}"

    def name_masks(document: dict[str, Any]) -> None:
        for frame, entry in zip(recording.frames, document["frames"], strict=True):
            _name_files(entry, frame, folder, single=single)
            masks = entry.pop("mask", {})
            masks = {} if isinstance(masks, str) else {**masks}
            masks.pop(camera, None)
            if frame.index in files:
                masks[camera] = files[frame.index]
            if masks:
                entry["mask"] = masks[camera] if single else masks
        if color is not None:
            document.setdefault("cloth", {})["color"] = color
        document.setdefault("provenance", {}).update(provenance)

    amend_document(folder, name_masks)
    replaced = {frame.mask[camera].parent for frame in recording.frames if camera in frame.mask}
    for old in replaced - {folder}:
        _remove_pictures(old, [frame.mask.get(camera) for frame in recording.frames])
    return len(files)


def _name_files(entry: dict[str, Any], frame: Frame, folder: Path, *, single: bool) -> None:
    """List a frame's files explicitly if it relied on their conventional names."""
    if entry.keys() & {*PICTURE_KINDS, "cloud"}:
        return
    for kind in PICTURE_KINDS:
        files = {
            camera: path.relative_to(folder).as_posix()
            for camera, path in getattr(frame, kind).items()
        }
        if files:
            entry[kind] = next(iter(files.values())) if single else files
    if frame.cloud is not None:
        entry["cloud"] = frame.cloud.relative_to(folder).as_posix()


def _free_name(folder: Path) -> str:
    """Return an unused name for a folder of masks."""
    names = (f"mask{number}" for number in range(2, 1_000_000))
    return "mask" if not (folder / "mask").exists() else next(
        name for name in names if not (folder / name).exists()
    )  # fmt: skip


def _remove_pictures(folder: Path, paths: list[Path | None]) -> None:
    """Remove pictures that are no longer referenced, and their folder if it is then empty."""
    with storage(folder):
        for path in paths:
            if path is not None and path.parent == folder:
                path.unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()
