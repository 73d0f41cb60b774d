"""Networks on fresh simulated states: how far is every vertex from the truth, seen or hidden?

One picture per state, by a camera of the kinds that the networks learn from; the garment's own flat
mesh is given. Errors are those of the look-alike labelling that fits best, the same for every
network. The states are simulated by the solver that made the training states, from another seed.

    clothtrack simulate out/fresh --garment towel --states 200 --seed 21
    python experiments network_on_states --states out/fresh --weights FILE FILE --json OUT

The first of the weights is what the others are compared with. With --image ten of the states,
evenly taken, are drawn: the measured picture, the mesh of each network, the truth.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.bench_measures import Row
from shared.figures import say, write_png
from shared.reconstruction_pictures import (
    HEIGHT,
    WIDTH,
    Picture,
    depth_picture,
    line,
    mesh_picture,
)
from shared.table_column import table

from clothtrack.errors import ClothTrackError
from clothtrack.files import atomic_file, content_hash
from clothtrack.files.provenance import commit
from clothtrack.geometry import ClothMesh, Rasteriser, closest_on_mesh, quiet_warp
from clothtrack.reconstruction import (
    DepthInput,
    load_model,
    open_states,
    read_shard,
)
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.rendered_states import render
from clothtrack.reconstruction.from_picture import figures_of
from clothtrack.recordings import Table
from clothtrack.report.viewpoint import three_quarter_view

COVERAGES = (0.0, 0.55, 0.85, np.inf)
"""Bounds of the bands of true coverage in which errors are given."""

NEARLY_SQUARE = 0.85
PICTURES = 10
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


def look_alikes(mesh: ClothMesh) -> list[Float[np.ndarray, "3 3"]]:
    """Maps of the canonical coordinates under which a towel or a shirt looks the same."""
    canonical = np.asarray(mesh.canonical, float)
    if np.ptp(canonical[:, 2]) > 0.0:
        return [np.eye(3), np.diag([-1.0, 1.0, -1.0])]
    width, length = np.ptp(canonical[:, :2], axis=0)
    signs = [np.diag([x, y, 1.0]) for x in (1.0, -1.0) for y in (1.0, -1.0)]
    if min(width, length) < NEARLY_SQUARE * max(width, length):
        return signs
    swap = np.array([[0.0, width / length, 0.0], [length / width, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return signs + [swap @ one for one in signs]


def errors_mm(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    true: Float[np.ndarray, "vertices 3"],
) -> Float[np.ndarray, " vertices"]:
    """Distance of every vertex from the truth [mm] under the labelling that fits best."""
    canonical, best = np.asarray(mesh.canonical, float), None
    for turn in look_alikes(mesh):
        face, blend = closest_on_mesh(canonical @ turn.T, canonical, mesh.faces)
        renamed = np.einsum("vc,vcx->vx", blend, vertices[mesh.faces[face]])
        apart = 1e3 * np.linalg.norm(renamed - true, axis=1)
        best = apart if best is None or apart.mean() < best.mean() else best
    assert best is not None
    return best


def run(options: argparse.Namespace) -> list[Row]:
    """One row per state and network."""
    states, rows = open_states(options.states), []
    models = {path: load_model(states.kind, path) for path in options.weights}
    shards = [read_shard(path) for path in states.shards]
    places = [(n, k) for n, shard in enumerate(shards) for k in range(len(shard.positions))]
    places = places[:: options.every]
    pictured = set(np.linspace(0, len(places) - 1, PICTURES).round().astype(int).tolist())
    lines: list[Picture] = []
    for place, (number, state) in enumerate(places):
        shard = shards[number]
        true = shard.positions[state].astype(float)
        drawn = render(true, shard.mesh, RenderConfig(), np.random.default_rng([7, number, state]))
        picture = DepthInput(drawn.depth_m, drawn.mask, drawn.camera, TABLE, states.kind)
        shown = Rasteriser(shard.mesh.faces, drawn.camera).render(true).faces
        seen = np.zeros(len(true), bool)
        seen[np.unique(shard.mesh.faces[np.unique(shown[shown >= 0])])] = True
        size_m = float(np.ptp(shard.mesh.vertices[:, :2], axis=0).max())
        meshes: list[ClothMesh | None] = []
        for path, model in models.items():
            meshes.append(None)
            row: Row = {
                "weights": str(path), "shard": number, "state": state,
                "recipe": shard.recipes[state], "size_m": size_m,
                "coverage": float(shard.measures["coverage"][state]),
            }  # fmt: skip
            start = time.process_time()
            try:
                result = model.mesh(
                    picture, states.kind, template=shard.mesh, refined=options.refined
                )
            except ClothTrackError as error:
                rows.append({**row, "error": str(error)})
                continue
            row["cpu_s"] = time.process_time() - start
            if result.mesh is None:
                rows.append({**row, "error": result.reconstruction.status})
                continue
            meshes[-1] = result.mesh
            apart = errors_mm(shard.mesh, result.mesh.vertices.astype(float), true)
            row |= {"error_mm": float(apart.mean()), "seen_mm": float(apart[seen].mean())}
            row |= {"hidden_mm": float(apart[~seen].mean())} if (~seen).any() else {}
            rows.append({**row, **figures_of(result, result.mesh, picture)})
        # After every state: a run that breaks off has lost nothing that it had measured.
        write(rows, options)
        if options.image is not None and place in pictured:
            whole = shard.mesh.with_vertices(true)
            words = f"{states.kind}, {shard.recipes[state]}, {size_m:.2f} m"
            lines.append(drawn_line(picture, [*meshes, whole], words))
            write_png(options.image, np.vstack(lines))
        sys.stderr.write(f"\r{len(rows)} rows")
    sys.stderr.write("\n")
    return rows


def drawn_line(picture: DepthInput, meshes: Sequence[ClothMesh | None], words: str) -> Picture:
    """A picture, what each network made of it, and the truth, which is the last."""
    assert meshes[-1] is not None
    camera = three_quarter_view(
        meshes[-1].vertices, width=WIDTH, height=HEIGHT, azimuth_deg=-90.0, elevation_deg=60.0
    )
    shown = [mesh_picture(mesh, camera, TABLE, "no mesh") for mesh in meshes]
    return line([depth_picture(picture.depth_m, picture.mask), *shown], (words, "the last: truth"))


def write(rows: Sequence[Row], options: argparse.Namespace) -> None:
    """Write the rows with what they were made of."""
    document = {
        "commit": commit(), "states": options.states.name, "rows": rows,
        "weights_sha256": {str(path): content_hash(path) for path in options.weights},
    }  # fmt: skip
    with atomic_file(options.json) as unfinished:
        unfinished.write_text(json.dumps(document, indent=1), encoding="utf-8")


def markdown(rows: Sequence[Row]) -> str:
    """One line per network and band of coverage; standard errors are over states."""
    head = ["network", "coverage", "states", "error, mm", "% of the side", "seen, mm", "hidden, mm",
            "minus the first", "lower in", "trusted", "error of these, mm", "CPU s"]  # fmt: skip
    good = [row for row in rows if "error" not in row]
    networks = list(dict.fromkeys(str(row["weights"]) for row in rows))
    first = {(row["shard"], row["state"]): row["error_mm"] for row in good
             if row["weights"] == networks[0]}  # fmt: skip
    lines = []
    for network in networks:
        for low, high in [*pairwise(COVERAGES), (0.0, np.inf)]:
            own = [row for row in good if row["weights"] == network
                   and low <= row["coverage"] < high]  # fmt: skip
            if not own:
                continue
            error = np.array([row["error_mm"] for row in own])
            gaps = np.array([row["error_mm"] - first[row["shard"], row["state"]] for row in own
                             if (row["shard"], row["state"]) in first])  # fmt: skip
            trusted = [row["error_mm"] for row in own if row["trusted"]]
            pair = ["", ""] if network == networks[0] else [
                _mean_and_error(gaps), f"{int((gaps < 0).sum())} of {len(gaps)}"
            ]  # fmt: skip
            band = "all" if not low and np.isinf(high) else (
                f"{100 * low:.0f} to {100 * min(high, 1.0):.0f} %"
            )  # fmt: skip
            lines.append([
                Path(network).name, band, str(len(own)), _mean_and_error(error),
                f"{np.mean([0.1 * row['error_mm'] / row['size_m'] for row in own]):.1f}",
                f"{np.mean([row['seen_mm'] for row in own]):.1f}",
                _mean([row["hidden_mm"] for row in own if "hidden_mm" in row]),
                *pair, f"{len(trusted)} of {len(own)}",
                _mean(trusted),
                f"{np.median([row['cpu_s'] for row in own]):.2f}",
            ])  # fmt: skip
    failed = [f"- {row['weights']}, shard {row['shard']}, state {row['state']}: {row['error']}"
              for row in rows if "error" in row]  # fmt: skip
    return "\n".join([table(head, lines), "", *failed])


def _mean(values: Sequence[float]) -> str:
    return f"{np.mean(values):.1f}" if len(values) else "-"


def _mean_and_error(values: Float[np.ndarray, " rows"]) -> str:
    spread = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return f"{values.mean():.1f} ± {spread:.1f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--states", type=Path, required=True, help="folder of fresh states")
    parser.add_argument("--weights", type=Path, nargs="+", required=True, help="of the networks")
    parser.add_argument("--json", type=Path, required=True, help="file that gets the rows")
    parser.add_argument("--every", type=int, default=1, help="so many states, one of them")
    parser.add_argument("--image", type=Path, help="ten of the states, drawn")
    parser.add_argument("--refined", action="store_true", help="fine-tune to each picture")
    options = parser.parse_args(arguments)
    if options.every < 1:
        parser.error("--every is at least 1")
    quiet_warp()
    try:
        rows = run(options)
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{__doc__.splitlines()[0]}\n\n{markdown(rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
