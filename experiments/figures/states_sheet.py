"""Random states of folders of states, shaded, as a camera straight above sees them.

    clothtrack simulate OUT/towels --states 200
    python experiments states_sheet --states OUT/towels OUT/tshirts --count 48 --image FILE

Both sides of the cloth have their own color. Each state fills its tile; its recipe stands below.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float32
from shared.figures import say, write_png
from shared.reconstruction_pictures import Picture

from clothtrack.errors import ClothTrackError
from clothtrack.geometry import Camera, ClothMesh, quiet_warp
from clothtrack.reconstruction import open_states, read_shard
from clothtrack.reconstruction.data.state_store import StateShard
from clothtrack.recordings import Table
from clothtrack.report.lettering import caption
from clothtrack.report.shading import Shader, ShadingConfig

TILE = 150
"""Pixels of a tile along each side."""

ABOVE = 3.0
"""Height of the camera over the extent of the cloth, and so nearly a parallel view."""

LETTERS = 18
"""Height of the line under a tile [pixels]."""


def tile(mesh: ClothMesh, positions: Float32[np.ndarray, "vertices 3"], words: str) -> Picture:
    """One state from straight above, with a line of words."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    side_m = 1.15 * float((high - low)[:2].max())
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [*(0.5 * (low + high))[:2], ABOVE * side_m]
    middle = 0.5 * (TILE - 1)
    camera = Camera("above", TILE, TILE, ABOVE * TILE, ABOVE * TILE, middle, middle, pose)
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    shader = Shader(mesh.faces, camera, table=table, config=ShadingConfig(supersampling=2))
    return np.vstack([shader.render(positions).image, caption(TILE, words, height=LETTERS)])


def drawn(shards: Sequence[StateShard], count: int, rng: np.random.Generator) -> list[Picture]:
    """So many tiles of states that are drawn from all of them alike."""
    listed = [(shard, number) for shard in shards for number in range(len(shard.positions))]
    chosen = rng.choice(len(listed), min(count, len(listed)), replace=False)
    tiles = []
    for shard, number in (listed[one] for one in chosen):
        words = shard.recipes[number].replace("_", " ")
        tiles.append(tile(shard.mesh, shard.positions[number], words))
    return tiles


def sheet(folders: Sequence[Path], count: int, columns: int, seed: int) -> Picture:
    """Tiles of every folder in turn, as many of each, in rows.

    Raises:
        InvalidResultError: a folder holds no states.
    """
    rng, tiles = np.random.default_rng(seed), []
    for folder in folders:
        shards = [read_shard(path) for path in open_states(folder).shards]
        tiles += drawn(shards, count // len(folders), rng)
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    starts = range(0, len(tiles), columns)
    return np.vstack([np.hstack(tiles[start : start + columns]) for start in starts])


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture and say where it is; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--states", type=Path, nargs="+", required=True, help="folders of states")
    parser.add_argument("--count", type=int, default=48, help="tiles in all")
    parser.add_argument("--columns", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0, help="of the choice")
    parser.add_argument("--image", type=Path, default=Path("docs/images/states.png"))
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        picture = sheet(options.states, options.count, options.columns, options.seed)
        write_png(options.image, picture)
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{options.image}: {options.image.stat().st_size / 1e3:.0f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
