"""The command line: one verb per stage, in the order of the method.

A verb parses its options, calls what `import clothtrack` offers or one function of a room, and says
what came of it. The stages are imported when their verb is called, so that `--help` is instant.
Exit codes: 0 done, 1 bad input, a full disk or an interrupt (one clear line on standard error), 2
wrong usage.
"""

import logging
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes

from clothtrack.cli.act import flatten, improve, train_dynamics
from clothtrack.cli.capture import (
    calibrate_camera,
    calibrate_hand_eye,
    find_picker,
    record,
    segment,
)
from clothtrack.cli.garment import garment
from clothtrack.cli.learn import finetune, label, pretrain, reconstruct
from clothtrack.cli.look import evaluate, export, view
from clothtrack.cli.recordings import import_, inspect
from clothtrack.cli.simulate import bench, simulate
from clothtrack.cli.terminal import exit_code
from clothtrack.cli.track import demo, track

VERBS: tuple[Callable[..., int], ...] = (
    demo, inspect, import_, record, calibrate_camera, calibrate_hand_eye, segment, find_picker,
    garment, simulate, bench, track, label, pretrain, finetune, reconstruct, flatten,
    train_dynamics, improve, evaluate, view, export,
)  # fmt: skip
"""The functions behind the verbs, in the order of the README."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        arguments: the words after `clothtrack`; those of the process by default.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    level = logging.INFO if "--verbose" in words else logging.WARNING
    words = [word for word in words if word != "--verbose"]
    logging.basicConfig(level=level, stream=sys.stderr, format="%(levelname)s %(message)s")
    return exit_code(
        lambda: tyro.extras.subcommand_cli_from_dict(
            {verb.__name__.replace("_", "-"): _quietly(verb) for verb in VERBS},
            prog="clothtrack",
            description=(
                "Know where every point of a crumpled cloth is, from one depth camera. "
                "Any verb takes --verbose."
            ),
            args=words,
            config=(FlagCreatePairsOff, OmitArgPrefixes),
        )
    )


def _quietly(verb: Callable[..., int]) -> Callable[..., int]:
    """Tell Warp first not to greet on standard output, where our results go."""

    @wraps(verb)
    def run(*arguments: Any, **options: Any) -> int:
        from clothtrack.geometry.devices import quiet_warp

        quiet_warp()
        return verb(*arguments, **options)

    return run
