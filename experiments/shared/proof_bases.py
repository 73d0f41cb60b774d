"""Base recordings to corrupt, or to change without harm: drawn, simulated, shipped and real.

Each is made once and stored as one file with its truth. Drawn and simulated ones have true
vertices. For the hanging cloth only the surface was measured, so its error is the distance of the
mesh's vertices to the measured points, which is at most the true one. For the napkins only the
cameras' data are known, so they are used only for false alarms.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shared.drawn_films import LOWEST_M, SCENES, draw, sheet
from shared.recording_data import RecordingData, read_folder

VERTICES = 500
"""About how many vertices the tracked meshes have."""

REAL = "real"
"""Name, beside the bases, of the folder with the real sets, or of a link to it."""

MEASURED_POINTS = 25_000
"""Points of a measured surface that are kept of each frame."""


class MissingBaseError(Exception):
    """A recording cannot be made here; the message says why."""


@dataclass(frozen=True)
class Base:
    """One recording to change.

    Attributes:
        name: of its file.
        has: what a kind of change may need.
        make: makes it, in a folder for what is kept; raises `MissingBaseError` where it cannot.
        wrong: whether it is spoilt, too, and not only used for false alarms.
    """

    name: str
    has: frozenset[str]
    make: Callable[[Path], RecordingData]
    wrong: bool = True


def load(base: Base, stage: Path) -> RecordingData:
    """The recording, made where it is missing.

    Raises:
        MissingBaseError: it needs what is not here.
    """
    file = stage / "bases" / f"{base.name}.npz"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        base.make(stage).save(file)
    return RecordingData.load(file)


def _drawn(
    name: str, *, template: bool = False, color: str | None = None
) -> Callable[[Path], RecordingData]:
    """A film of `drawn_films`, with masks or the name of its color, with a template or a size."""

    def make(_: Path) -> RecordingData:
        scene = SCENES[name]
        film = draw(scene)
        rng = np.random.default_rng([scene.seed, 1])
        height = scene.width * 3 // 4
        camera = {
            "name": "camera", "width": scene.width, "height": height, "fx": scene.focal,
            "fy": scene.focal, "cx": 0.5 * (scene.width - 1), "cy": 0.5 * (height - 1),
            "depth_unit_m": 0.001, "world_from_camera": scene.pose.tolist(),
        }  # fmt: skip
        cloth: dict[str, Any] = {"kind": "towel", "size_m": list(scene.size_m)}
        if color is not None:
            cloth["color"] = color
        data = RecordingData(
            document={
                "version": 1,
                "cameras": [camera],
                "table": {"point": [0, 0, 0], "normal": [0, 0, 1]},
                "frames": [],
                "actions": [
                    {"first_frame": first, "last_frame": last, "pickers": sorted(film.tips)}
                    for first, last in scene.actions
                ],
                "cloth": cloth,
                "provenance": {"source": "drawn"},
            },
            color=film.color,
            depth=film.depth,
            mask=film.mask if color is None else None,
            truth=film.positions,
            truth_faces=film.faces,
            truth_canonical=np.column_stack([film.grid, np.zeros(len(film.grid))]),
            moments=np.arange(scene.frames),
        )
        data.times = scene.times
        for picker, tips in film.tips.items():
            # As a path that was found in pictures: a constant error, and one of each sample.
            measured = tips + rng.normal(0.0, 0.002, 3) + rng.normal(0.0, 0.001, tips.shape)
            data.picker[picker] = np.column_stack([scene.times, measured, film.closed[picker]])
        if template:
            width, length = scene.size_m
            grid, data.faces = sheet(scene.size_m, float(np.sqrt(width * length / VERTICES)))
            flat = replace(scene, moves=())
            data.vertices = flat.positions(grid, 0.0) + rng.normal(0.0, 0.0004, (len(grid), 3))
            data.vertices[:, 2] = LOWEST_M
            data.canonical = np.column_stack([grid, np.zeros(len(grid))])
        return data

    return make


def _simulated(kind: str, seed: int, **changes: Any) -> Callable[[Path], RecordingData]:
    def make(stage: Path) -> RecordingData:
        from clothtrack_lab.world import SMALL_WORLD, simulate_trajectory
        from clothtrack_lab.world.episodes import ActionConfig, TemplateConfig

        config = replace(
            SMALL_WORLD,
            **{
                "size_m": None,
                "vertex_count": 600,
                "settle_limit_s": 0.6,
                "template": TemplateConfig(vertex_count=VERTICES),
                "action": ActionConfig(frame_rate=10.0, distance_m=(0.1, 0.2)),
                **changes,
            },
        )
        out = stage / "simulated"
        folder = out / "recordings" / f"{kind}_{seed:04d}"
        if not folder.exists():
            simulate_trajectory(kind, seed, out, config=config)
        return _with_truth(read_folder(folder), out / "truth" / f"{folder.name}.npz")

    return make


def _with_truth(data: RecordingData, file: Path) -> RecordingData:
    with np.load(file) as stored:
        data.truth = stored["positions"].astype(np.float64)
        data.truth_faces, data.truth_canonical = stored["faces"], stored["canonical"]
    return data


def _shipped(stage: Path) -> RecordingData:
    """The first action of the shipped recording; its truth from filming it again."""
    from figures.shipped_recording import NAME, SEED, WORLD

    from clothtrack.recordings.shipped import shipped_recording
    from clothtrack_lab.world import simulate_trajectory

    out = stage / "filmed"
    again = out / "recordings" / f"tshirt_{SEED:04d}"
    if not again.exists():
        simulate_trajectory("tshirt", SEED, out, config=WORLD)
    data, filmed = read_folder(shipped_recording(NAME)), read_folder(again)
    known = data.depth > 0
    if data.depth.shape != filmed.depth.shape or (data.depth != filmed.depth)[known].any():
        raise MissingBaseError(
            "filmed here again, the shipped recording has other pictures: its truth is not known"
        )
    _with_truth(data, out / "truth" / f"{again.name}.npz")
    action = data.document["actions"][0]
    data.document["actions"] = [action]
    data.take(np.arange(action["first_frame"], action["last_frame"] + 1))
    return data


def _hanging(stage: Path) -> RecordingData:
    """Sixteen frames of the real hanging cloth; a measured surface for a truth."""
    from real import hanging_cloth

    source, folder = _real(stage, hanging_cloth.NAME), stage / "converted" / hanging_cloth.NAME
    if not folder.exists():
        hanging_cloth.convert(source, folder, frames=16)
    data, rng = read_folder(folder), np.random.default_rng(0)
    data.truth = np.stack(
        [
            points[rng.choice(len(points), MEASURED_POINTS, replace=False)]
            for points in hanging_cloth.measured_points(source)[: data.count]
        ]
    )
    return data


def _napkin(name: str) -> Callable[[Path], RecordingData]:
    def make(stage: Path) -> RecordingData:
        from real import robot_clouds

        folder = stage / "converted" / name
        source = _real(stage, robot_clouds.NAME) / "sequences" / f"{name}.npz"
        if not folder.exists():
            robot_clouds.convert(source, folder)
        return read_folder(folder)

    return make


def _real(stage: Path, name: str) -> Path:
    folder = stage / REAL / name
    if not folder.is_dir():
        raise MissingBaseError(f"the real set {name} is not here: give --data FOLDER")
    return folder


_SEEN = frozenset({"color", "depth", "table", "picker"})

BASES: tuple[Base, ...] = (
    Base("stiff_loop", _SEEN | {"mask", "size", "hand"}, _drawn("stiff_loop")),
    Base("stiff_open", _SEEN | {"mask", "size", "hand"}, _drawn("stiff_open")),
    Base("soft_drape", _SEEN | {"mask", "template", "hand", "oblong"},
         _drawn("soft_drape", template=True)),
    Base("drag", _SEEN | {"size"}, _drawn("drag", color="green")),
    Base("two_folds", _SEEN | {"mask", "template", "two actions"},
         _drawn("two_folds", template=True)),
    Base("half_fold", _SEEN | {"mask", "size", "hand"}, _drawn("half_fold")),
    Base("napkin", _SEEN | {"template", "oblong"}, _simulated("towel", 21, size_m=(0.26, 0.2))),
    Base("towel", _SEEN | {"size"}, _simulated("towel", 12, size_m=(0.34, 0.24), template=None)),
    Base("tshirt", _SEEN | {"template", "oblong"}, _simulated("tshirt", 13, vertex_count=700)),
    Base("shipped", _SEEN | {"template", "oblong"}, _shipped),
    Base("hanging", frozenset({"color", "depth", "mask", "template"}), _hanging),
    Base("napkin_folded", frozenset({"picker", "template", "clouds"}), _napkin("fold_navy"),
         wrong=False),
    Base("napkin_lifted", frozenset({"picker", "template", "clouds"}), _napkin("lift_tan"),
         wrong=False),
)  # fmt: skip
"""Motion laws and physics that differ as much as we have them. An "oblong" template is another one
when its sides are exchanged."""
