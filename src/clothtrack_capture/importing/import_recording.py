"""`clothtrack import`: conversion of another program's recording, frame by frame."""

import os
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import (
    InvalidConfigError,
    InvalidRecordingError,
    StorageError,
    TruncatedError,
)
from clothtrack.files.extras import require_extra
from clothtrack.files.progress import Progress
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import encode_png
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.recordings.store import RecordingWriter
from clothtrack.recordings.violation import DOCUMENT, Violation
from clothtrack_capture.importing.images import PackedPicture
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.import_report import Imported, ImportReport, report_of
from clothtrack_capture.importing.intrinsics import Intrinsics, read_json, rigid_matrix
from clothtrack_capture.importing.picker_paths import add_pickers, placed_paths
from clothtrack_capture.importing.png_folders import FolderSource, is_picture_folder
from clothtrack_capture.importing.registration import Registration
from clothtrack_capture.importing.source import Content, Source, StreamFrame, Streams, flag, listed
from clothtrack_capture.importing.times import LARGEST_TOLERANCE_S, Pair, pair, timed
from clothtrack_capture.importing.units import DepthUnit, measured_unit

_MOST_WORKERS = 4
_FARTHEST_COLOR_M, _FARTHEST_CAMERA_M = 1.0, 100.0
_BAG = re.compile(r"\.(db3|mcap|bag)( |$)")
CAMERA = "camera"  # its name in the recording


def open_source(path: Path, options: ImportOptions) -> Source:
    """Return the source for a file or folder."""
    if not path.exists():
        raise InvalidRecordingError(f"{path}: there is no such file or folder; check the name")
    if not (path.is_dir() or path.is_file()):
        raise InvalidRecordingError(f"{path}: neither a file nor a folder; name a recorded file")
    if (path / DOCUMENT).is_file():
        words = "is a recording already; use it as it is: clothtrack inspect"
        raise InvalidRecordingError(f"{path}: {words} {path}")
    try:
        # Pictures need none of the libraries of bags and Kinect files.
        if path.is_dir() and not _BAG.search(" ".join(file.name for file in path.iterdir())):
            if is_picture_folder(path):
                return FolderSource(path, options)
            seen = listed(sorted(file.name for file in path.iterdir()), 10) or "nothing"
            raise InvalidRecordingError(
                f"{path}: neither .mcap, .db3 or .bag files nor a folder depth/ are in it (there: "
                f"{seen}); see docs/import.md"
            )
        require_extra("capture", ("lz4", "mcap", "rosbags", "zstandard"), "importing")
        from clothtrack_capture.importing.containers import is_bag
        from clothtrack_capture.importing.kinect import KinectSource, is_kinect
        from clothtrack_capture.importing.ros_bags import BagSource

        if path.is_file() and is_kinect(path):
            return KinectSource(path, options)
        if path.is_dir() or is_bag(path):
            return BagSource(path, options)
    except OSError as error:
        raise StorageError.of(error) from error
    packed = "; unpack it first: zstd -d" if path.suffix in (".zstd", ".zst") else ""
    known = "neither a ROS bag (.bag, .db3, .mcap) nor a Kinect recording (.mkv)"
    raise InvalidRecordingError(f"{path}: {known}; its first bytes say so{packed}")


def import_recording(
    source: Path,
    folder: Path,
    options: ImportOptions = ImportOptions(),  # noqa: B008
    *,
    progress: Progress | None = None,
) -> ImportReport:
    """Import a recording, completely or not at all."""
    _check(options, folder)
    with closing(open_source(source, options)) as opened:
        done = _convert(source, folder, opened, options, progress)
    return report_of(source, folder, done, options)


