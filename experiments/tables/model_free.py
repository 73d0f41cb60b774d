"""Compare the tracker with coherent point drift and an edge-length projection.

Claim judged: dynamics predict the motion of the hidden part of the cloth better than smoothness and
edge lengths do. The baseline (shared/coherent_point_drift.py) is given the same clouds, first mesh,
and tool path, once with the grasp point on the cloth, as in CDCPD, and once without.

    pip install biocpd      (the extra [experiments] brings it)
    python experiments model_free --bench OUT --split test --workers 2
"""

import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.bench_runs import Variant
from shared.coherent_point_drift import PeerConfig
from shared.experiment import Run, Setup, run_experiment
from shared.figures import say

from clothtrack.files.extras import install_command


def plan(setup: Setup) -> list[Run]:
    """The peer with and without the tool; the dynamics alone; the default."""
    peer = PeerConfig(iterations=10, modes=60) if setup.smoke else PeerConfig()
    plain = Variant("drift and edge lengths", vertex_count=setup.vertices, peer=peer)
    variants = [
        plain,
        replace(plain, name="the same, blind to the tool", peer=replace(peer, use_tool=False)),
        setup.variant("open_loop", "open_loop"),
        setup.variant("default", "default"),
    ]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    if importlib.util.find_spec("biocpd") is None:
        say(f"the peer needs biocpd: {install_command('experiments')}\n")
        return 1
    return run_experiment("model_free", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
