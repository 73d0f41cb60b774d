"""Check that inputs that contradict each other are found, over random strengths.

Claim judged: each kind of contradiction (color against depth, clock, masks, actions, template,
lens) is found in ten random strengths, and no right recording is accused.

    python experiments sense_checks --recordings DIR [DIR ...] --json OUT

The recordings are those of `clothtrack simulate`, and any others with color that are known to be
right; the draws go round them. `--smoke` films one small towel and draws each kind once.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from shared.figures import say, write_json
from shared.wrong_senses import SENSE_KINDS, SenseKind

from clothtrack.geometry import quiet_warp
from clothtrack.recordings import Recording, read_recording
from clothtrack.recordings.geometry_checks.action_checks import action_findings
from clothtrack.recordings.geometry_checks.all_checks import check_geometry, sense_findings
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures, small_pictures
from clothtrack.recordings.geometry_checks.tip_checks import motion_findings
from clothtrack_lab.world import SMALL_WORLD, simulate
from tables.geometry_checks import recordings_in

DRAWS = 10

Right = tuple[Recording, SmallPictures]


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the right recordings, then spoilt ones, and print the table."""
    options = parse(arguments)
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="sense-checks-") as temporary:
        folders = options.recordings
        if options.smoke:
            folders = [
                simulate(Path(temporary) / "world", "towel", 1, config=SMALL_WORLD)[0].parent
            ]
        recordings = [read_recording(each) for one in folders for each in recordings_in(one)]
        report: dict[str, Any] = {
            "right": {each.name: [f.text for f in check_geometry(each)] for each in recordings},
            "wrong": [],
        }
        seen = [(each, small_pictures(each)) for each in recordings]
        right = [
            (each, small) for each, small in seen if small is not None and small.color is not None
        ]
        for kind in SENSE_KINDS:
            report["wrong"].append(row(kind, right, 1 if options.smoke else options.draws))
            if options.json is not None:
                write_json(options.json, report)
    say(markdown(report))
    return 0


def row(kind: SenseKind, right: Sequence[Right], draws: int) -> dict[str, Any]:
    """Return how often a kind is found, and by what."""
    usable = [each for each in right if needed(kind, *each)]
    by: Counter[str] = Counter()
    found = named = 0
    for draw in range(draws if usable else 0):
        recording, small = usable[draw % len(usable)]
        rng = np.random.default_rng(draw)
        wrong, seen = kind.spoil(recording, small, rng)
        kinds = {
            each.kind
            for each in [
                *sense_findings(wrong, seen),
                *action_findings(wrong),
                *motion_findings(wrong, seen),
            ]
        }
        found += bool(kinds)
        named += bool(kinds & set(kind.kinds))
        by.update(kinds)
    return {
        "wrong": kind.text, "draws": draws if usable else 0, "found": found, "named": named,
        "by": dict(by),
    }  # fmt: skip


def needed(kind: SenseKind, recording: Recording, small: SmallPictures) -> bool:
    """Return whether a recording has what a kind spoils."""
    text = kind.text
    colored = small.mask is not None or recording.cloth.color is not None
    if "mask" in text or "picture" in text:
        return (colored and small.mask is not None) or ("with another" in text and colored)
    if "template" in text:
        return recording.cloth.template is not None
    if "action" in text or "carry" in text or "path" in text:
        return bool(recording.actions) and not recording.cloth.held_vertices
    return True


def markdown(report: dict[str, Any]) -> str:
    """Found and named of each kind, and the right recordings that were accused."""
    lines = ["| wrong | found | kind named | by |", "|---|---:|---:|---|"]
    for each in report["wrong"]:
        shown = ", ".join(f"{name} {count}" for name, count in each["by"].items())
        lines.append(
            f"| {each['wrong']} | {each['found']} of {each['draws']} | {each['named']} | {shown} |"
        )
    accused = {name: texts for name, texts in report["right"].items() if texts}
    lines += ["", f"of {len(report['right'])} right recordings {len(accused)} are accused."]
    lines += [f"- {name}: {text}" for name, texts in accused.items() for text in texts]
    return "\n".join(lines) + "\n"


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=Path, nargs="+", help="folders of right recordings")
    parser.add_argument("--draws", type=int, default=DRAWS, help="per kind")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--smoke", action="store_true", help="one small towel, one draw")
    options = parser.parse_args(arguments)
    if not options.recordings and not options.smoke:
        parser.error("give --recordings DIR (clothtrack simulate makes some), or --smoke")
    return options


if __name__ == "__main__":
    sys.exit(main())