def _convert(
    source: Path, folder: Path, opened: Source, options: ImportOptions, progress: Progress | None
) -> Imported:
    """Write the recording of an opened source."""
    streams = opened.streams
    if not streams.depth:
        why = "".join(f" ({note})" for note in streams.notes)
        raise InvalidRecordingError(
            f"{source}: not one whole depth picture{why}; record it again, or name others"
        )
    moved_m = float(np.linalg.norm(streams.calibration.color_from_depth[:3, 3]))
    if not moved_m <= _FARTHEST_COLOR_M:
        raise InvalidRecordingError(
            f"{source}: the color camera is {moved_m:g} m from the depth camera "
            f"({streams.calibration.origin}), more than {_FARTHEST_COLOR_M:g} m; give the right "
            "transform, in meters, with --intrinsics FILE"
        )
    frames, notes = timed(source, streams, options)
    pairing = pair(source, frames["depth"], frames.get("color"), options)
    decoded = [partial(_numbers, opened, one.depth) for one in pairing.pairs]
    unit = measured_unit(source, streams.unit, decoded, streams.ask_unit)
    empty = next((k for k, one in enumerate(decoded) if _shows(one)), len(decoded))
    if empty == len(decoded):
        raise InvalidRecordingError(
            f"{source}: all {empty} depth pictures are 0 everywhere: nothing was measured; record "
            "it again, or name others"
        )
    if empty:
        notes.append(f"the first {empty} depth pictures are 0 everywhere and were left out")
        pairing = replace(pairing, pairs=pairing.pairs[empty:])
    span_ns = pairing.pairs[0].depth.time_ns, pairing.pairs[-1].depth.time_ns
    if unit.swapped:
        notes.append("the two bytes of each depth stood in the wrong order and were exchanged")
    pose, table = _world(options, streams)
    posed, pose = pose is not None, np.eye(4) if pose is None else pose
    paths, text = placed_paths(source, streams, options, pose=pose, span_ns=span_ns, posed=posed)
    registration = Registration(streams.calibration, unit.stored_m)
    job = _Job(opened, registration, unit)
    with _said_of_the_source(source, streams, unit, options), RecordingWriter(
        folder,
        [_camera(source, streams.calibration.origin, registration.intrinsics, options, pose)],
        {CAMERA: unit.stored_m},
        table=table,
        cloth=ClothDescription(kind=options.cloth, color=options.cloth_color),
        provenance={
            "imported_from": source.name, "format": streams.kind, "streams": dict(streams.origins),
            "depth_unit_origin": unit.origin, "registered_by_import": registration.carried,
        },
    ) as writer:  # fmt: skip
        workers = options.workers or min(os.cpu_count() or 1, _MOST_WORKERS)
        times, damaged = _write_frames(writer, job, pairing.pairs, workers, progress)
        if not times:
            reason = damaged.most_common(1)[0][0]
            raise InvalidRecordingError(
                f"{source}: none of {damaged.total()} frames can be decoded: {reason}"
                + _lens_remedy(reason, streams, options)
            )
        actions, more = add_pickers(writer, paths, times, options.actions)
    if unmatched := len(streams.mask) - job.masks:
        notes.append(f"{unmatched} masks belong to no frame that was written")
    return Imported(
        streams, pairing, registration, unit, times, damaged, job.masks, paths, actions,
        [*notes, *text, *more], posed, table is not None,
    )  # fmt: skip


def _numbers(source: Source, frame: StreamFrame) -> np.ndarray:
    content = source.picture("depth", frame)()
    return content.decode() if isinstance(content, PackedPicture) else content


def _shows(decode: Callable[[], np.ndarray]) -> bool:
    """Return whether a depth picture shows anything, as far as it can be decoded."""
    try:
        return bool(np.nan_to_num(decode()).any())
    except TruncatedError:
        return True


