"""Measure the vertex errors of networks on fresh simulated states, visible and hidden.

One picture per state, by a camera of the kinds that the networks learn from; the garment's own flat
mesh is given. Errors are those of the best-fitting symmetry, the same for every network. The states
are simulated by the solver that made the training states, from another seed.

    clothtrack simulate out/towels --garment towel --states 60 --seed 78
    clothtrack simulate out/shirts --garment tshirt --states 60 --seed 78
    python experiments network_on_states --states out/towels out/shirts --weights FILE --json OUT

The first of the weights is what the others are compared with. A second table holds the word of the
verdict against the truth: a mesh is right when its mean error is at most 5 % of the garment's
longer side. The verdict knows no truth. With --image ten of the states of each folder, evenly
taken, are drawn: the measured picture, the mesh of each network, the truth. With --worst N they
are the N states, of all folders, where the first network's error over the side is largest.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.bench_measures import Row, in_order
from shared.figures import say, write_png
from shared.reconstruction_pictures import (
    HEIGHT,
    WIDTH,
    Picture,
    depth_picture,
    line,
    mesh_picture,
)
from shared.table_column import mean_and_error, paired, table
from shared.verdict_words import of_each_word, told, trusted_without

from clothtrack.errors import ClothTrackError
from clothtrack.evaluation.verdict import picture_verdict
from clothtrack.files.atomic_write import atomic_file, content_hash
from clothtrack.files.provenance import commit
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.agreement import agreement_of
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.state_store import StateShard, open_states, read_shard
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.design import Reconstructor
from clothtrack.reconstruction.from_picture import figures_of
from clothtrack.reconstruction.model_loading import load_model
from clothtrack.recordings.recording import Table
from clothtrack.report.viewpoint import three_quarter_view
from clothtrack_lab.published_networks.rendered_state import render

HEAP = 0.55
"""Coverage below which a state is a heap."""

COVERAGES = (0.0, HEAP, 0.85, np.inf)
"""Bounds of the bands of true coverage in which errors are given."""

NEARLY_SQUARE = 0.85
PICTURES = 10
RIGHT = 0.05
"""Largest mean vertex error of a mesh that is right, over the garment's longer side."""

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


