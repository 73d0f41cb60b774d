"""Pack folders of simulated states into a few small files, for a machine that only trains.

    clothtrack simulate out/towels --garment towel --states 3000 --seed 50
    clothtrack simulate out/shirts --garment tshirt --states 3000 --seed 50
    python experiments pack_states out/towels out/shirts --output out/packs

A state of 1,000 vertices takes about 3 kB, with its share of what is said of its garment. A file
holds whole garments, as many as --most-mib allows; towels and shirts take turns, so that every file
has both. `train_pieces` trains on the files.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import _path  # noqa: F401
from shared.figures import say

from clothtrack.errors import ClothTrackError
from clothtrack.geometry import quiet_warp
from clothtrack.reconstruction import open_states, read_shard
from clothtrack.reconstruction.data.state_store import StateSet, shard_digest
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.packed_states import PackedStates, in_files, write_pack


def garments(sets: Sequence[StateSet]) -> Iterator[PackedStates]:
    """Yield the states of each garment, one of each set in turn."""
    for row in zip_longest(*(one.shards for one in sets)):
        for path in row:
            if path is not None:
                shard = read_shard(path)
                yield PackedStates.of(
                    shard.mesh.faces,
                    GarmentTokens.of(shard.mesh),
                    shard.positions,
                    shard_digest(path),
                )


def run(options: argparse.Namespace) -> None:
    """Write the files."""
    sets = [open_states(folder) for folder in options.states]
    provenance = {"sets": [one.identity for one in sets]}
    most = int(options.most_mib * 2**20)
    for number, states in enumerate(in_files(garments(sets), most)):
        file = options.output / f"states_{number:02d}.safetensors"
        write_pack(file, states, {**provenance, "file": number})
        size = file.stat().st_size
        say(
            f"{file}: {len(states)} states of {len(states.digest)} garments, "
            f"{size / 2**20:.1f} MiB, {size / len(states):.0f} bytes a state\n"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("states", nargs="+", type=Path, help="folders of `clothtrack simulate`")
    parser.add_argument("--output", type=Path, required=True, help="folder of the files")
    parser.add_argument("--most-mib", type=float, default=24.0, help="most of one file [MiB]")
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        run(options)
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
