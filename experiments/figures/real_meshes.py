"""Draw meshes reconstructed from real pictures in one picture, evenly spaced and not chosen.

    python experiments real_pictures --data DIR --json OUT/real.json --keep OUT
    python experiments real_meshes --judged OUT/real.json --keep OUT --image FILE

The pictures themselves are not included, because they have no license. Each mesh is seen from its
camera, straight above, and shaded from the side.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.figures import say, write_png
from shared.reconstruction_pictures import HEIGHT, WIDTH, Picture, blank, line, mesh_picture

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry.devices import quiet_warp
from clothtrack.recordings.mesh_file import read_mesh
from clothtrack.report.viewpoint import three_quarter_view

OF_EACH = 10
COLUMNS = 5
FROM_ABOVE_DEG = 75.0


def drawn(row: dict[str, object], folder: Path) -> Picture:
    """Return one mesh with its name and the overlap of its silhouette; "no": it is not trusted."""
    name = str(row["picture"]).removeprefix("template_")
    words = name, f"{row['iou']:.2f}{'' if row['word'] == 'trust' else ' no'}"
    file = folder / f"{row['picture']}.ply"
    if not file.exists():
        return line([blank("no mesh")], words)
    mesh = read_mesh(file)
    camera = three_quarter_view(
        mesh.vertices.astype(float), width=WIDTH, height=HEIGHT, azimuth_deg=-90.0,
        elevation_deg=FROM_ABOVE_DEG,
    )  # fmt: skip
    return line([mesh_picture(mesh, camera, None, "")], words)


def sheet(judged: Path, keep: Path) -> Picture:
    """Return ten meshes of each set, evenly taken."""
    report, tiles = json.loads(judged.read_text(encoding="utf-8")), []
    for name in ("garments", "stickers"):
        rows = report.get(name, {}).get("rows", [])
        taken = np.unique(np.linspace(0, len(rows) - 1, OF_EACH).round().astype(int))
        tiles += [drawn(rows[number], keep / name) for number in taken if rows]
    if not tiles:
        raise InvalidConfigError(f"{judged}: nothing was judged; run real_pictures first")
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    starts = range(0, len(tiles), COLUMNS)
    return np.vstack([np.hstack(tiles[start : start + COLUMNS]) for start in starts])


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture and print its path; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--judged", type=Path, required=True, help="what real_pictures wrote")
    parser.add_argument("--keep", type=Path, required=True, help="where it left the meshes")
    parser.add_argument("--image", type=Path, default=Path("docs/images/real_meshes.png"))
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        write_png(options.image, sheet(options.judged, options.keep))
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{options.image}: {options.image.stat().st_size / 1e3:.0f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