@contextmanager
def _said_of_the_source(
    source: Path, streams: Streams, unit: DepthUnit, options: ImportOptions
) -> Iterator[None]:
    """Say what is wrong with the finished recording in terms of the source and the options."""
    try:
        yield
    except InvalidRecordingError as error:
        if error.violation is None:
            raise
        one: Violation = error.violation
        lens = f"the intrinsics ({streams.calibration.origin})"
        pickers = options.picker_csv or options.picker_topic or options.picker_frame
        for pattern, name, option in (
            ("^cameras.*depth_unit_m|^median depth", f"the unit of depth ({unit.origin})",
             "--depth-unit-m"),
            ("^cameras|^size", lens, "" if options.intrinsics else "--intrinsics FILE"),
            ("^actions|does not cover", "--actions", "frames that the picker's path covers"),
            ("^cloth", "--cloth-color", ""),
            ("^table", f"the table ({options.world_from_camera})", "another --world-from-camera"),
            ("picker", f"the picker's path ({pickers})", "meters in the world's frame"),
        ):  # fmt: skip
            if re.search(pattern, f"{one.field} {one.problem} {one.file}"):
                value = f"{one.field.rpartition('.')[2]} {one.value}".strip()
                remedy = f"give {option}" if option else one.remedy.replace(DOCUMENT, name)
                said = f"{name}: {value}: {one.problem}; {remedy}"
                raise InvalidRecordingError(f"{source}: {said}") from error
        raise InvalidRecordingError(f"{source}: {one.message}") from error


def _lens_remedy(reason: str, streams: Streams, options: ImportOptions) -> str:
    if "the intrinsics are for" not in reason or "mask" in reason:
        return ""
    remedy = f" ({streams.calibration.origin}); give those of this size with --intrinsics FILE"
    if options.intrinsics is not None:
        remedy = f"; correct width and height in {options.intrinsics}"
    sizes = "`depth`, `color` and `color_from_depth` if the sizes of both differ (docs/import.md)"
    return f"{remedy}, with {sizes}"


def _write_frames(
    writer: RecordingWriter, job: "_Job", pairs: Sequence[Pair], workers: int,
    progress: Progress | None,
) -> tuple[list[float], Counter[str]]:  # fmt: skip
    """Write all decodable pairs; return their times and the reasons why others failed."""
    times: list[float] = []
    damaged: Counter[str] = Counter()
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[dict[str, bytes]] | TruncatedError] = deque()
        try:
            for done, moment in enumerate(pairs):
                # Only a few pictures are in memory at a time.
                while len(waiting) <= workers + 1 and done + len(waiting) < len(pairs):
                    waiting.append(job.start(pool, pairs[done + len(waiting)]))
                started = waiting.popleft()
                try:
                    if isinstance(started, TruncatedError):
                        raise started
                    encoded = started.result()
                except TruncatedError as error:
                    damaged[str(error)] += 1
                else:
                    times.append((moment.depth.time_ns - pairs[0].depth.time_ns) / 1e9)
                    shown = {kind: {CAMERA: png} for kind, png in encoded.items()}
                    writer.add_encoded_frame(times[-1], shown)
                if progress is not None:
                    progress(f"frame {done + 1}/{len(pairs)}", done + 1, len(pairs))
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    return times, damaged


class _Job:
    """A job that reads the pictures of a moment, and converts them in another thread."""

    def __init__(self, source: Source, to: Registration, unit: DepthUnit) -> None:
        self._source, self.masks = source, 0
        self._masks = {mask.time_ns: mask for mask in source.streams.mask}
        # Per kind: whether a picture of this size is copied as it is, and how it is converted.
        self._how = {
            "depth": (to.keeps_depth if unit.copied else None,
                      lambda numbers: to.depth(unit.counts(numbers))),
            "color": (to.keeps_color, to.color),
            "mask": (None, partial(_mask, to)),
        }  # fmt: skip

    def start(
        self, pool: ThreadPoolExecutor, moment: Pair
    ) -> "Future[dict[str, bytes]] | TruncatedError":
        """Read the bytes here, in file order, and do the rest in the pool."""
        both = filter(None, (moment.depth, moment.color))
        mask = next((self._masks[one.time_ns] for one in both if one.time_ns in self._masks), None)
        self.masks += mask is not None
        frames = {"depth": moment.depth, "color": moment.color, "mask": mask}
        try:
            read = {kind: self._source.picture(kind, frame)
                    for kind, frame in frames.items() if frame is not None}  # fmt: skip
        except TruncatedError as error:
            return error
        return pool.submit(self._run, read)

    def _run(self, read: dict[str, Callable[[], Content]]) -> dict[str, bytes]:
        return {kind: _png_of(decode(), *self._how[kind]) for kind, decode in read.items()}


