"""Changes to an existing recording that keep it valid even when they are interrupted.

Each returns the changed recording. One in memory is not written. In a folder, each new file is
written next to the old one and then renamed over it. `recording.json` is written last because it
names the other files. Everything that a change does not concern stays as it was, including remarks.
"""

import copy
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from json import dumps
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from clothtrack.api.results import Result
from clothtrack.errors import InvalidRecordingError
from clothtrack.files.atomic_write import atomic_folder, storage, write_file
from clothtrack.recordings.frame_files import PICTURE_KINDS
from clothtrack.recordings.picker_table import PICKER_FILE, picker_text
from clothtrack.recordings.pictures import encode_png
from clothtrack.recordings.recording import Frame, PickAndPlace, PickerPath, Recording
from clothtrack.recordings.recording_file import document_violations, load_document
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.violation import DOCUMENT

logger = logging.getLogger(__name__)

Change = Callable[[dict[str, Any]], None]


def opened_recording(given: Recording | Path | str) -> Recording:
    """Return the recording of a folder, or the given one as one that nothing is written to."""
    if isinstance(given, Recording):
        return replace(given, folder=Path(given.name))
    return read_recording(given)


def place_of(given: Recording | Path | str) -> Path:
    """Return the folder as it was given, or the name of a recording in memory, for a report."""
    return Path(given.name if isinstance(given, Recording) else given)


def reported(
    given: Recording | Path | str, changed: Recording, result: Result
) -> Recording | Result:
    """Return the changed recording if one was given, and the result of a folder."""
    if not isinstance(given, Recording):
        return result
    logger.info("%s", result.words)
    for doubt in result.doubts:
        logger.warning("%s", doubt)
    return changed


def amend_document(folder: Path, change: Change) -> None:
    """Change the content of `recording.json`, replacing the file completely or not at all."""
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
) -> Recording:
    """Replace the pickers' paths and the actions of a recording, and add to its provenance.

    The old actions are removed first, so the recording never combines old actions with new paths.
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

    if not recording.in_memory:
        amend_document(recording.folder, without_actions)
        write_file(recording.folder / PICKER_FILE, picker_text(paths).encode())
        amend_document(recording.folder, with_actions)
    return replace(
        recording,
        picker_paths=paths,
        actions=actions,
        cloth=replace(recording.cloth, held_vertices={}, grasp_uncertainty_m=0.0),
        provenance={**recording.provenance, **provenance},
    )


def set_masks(
    recording: Recording,
    camera: str,
    mask_of: Callable[[Frame], Bool[np.ndarray, "height width"] | None],
    *,
    color: str | None = None,
    provenance: Mapping[str, object],
) -> Recording:
    """Replace the masks of one camera, where `mask_of` gives one that is not empty."""
    folder, single = recording.folder, len(recording.cameras) == 1
    found = (
        (frame.index, mask)
        for frame in recording.frames
        if (mask := mask_of(frame)) is not None and mask.any()
    )
    masks: dict[int, Path | Bool[np.ndarray, "height width"]] = {}
    if recording.in_memory:
        masks = dict(found)
    else:
        place = folder / _free_name(folder)
        with atomic_folder(place) as unfinished:
            inside = Path() if single else Path(camera)
            (unfinished / inside).mkdir(exist_ok=True)
            for index, mask in found:
                file = inside / f"{index:06d}.png"
                (unfinished / file).write_bytes(encode_png(mask.astype(np.uint8) * 255))
                masks[index] = place / file

    def with_mask(frame: Frame) -> Frame:
        others = {name: mask for name, mask in frame.mask.items() if name != camera}
        new = {camera: masks[frame.index]} if frame.index in masks else {}
        return replace(frame, mask={**others, **new})

    changed = replace(
        recording,
        frames=tuple(map(with_mask, recording.frames)),
        cloth=replace(recording.cloth, color=color or recording.cloth.color),
        provenance={**recording.provenance, **provenance},
    )

    def name_masks(document: dict[str, Any]) -> None:
        for frame, entry in zip(changed.frames, document["frames"], strict=True):
            _name_files(entry, frame, folder, single=single)
        if color is not None:
            document.setdefault("cloth", {})["color"] = color
        document.setdefault("provenance", {}).update(provenance)

    if not recording.in_memory:
        amend_document(folder, name_masks)
        old = [frame.mask[camera] for frame in recording.frames if camera in frame.mask]
        for parent in {path.parent for path in old} - {folder}:
            _remove_pictures(parent, old)
    return changed


def _name_files(entry: dict[str, Any], frame: Frame, folder: Path, *, single: bool) -> None:
    """List a frame's masks, and the other files too if it relied on their conventional names."""
    conventional = not entry.keys() & {*PICTURE_KINDS, "cloud"}
    for kind in PICTURE_KINDS if conventional else ("mask",):
        files = {
            camera: path.relative_to(folder).as_posix()
            for camera, path in getattr(frame, kind).items()
        }
        entry.pop(kind, None)
        if files:
            entry[kind] = next(iter(files.values())) if single else files
    if conventional and frame.cloud is not None:
        entry["cloud"] = frame.cloud.relative_to(folder).as_posix()


def _free_name(folder: Path) -> str:
    """Return an unused name for a folder of masks."""
    names = (f"mask{number}" for number in range(2, 1_000_000))
    return "mask" if not (folder / "mask").exists() else next(
        name for name in names if not (folder / name).exists()
    )  # fmt: skip


def _remove_pictures(folder: Path, paths: list[Path]) -> None:
    """Remove pictures that are no longer referenced, and their folder if it is then empty."""
    with storage(folder):
        for path in paths:
            if path.parent == folder:
                path.unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()