def look_alikes(mesh: ClothMesh) -> list[Float[np.ndarray, "3 3"]]:
    """Return maps of the canonical coordinates under which a towel or a shirt looks the same."""
    canonical = np.asarray(mesh.canonical, float)
    if np.ptp(canonical[:, 2]) > 0.0:
        return [np.eye(3), np.diag([-1.0, 1.0, -1.0])]
    width, length = np.ptp(canonical[:, :2], axis=0)
    signs = [np.diag([x, y, 1.0]) for x in (1.0, -1.0) for y in (1.0, -1.0)]
    if min(width, length) < NEARLY_SQUARE * max(width, length):
        return signs
    swap = np.array([[0.0, width / length, 0.0], [length / width, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return signs + [swap @ one for one in signs]


def named_best(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    true: Float[np.ndarray, "vertices 3"],
) -> Float[np.ndarray, "vertices 3"]:
    """Return the vertices [m] under the symmetry that is nearest to the truth."""
    canonical = np.asarray(mesh.canonical, float)
    renamed = []
    for turn in look_alikes(mesh):
        face, blend = closest_on_mesh(canonical @ turn.T, canonical, mesh.faces)
        renamed.append(np.einsum("vc,vcx->vx", blend, vertices[mesh.faces[face]]))
    return min(renamed, key=lambda one: np.linalg.norm(one - true, axis=1).mean())


def run(options: argparse.Namespace) -> list[Row]:
    """Return one row per state and network."""
    rows: list[Row] = []
    sheet = Sheet(options.image, options.worst)
    for folder in options.states:
        states = open_states(folder)
        models = {path: load_model(states.kind, path) for path in options.weights}
        shards = [read_shard(path) for path in states.shards]
        places = [(n, k) for n, shard in enumerate(shards) for k in range(len(shard.positions))]
        places = places[:: options.every]
        pictured = set(np.linspace(0, len(places) - 1, PICTURES).round().astype(int).tolist())
        for place, (number, state) in enumerate(places):
            case = State(states.kind, shards[number], number, state)
            meshes = [
                case.row(path, model, rows, refined=options.refined)
                for path, model in models.items()
            ]
            # After every state: a run that breaks off has lost nothing that it had measured.
            write(rows, options)
            first = rows[-len(models)]
            if options.image is not None and (options.worst or place in pictured):
                sheet.take(case, meshes, first)
            sys.stderr.write(f"\r{len(rows)} rows")
    sys.stderr.write("\n")
    return rows


class State:
    """One state, its picture, and the truth about it.

    Attributes:
        true: the mesh as it lies [m].
    """

    def __init__(self, kind: str, shard: StateShard, number: int, state: int) -> None:
        """Render the picture of a state of a shard; both are given by their numbers."""
        true = shard.positions[state].astype(float)
        drawn = render(true, shard.mesh, RenderConfig(), np.random.default_rng([7, number, state]))
        self._flat, self._kind = shard.mesh, kind
        self.picture = DepthInput(drawn.depth_m, drawn.mask, drawn.camera, TABLE, kind)
        self.true = shard.mesh.with_vertices(true)
        shown = Rasterizer(shard.mesh.faces, drawn.camera).render(true).faces
        self._seen = np.zeros(len(true), bool)
        self._seen[np.unique(shard.mesh.faces[np.unique(shown[shown >= 0])])] = True
        self.known: Row = {
            "kind": kind, "shard": number, "state": state, "recipe": shard.recipes[state],
            "size_m": float(np.ptp(shard.mesh.vertices[:, :2], axis=0).max()),
            "coverage": float(shard.measures["coverage"][state]),
        }  # fmt: skip

    def row(
        self, path: Path, model: Reconstructor, rows: list[Row], *, refined: bool
    ) -> ClothMesh | None:
        """Append the row of a network, and return its mesh."""
        row: Row = {"weights": str(path), **self.known}
        start = time.process_time()
        try:
            result = model.mesh(self.picture, self._kind, template=self._flat, refined=refined)
        except ClothTrackError as error:
            rows.append({**row, "error": str(error)})
            return None
        row["cpu_s"] = time.process_time() - start
        if result.mesh is None:
            rows.append({**row, "error": result.reconstruction.status})
            return None
        true, seen = self.true.vertices.astype(float), self._seen
        named = named_best(self._flat, result.mesh.vertices.astype(float), true)
        apart = 1e3 * np.linalg.norm(named - true, axis=1)
        row["in_order"] = in_order(named, true, self._flat)
        row |= {"error_mm": float(apart.mean()), "seen_mm": float(apart[seen].mean())}
        row |= {"hidden_mm": float(apart[~seen].mean())} if (~seen).any() else {}
        if (bounds := result.vertex_bounds_m) is not None:
            row["bounded"] = float((apart <= 1e3 * bounds).mean())
        found_m = result.mesh.vertices.astype(float)
        crossed = crossings(found_m, result.mesh.faces)
        row["crossings_per_1000_edges"] = 1e3 * crossed / len(result.mesh.edges)
        row["right"] = row["error_mm"] <= 1e3 * RIGHT * row["size_m"]
        agreement = agreement_of(result.mesh, self.picture)
        found = picture_verdict(result, agreement)
        row |= told(found)
        rows.append({**row, **figures_of(result, result.mesh, self.picture, agreement)})
        return result.mesh


class Sheet:
    """Draws states under each other, written after each of them.

    Args:
        file: of the picture; None draws nothing.
        worst: how many of the worst are kept; 0 keeps what is taken, in its order.
    """

    def __init__(self, file: Path | None, worst: int) -> None:
        self._file, self._worst = file, worst
        self._lines: list[tuple[float, Picture]] = []

    @property
    def shares(self) -> list[float]:
        """Error of each line that is kept [% of the longer side], in their order."""
        return [share for share, _ in self._lines]

    def take(self, case: State, meshes: Sequence[ClothMesh | None], row: Row) -> None:
        """Draw a state where it belongs; `row` is that of the first mesh."""
        share = row["error_mm"] / row["size_m"] / 10.0 if "error_mm" in row else np.inf
        full = self._worst and len(self._lines) >= self._worst
        if self._file is None or (full and share <= self._lines[-1][0]):
            return
        words = f"{row['kind']} {row['shard']}.{row['state']}, {row['recipe']}"
        words += f", {row['size_m']:.2f} m, {share:.1f} % off: {row.get('word', 'no mesh')}"
        self._lines.append((share, drawn_line(case.picture, [*meshes, case.true], words)))
        if self._worst:
            self._lines = sorted(self._lines, key=lambda line: -line[0])[: self._worst]
        write_png(self._file, np.vstack([picture for _, picture in self._lines]))


def drawn_line(picture: DepthInput, meshes: Sequence[ClothMesh | None], words: str) -> Picture:
    """Return a picture, each network's mesh of it, and the truth last."""
    assert meshes[-1] is not None
    camera = three_quarter_view(
        meshes[-1].vertices, width=WIDTH, height=HEIGHT, azimuth_deg=-90.0, elevation_deg=60.0
    )
    shown = [mesh_picture(mesh, camera, TABLE, "no mesh") for mesh in meshes]
    return line([depth_picture(picture.depth_m, picture.mask), *shown], (words, "the last: truth"))


def write(rows: Sequence[Row], options: argparse.Namespace) -> None:
    """Write the rows with what they were made of."""
    document = {
        "commit": commit(), "states": [folder.name for folder in options.states], "rows": rows,
        "weights_sha256": {str(path): content_hash(path) for path in options.weights},
    }  # fmt: skip
    with atomic_file(options.json) as unfinished:
        unfinished.write_text(json.dumps(document, indent=1), encoding="utf-8")


def markdown(rows: Sequence[Row]) -> str:
    """Return errors by kind, network and coverage, and the verdicts against the truth."""
    failed = [f"- {row['weights']}, {row['kind']}, shard {row['shard']}, state {row['state']}: "
              f"{row['error']}" for row in rows if "error" in row]  # fmt: skip
    return "\n".join([error_table(rows), "", trust_table(rows), "", *failed])


def error_table(rows: Sequence[Row]) -> str:
    """Return one line per kind, network and band of coverage; standard errors are over states."""
    good = [row for row in rows if "error" not in row]
    networks = list(dict.fromkeys(str(row["weights"]) for row in rows))
    several = len(networks) > 1
    head = ["garment", "network", "coverage", "states", "error, mm", "% of the side", "seen, mm",
            "hidden, mm", "layers in order",
            *(["minus the first", "lower in"] if several else []), "within bounds",
            "crossings per 1,000 edges", "CPU s"]  # fmt: skip
    first = {_state(row): row["error_mm"] for row in good if row["weights"] == networks[0]}
    lines = []
    for kind, network in product(dict.fromkeys(row["kind"] for row in rows), networks):
        for low, high in [*pairwise(COVERAGES), (0.0, np.inf)]:
            own = [row for row in good if row["weights"] == network and row["kind"] == kind
                   and low <= row["coverage"] < high]  # fmt: skip
            if not own:
                continue
            gaps = np.array([row["error_mm"] - first[_state(row)] for row in own
                             if _state(row) in first])  # fmt: skip
            pair = ["", ""] if network == networks[0] else paired(gaps)
            pair = pair if several else []
            band = "all" if not low and np.isinf(high) else (
                f"{100 * low:.0f} to {100 * min(high, 1.0):.0f} %"
            )  # fmt: skip
            bounded = [100 * row["bounded"] for row in own if "bounded" in row]
            ordered = [100 * row["in_order"] for row in own if row["in_order"] is not None]
            lines.append([
                kind, Path(network).name, band, str(len(own)),
                mean_and_error(np.array([row["error_mm"] for row in own])),
                _mean([0.1 * row["error_mm"] / row["size_m"] for row in own]),
                _mean([row["seen_mm"] for row in own]),
                _mean([row["hidden_mm"] for row in own if "hidden_mm" in row]),
                f"{_mean(ordered)} %", *pair,
                f"{_mean(bounded)} %",
                _mean([row["crossings_per_1000_edges"] for row in own]),
                f"{np.median([row['cpu_s'] for row in own]):.2f}",
            ])  # fmt: skip
    return table(head, lines)


def trust_table(rows: Sequence[Row]) -> str:
    """Return one line per network and kind: how many of each word, and how many of these are right.

    Under it, what would be trusted in all without each piece of evidence.
    """
    good = [row for row in rows if "error" not in row]
    lines, without = [], []
    for network in dict.fromkeys(row["weights"] for row in good):
        own = [row for row in good if row["weights"] == network]
        kinds = list(dict.fromkeys(row["kind"] for row in own))
        for kind in [*kinds, *(["all"] if len(kinds) > 1 else [])]:
            some = [row for row in own if kind in (row["kind"], "all")]
            right = f"{sum(row['right'] for row in some)} of {len(some)}"
            lines.append([kind, Path(network).name, right, *of_each_word(some).values()])
        without += [f"- {key} {value}" for key, value in trusted_without(own).items()]
    head = ["garment", "network", f"right (at most {100 * RIGHT:g} % off)", *of_each_word([])]
    return "\n".join([table(head, lines), "", *without])


def _state(row: Row) -> tuple[object, ...]:
    return row["kind"], row["shard"], row["state"]


def _mean(values: Sequence[float]) -> str:
    return f"{np.mean(values):.1f}" if len(values) else "-"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--states", type=Path, nargs="+", required=True, help="folders of fresh states"
    )
    parser.add_argument("--weights", type=Path, nargs="+", required=True, help="of the networks")
    parser.add_argument("--json", type=Path, required=True, help="file that gets the rows")
    parser.add_argument("--every", type=int, default=1, help="so many states, one of them")
    parser.add_argument("--image", type=Path, help="ten states of each folder, drawn")
    parser.add_argument("--worst", type=int, default=0, help="draw so many, the worst")
    parser.add_argument("--refined", action="store_true", help="fine-tune to each picture")
    options = parser.parse_args(arguments)
    if options.every < 1:
        parser.error("--every is at least 1")
    if options.worst < 0 or (options.worst and options.image is None):
        sys.stderr.write(f"--worst {options.worst}: give 1 or more, and --image FILE to draw in\n")
        return 2
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
