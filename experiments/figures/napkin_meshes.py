"""Draw real napkins as reconstructed by a network before and after learning from labels.

    python experiments table2_real --data DIR --json OUT
    python experiments napkin_meshes --data DIR --rows OUT --image FILE

The figure has ten of the judged pictures, evenly spaced, each with the mesh before, the mesh after,
and the tracker's mesh. The measured clouds are not included, because they have no license.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from real.learned_cloth import KIND
from real.robot_learning import Napkin, napkins
from real.table2_real import NETWORKS
from shared.bench_measures import Row
from shared.figures import say, write_png
from shared.reconstruction_pictures import HEIGHT, WIDTH, Picture, line, mesh_picture

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry import ClothMesh, quiet_warp
from clothtrack.reconstruction import load_model
from clothtrack.report.viewpoint import three_quarter_view
from clothtrack.tracking import TrackedTrajectory

COUNT, COLUMNS = 10, 2


def taken(cloths: Sequence[Napkin]) -> list[tuple[Napkin, int]]:
    """Return ten pictures, evenly."""
    every = [(one, frame) for one in cloths for frame in one.frames]
    return [every[n] for n in np.linspace(0, len(every) - 1, COUNT).round().astype(int)]


def row_of(report: dict[str, list[Row]], network: str, labels: str) -> Row:
    """Return the first row of these labels."""
    for row in report["rows"]:
        if (row["network"], row["labels"]) == (network, labels) and "weights" in row:
            return row
    raise InvalidConfigError(f"no row of {network!r} and {labels!r} was measured; run table2_real")


def sheet(data: Path, rows: Path, network: str, labels: str) -> Picture:
    """Return all pictures with their meshes."""
    report, keep = json.loads(rows.read_text(encoding="utf-8")), rows.with_suffix("")
    judged = report["provenance"]["sequences"]["choose"]
    cloths = [one for one in napkins(data, keep / "recordings") if one.name in judged]
    before = NETWORKS[network]
    after = keep / str(row_of(report, network, labels)["weights"])
    models = [load_model(KIND, weights) for weights in (before, after)]
    tiles = []
    for cloth, frame in taken(cloths):
        tracked = TrackedTrajectory.load(keep / "tracked" / "default" / f"{cloth.name}.zarr")
        picture, size_m = cloth.picture(frame), cloth.size_m
        meshes: list[ClothMesh | None] = [
            model.mesh(picture, KIND, size_m=size_m).mesh for model in models
        ]
        known = tracked.mesh.with_vertices(np.asarray(tracked.positions[frame], np.float64))
        camera = three_quarter_view(
            known.vertices.astype(np.float64), width=WIDTH, height=HEIGHT, azimuth_deg=-60.0,
            elevation_deg=35.0,
        )  # fmt: skip
        drawn = [mesh_picture(mesh, camera, None, "no mesh") for mesh in (*meshes, known)]
        tiles.append(line(drawn, (f"{cloth.name} {frame}", "before, after, tracked")))
    starts = range(0, len(tiles), COLUMNS)
    return np.vstack([np.hstack(tiles[start : start + COLUMNS]) for start in starts])


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture and print its path; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="as table2_real had it")
    parser.add_argument("--rows", type=Path, required=True, help="what table2_real wrote")
    parser.add_argument("--network", default="tokens", help="whose meshes")
    parser.add_argument("--labels", default="default", help="what it learned from")
    parser.add_argument("--image", type=Path, default=Path("docs/images/napkins.png"))
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        write_png(options.image, sheet(options.data, options.rows, options.network, options.labels))
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{options.image}: {options.image.stat().st_size / 1e3:.0f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