def _mask(to: Registration, picture: np.ndarray) -> np.ndarray:
    try:
        return to.color(picture, nearest=True)
    except TruncatedError as error:
        raise TruncatedError(f"a mask has the size of the color picture: {error}") from error


def _png_of(
    content: Content,
    keeps: Callable[[tuple[int, int]], bool] | None,
    carry: Callable[[np.ndarray], np.ndarray],
) -> bytes:
    """Return the PNG of a picture, reusing the source's own file if possible."""
    if isinstance(content, PackedPicture):
        png = content.plain_png() if keeps is not None and keeps(content.size) else None
        if png is not None:
            return png
        content = content.decode()
    return encode_png(carry(content), by_rows=True)


def _check(options: ImportOptions, folder: Path) -> None:
    if folder.exists():
        raise StorageError(f"{folder} exists; delete it or write to another name")
    if not abs(options.color_offset_s or 0.0) < 1e9:
        raise InvalidConfigError(f"--color-offset-s is {options.color_offset_s}; give below 1e9")
    for name in ("depth_unit_m", "fps", "tolerance_s", "workers"):
        if (value := getattr(options, name)) is not None and not 0 < value < 1e6:
            raise InvalidConfigError(f"{flag(name)} is {value}; it must be positive, below 1e6")
    if (tolerance_s := options.tolerance_s) is not None and tolerance_s > LARGEST_TOLERANCE_S:
        raise InvalidConfigError(
            f"--tolerance-s is {tolerance_s:g} s, at most {LARGEST_TOLERANCE_S:g}; pictures "
            "that far apart do not belong together; give seconds"
        )
    paths = ("picker_csv", "picker_topic", "picker_frame")
    for names in (paths, ("world_from_camera", "world_frame")):
        if len(given := [flag(name) for name in names if getattr(options, name)]) > 1:
            raise InvalidConfigError(f"{' and '.join(given)} tell the same: give one of them")
    if options.gripper_topic and options.picker_csv:
        raise InvalidConfigError(
            "--gripper-topic belongs to --picker-topic or --picker-frame; beside --picker-csv, "
            "write when the picker is closed into that file's column `closed`"
        )


def _world(
    options: ImportOptions, streams: Streams
) -> tuple[Float[np.ndarray, "4 4"] | None, Table | None]:
    """Return the camera pose and the table as far as they are known."""
    file = options.world_from_camera
    if file is None:
        return streams.world_from_camera, None
    content, table = read_json(file), None
    if isinstance(content, dict):
        table = _table(file, content.get("table"))
        content = content.get("world_from_camera")
    pose = rigid_matrix(f"{file}: world_from_camera", content)
    if (far_m := float(np.linalg.norm(pose[:3, 3]))) > _FARTHEST_CAMERA_M:
        words = f"puts the camera {far_m:g} m from the origin, more than {_FARTHEST_CAMERA_M:g} m"
        raise InvalidConfigError(f"{file}: world_from_camera {words}; write meters")
    return pose, table


def _table(file: Path, content: object) -> Table | None:
    if content is None:
        return None
    try:
        point, normal = (np.array(content[name], dtype=float) for name in ("point", "normal"))
        length = np.linalg.norm(normal)
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidConfigError(f"{file}: table has no point and normal of 3 numbers") from error
    if point.shape != (3,) or normal.shape != (3,) or not (
        np.isfinite(point).all() and 0.99 < length < 1.01
    ):  # fmt: skip
        raise InvalidConfigError(
            f"{file}: table.point {point.tolist()} and table.normal {normal.tolist()}; write 3 "
            "numbers [m] and a unit vector that points up"
        )
    return Table(point, normal / length)


def _camera(
    source: Path, origin: str, lens: Intrinsics, options: ImportOptions, pose: np.ndarray
) -> Camera:
    try:
        return lens.camera(CAMERA, pose)
    except InvalidRecordingError as error:
        remedy = "correct them" if options.intrinsics else "give --intrinsics FILE"
        words = f"the intrinsics ({origin}): {error}; {remedy}"
        raise InvalidRecordingError(f"{source}: {words}") from error
