"""Score reconstructions of single real pictures: garments folded by hand, crumpled cloths.

Claim judged: the network knows real cloth. No true mesh is known. A garment is judged by its
silhouette and by its visible surface against the measured one (two-way Chamfer distance, summed). A
cloth with stickers on its corners is also judged by them. Each visible sticker is assigned to one
corner of the mesh, at the position of a sticker's middle, with the least distances. The distances
are in parts of the cloth's longer side, over all stickers. The control uses no network but the
corners of the least rectangle around the silhouette. A picture without a mesh has no overlap, an
infinite Chamfer distance, and all its corners in the middle of its silhouette.

    python experiments real_pictures --data DIR --json OUT

A mesh is right when silhouettes overlap by 0.93, the Chamfer distance is at most 3e-4 m^2 and each
sticker is near its corner. That says nothing of hidden layers. The word of the verdict is printed
beside it; it knows no silhouette of the color picture and no sticker.

DIR has `garments`, `stickers` or both (`real/topdown.py` has the layout). Each row is written when
it is finished; a second call with the same weights, commit and data resumes. `--smoke` asks an
untrained network about two drawn pictures: its figures mean nothing.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.bench_measures import Row, finite
from shared.figures import say, write_json
from shared.learning_runs import kind_of, tiny_network
from shared.verdict_words import of_each_word, told, trusted_without

from clothtrack import __version__
from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidRecordingError
from clothtrack.evaluation.verdict import picture_verdict
from clothtrack.files.atomic_write import content_hash
from clothtrack.files.provenance import commit
from clothtrack.geometry.chamfer import two_way
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.agreement import agreement_of
from clothtrack.reconstruction.availability import shipped_weights
from clothtrack.reconstruction.design import Reconstructor
from clothtrack.reconstruction.from_picture import distance_from_picture
from clothtrack.reconstruction.model_loading import load_model
from clothtrack.recordings.mesh_file import write_mesh
from real.drawn_sets import write_topdown
from real.picture_scores import (
    Points,
    assigned,
    at_stickers,
    drawn_depth,
    moved_in,
    silhouette_iou,
)
from real.topdown import (
    GARMENTS,
    PIXEL_M,
    SETS,
    STICKER_INSET,
    STICKERS,
    USUAL_SIDE_M,
    Entry,
    RealPicture,
    least_rectangle,
)

NEAR = 0.1
"""A sticker nearer than this to its corner, in parts of the longer side, is right."""

LEAST_IOU, LARGEST_CHAMFER_M2 = 0.93, 3e-4
"""Of a mesh that is right."""

NO_FIGURES: Row = {
    "iou": 0.0, "chamfer_m2": None, "cloud_to_mesh_m": None, "word": "reject", "reason": "no mesh",
    "right": False, "expected_error_m": None, "scale": None, "seconds": None, "cpu_s": None,
    "tilt_deg": None,
}  # fmt: skip
"""Of a picture that became no mesh."""


@dataclass
class Networks:
    """The network of each garment, loaded on first use.

    Attributes:
        weights: by the garment that they are for, or "any"; those that come with clothtrack where
            none are.
    """

    weights: Mapping[str, Path] = field(default_factory=dict)
    device: str = "cpu"
    _models: dict[str, Reconstructor] = field(default_factory=dict)

    def model(self, kind: str) -> Reconstructor:
        """Return the network for a garment."""
        if kind not in self._models:
            self._models[kind] = load_model(kind, self._weights(kind), device=self.device)
        return self._models[kind]

    def digests(self) -> dict[str, str]:
        """SHA-256 of the weights for each garment."""
        files = {kind: self._weights(kind) or shipped_weights() for kind in ("towel", "tshirt")}
        return {kind: content_hash(path) for kind, path in files.items() if path is not None}

    def _weights(self, kind: str) -> Path | None:
        return self.weights.get(kind, self.weights.get("any"))


def judged(entry: Entry, networks: Networks, keep: Path | None) -> Row:
    """Return the row of one picture; its mesh is left in `keep`, PLY."""
    model = networks.model(entry.kind)
    row: Row = {"picture": entry.name, "garment": entry.garment, "kind": entry.kind, **NO_FIGURES}
    wall, used = time.perf_counter(), time.process_time()
    try:
        picture = entry.read()
    except InvalidRecordingError as error:
        return {**row, "error": str(error)}
    mesh, bounds = None, None
    try:
        made = model.mesh(
            picture.depth,
            entry.kind,
            size_m=picture.size_m,
            refined=True,
            untangle=True,
            device=networks.device,
        )
        mesh = made.mesh
        row |= {"status": made.reconstruction.status, "scale": made.scale}
        if mesh is not None:
            found = picture_verdict(made, agreement_of(mesh, picture.depth))
            bounds = made.vertex_bounds_m
            row |= {
                "cloud_to_mesh_m": distance_from_picture(mesh, picture.depth),
                "expected_error_m": made.expected_error_m,
                **told(found),
            }
    except ClothTrackError as error:
        row["error"] = str(error)
    row |= {"seconds": time.perf_counter() - wall, "cpu_s": time.process_time() - used}
    if mesh is not None and keep is not None:
        write_mesh(mesh, keep / f"{entry.name}.ply")
    up = picture.depth.camera.world_from_camera[2, 2]
    row |= {
        "table_source": picture.depth.table_source,
        "table_residual_m": picture.depth.table_residual_m,
        "tilt_deg": float(np.degrees(np.arccos(np.clip(-up, -1.0, 1.0)))),
        **_surface_scores(mesh, picture),
    }
    if picture.stickers is not None:
        row |= _sticker_scores(mesh, bounds, picture, picture.stickers)
    row["right"] = (
        row["iou"] >= LEAST_IOU
        and _or_infinite(row["chamfer_m2"]) <= LARGEST_CHAMFER_M2
        and all(apart < NEAR for apart in row.get("sticker_side", []))
    )
    return row


def _surface_scores(mesh: ClothMesh | None, picture: RealPicture) -> Row:
    if mesh is None:
        return {}
    camera = picture.depth.camera
    drawn = drawn_depth(mesh, camera)
    cloud = camera.back_project(picture.depth.depth_m, picture.depth.mask)
    surface = camera.back_project(drawn)
    return {
        "iou": silhouette_iou(drawn > 0, picture.silhouette),
        "chamfer_m2": two_way(surface, cloud) if len(surface) and len(cloud) else None,
    }


def _sticker_scores(
    mesh: ClothMesh | None,
    bounds: Float[np.ndarray, " vertices"] | None,
    picture: RealPicture,
    stickers: Points,
) -> Row:
    rectangle = least_rectangle(picture.silhouette)
    longer = max(picture.size_m or (USUAL_SIDE_M,)) / PIXEL_M
    if mesh is None:
        rows, columns = np.nonzero(picture.silhouette)
        corners = np.tile((columns.mean(), rows.mean()), (4, 1))
    else:
        corners, _ = picture.depth.camera.project(at_stickers(mesh, mesh.vertices.astype(float)))

    def sides(places: Points) -> list[float]:
        return [float(each) for each in assigned(stickers, places)[0] / longer]

    scores: Row = {}
    if mesh is not None and bounds is not None:
        apart, corner = assigned(stickers, corners)
        within = PIXEL_M * apart <= at_stickers(mesh, bounds[:, None])[corner, 0]
        scores["sticker_bounded"] = within.tolist()
    return scores | {
        "corners_px": corners.tolist(),
        "sticker_side": sides(corners),
        "control_side": sides(rectangle),
        "control_moved_in_side": sides(moved_in(rectangle, STICKER_INSET * longer)),
    }


def garments_summary(rows: Sequence[Row]) -> dict[str, object]:
    """Return rows of the garments with their means."""
    return {
        "rows": list(rows),
        "iou": _mean([row["iou"] for row in rows]),
        "chamfer_median_m2": float(np.median([_or_infinite(row["chamfer_m2"]) for row in rows])),
        **of_each_word(rows),
        **trusted_without(rows),
    }


def stickers_summary(rows: Sequence[Row]) -> dict[str, object]:
    """Return rows of the cloths with stickers, their mean, and means over all stickers."""
    network, control = (
        [apart for row in rows for apart in row.get(key, [])]
        for key in ("sticker_side", "control_side")
    )
    return {
        "rows": list(rows),
        "iou": _mean([row["iou"] for row in rows]),
        "one_to_one_side": _mean(network),
        "within_0_1": _mean([apart < NEAR for apart in network]),
        "within_bounds": _mean(_pooled(rows, "sticker_bounded")),
        **of_each_word(rows),
        **trusted_without(rows),
        "control_one_to_one_side": _mean(control),
        "control_within_0_1": _mean([apart < NEAR for apart in control]),
    }


SUMMARIES = {GARMENTS: garments_summary, STICKERS: stickers_summary}


def table(name: str, rows: Sequence[Row]) -> str:
    """Return the rows as text, one line each, and what they come to."""
    heads = [
        "IoU",
        "Chamfer, 1e-4 m2",
        "cloud to mesh, mm",
        "word",
        "right",
        "s",
        "CPU s",
        "scale",
        "tilt",
    ]
    heads += ["in sides"] if name == STICKERS else []
    wide = max(len(row["picture"]) for row in rows)
    lines = [f"{'picture':<{wide}}  garment          {'  '.join(heads)}"]
    for row in rows:
        cells = [
            f"{row['iou']:.2f}", _number(row["chamfer_m2"], 1e4),
            _number(row["cloud_to_mesh_m"], 1e3), row["word"], "yes" if row["right"] else "no",
            _number(row["seconds"]), _number(row["cpu_s"]), _number(row["scale"], digits=2),
            _number(row["tilt_deg"]),
            " ".join(f"{each:.3f}" for each in row.get("sticker_side", [])),
        ]  # fmt: skip
        figures = "  ".join(f"{c:>{len(head)}}" for c, head in zip(cells, heads, strict=False))
        line = f"{row['picture']:<{wide}}  {row['garment']:<15}  {figures}  {row.get('error', '')}"
        lines.append(line.rstrip())
    summary = SUMMARIES[name](rows)
    if name == STICKERS:
        inside = _pooled(rows, "control_moved_in_side")
        summary["control, moved in"] = _mean(inside)
        summary["control, moved in, within 0.1"] = _mean([apart < NEAR for apart in inside])
    means = (
        f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in summary.items()
        if isinstance(value, float | str)
    )
    return "\n".join([f"{name}: {len(rows)} pictures", *lines, ", ".join(means)]) + "\n\n"


def run(options: argparse.Namespace) -> dict[str, object]:
    """Judge all pictures of the sets that are there; the report is written after each of them."""
    networks = Networks({kind_of(path): path for path in options.weights}, options.device)
    if len(networks.weights) < len(options.weights):
        raise InvalidConfigError("two of the weights are for the same garment; name one of them")
    folders = {name: options.data / name for name in SETS if (options.data / name).is_dir()}
    stamp = {
        "clothtrack": __version__, "commit": commit(), "weights_sha256": networks.digests(),
        "meta_sha256": {n: content_hash(folder / "meta.json") for n, folder in folders.items()},
    }  # fmt: skip
    report: dict[str, object] = {"provenance": stamp}
    known = _rows_of(options.json, stamp)
    for name, folder in folders.items():
        keep = None if options.keep is None else options.keep / name
        rows: list[Row] = []
        entries = SETS[name](folder)
        for number, entry in enumerate(entries, start=1):
            row = known.get((name, entry.name))
            if row is None or not _complete(row, keep and keep / f"{entry.name}.ply"):
                row = finite(judged(entry, networks, keep))
                sys.stderr.write(f"{name}: {number} of {len(entries)}\n")
            rows.append(row)
            report[name] = SUMMARIES[name](rows)
            if options.json is not None:
                write_json(options.json, report)
        say(table(name, rows))
    for name in SETS:
        if name not in folders:
            say(f"{name}: skipped, there is no {options.data / name}\n")
    return report


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with garments/, stickers/ or both")
    parser.add_argument("--json", type=Path, help="rows and means; a second call goes on from it")
    parser.add_argument("--keep", type=Path, help="folder of the meshes")
    parser.add_argument(
        "--weights", type=Path, nargs="+", default=[], help="other than those that are shipped"
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="two drawn pictures, a tiny network")
    options = parser.parse_args(arguments)
    if options.data is None and not options.smoke:
        parser.error("give --data DIR, or --smoke")
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="real-pictures-") as temporary:
        if options.smoke:
            options.data = options.data or write_topdown(Path(temporary) / "data")
            options.weights = options.weights or [
                tiny_network(Path(temporary) / f"{kind}.safetensors", kind)
                for kind in ("towel", "tshirt")
            ]
        try:
            report = run(options)
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
    return 0 if len(report) > 1 else 1


def _rows_of(file: Path | None, stamp: Mapping[str, object]) -> dict[tuple[str, str], Row]:
    """Return rows by set and picture of an earlier call that had the same stamp."""
    if file is None or not file.exists():
        return {}
    report = json.loads(file.read_text(encoding="utf-8"))
    if report.get("provenance") != finite(stamp):
        return {}
    return {(n, row["picture"]): row for n in SETS for row in report.get(n, {}).get("rows", [])}


def _complete(row: Row, mesh: Path | None) -> bool:
    """Return whether a row's mesh is kept where meshes are, or there is none."""
    return mesh is None or row["cloud_to_mesh_m"] is None or mesh.exists()


def _pooled(rows: Sequence[Row], key: str) -> list[float]:
    return [apart for row in rows for apart in row.get(key, [])]


def _number(value: float | None, factor: float = 1.0, digits: int = 1) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def _or_infinite(value: float | None) -> float:
    return np.inf if value is None else value


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


if __name__ == "__main__":
    sys.exit(main())
