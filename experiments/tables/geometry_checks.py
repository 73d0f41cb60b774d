"""Check that wrong geometry is found and right geometry is accepted.

Claim judged: each of 20 kinds of wrong geometry is found by `clothtrack inspect` on each of three
recordings, and no right recording is accused, neither as it is nor, where its cloth lies flat at
first, without its template.

    python experiments geometry_checks --recordings DIR [DIR ...] --json OUT

The recordings are those of `clothtrack simulate`, and any others that are known to be right. The
wrong ones are copies of the first three that have a table, a template, a size and two actions or
more (`--spoil NAME ...` names others). What the format's own checks refuse counts as found.
`--smoke` films one small towel.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _path  # noqa: F401
from shared.figures import say, write_json
from shared.wrong_geometry import KINDS, spoilt

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry import quiet_warp
from clothtrack.recordings import Recording, read_recording
from clothtrack.recordings.geometry_checks.all_checks import check_geometry
from clothtrack.recordings.geometry_checks.cloth_checks import cloth_findings
from clothtrack.recordings.geometry_checks.finding import ObservedFrames
from clothtrack_lab.world import SMALL_WORLD, simulate

SPOILT = 3
"""Recordings that every kind of wrong geometry is tried on."""

Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Check every right recording and every spoilt copy, and print both tables."""
    options = parse(arguments)
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="geometry-checks-") as temporary:
        folders = options.recordings
        if options.smoke:
            config = replace(SMALL_WORLD, actions=2)
            folders = [simulate(Path(temporary) / "world", "towel", 1, config=config)[0].parent]
        right = [read_recording(folder) for one in folders for folder in recordings_in(one)]
        if not right:
            sys.stderr.write("no recordings; clothtrack simulate makes some\n")
            return 1
        report: dict[str, Any] = {"right": [], "bare": [], "wrong": []}
        for recording in right:
            report["right"].append(looked_at(recording.folder, "right", ""))
            if recording.cloth.size_m is not None:
                report["bare"].append(without_template(recording))
            keep(report, options.json)
        for kind in KINDS:
            for recording in chosen(right, options.spoil):
                folder = spoilt(recording, kind, Path(temporary) / kind.name / recording.name)
                report["wrong"].append(looked_at(folder, kind.name, kind.field))
                keep(report, options.json)
    say(markdown(report))
    return 0


def recordings_in(folder: Path) -> list[Path]:
    """Return the recording that a folder is, or those that lie in it."""
    if (folder / "recording.json").exists():
        return [folder]
    return sorted(path.parent for path in folder.glob("*/recording.json"))


def chosen(right: Sequence[Recording], names: Sequence[str] | None) -> Iterator[Recording]:
    """Yield the recordings to spoil."""
    if names:
        yield from (recording for recording in right if recording.name in names)
        return
    complete = [
        recording
        for recording in right
        if len(recording.actions) > 1
        and recording.table is not None
        and recording.cloth.template is not None
        and recording.cloth.size_m is not None
    ]
    yield from complete[:SPOILT]


def looked_at(folder: Path, kind: str, field: str) -> Row:
    """Return what `inspect` finds in a recording; `named`: it says which field was spoilt."""
    row: Row = {"recording": folder.name, "kind": kind}
    try:
        findings = check_geometry(read_recording(folder))
    except InvalidRecordingError as error:
        return {**row, "checks": ["refused"], "named": field in str(error), "text": [str(error)]}
    return {
        **row,
        "checks": [finding.kind for finding in findings],
        "named": any(field in finding.field + finding.text for finding in findings),
        "text": [finding.text for finding in findings],
    }


def without_template(recording: Recording) -> Row:
    """Return the findings in a right recording of a flat cloth without its template."""
    cloth = replace(recording.cloth, template=None, held_vertices={})
    findings = cloth_findings(replace(recording, cloth=cloth), ObservedFrames(recording))
    return {
        "recording": recording.name,
        "kind": "bare",
        "checks": [finding.kind for finding in findings],
        "text": [finding.text for finding in findings],
    }


def keep(report: dict[str, Any], path: Path | None) -> None:
    """Write what there is so far."""
    if path is not None:
        write_json(path, report)


def markdown(report: dict[str, Any]) -> str:
    """Found of each kind, and the right recordings that were accused."""
    lines = ["| wrong | found | field named | by |", "|---|---:|---:|---|"]
    for kind in KINDS:
        rows = [row for row in report["wrong"] if row["kind"] == kind.name]
        found = sum(bool(row["checks"]) for row in rows)
        named = sum(bool(row["named"]) for row in rows)
        by = Counter(check for row in rows for check in row["checks"])
        shown = ", ".join(f"{check} {count}" for check, count in by.most_common())
        lines.append(f"| {kind.text} | {found} of {len(rows)} | {named} | {shown} |")
    accused = [row for row in [*report["right"], *report["bare"]] if row["checks"]]
    found = sum(bool(row["checks"]) for row in report["wrong"])
    lines += [
        "",
        f"{found} of {len(report['wrong'])} wrong recordings are found; "
        f"of {len(report['right'])} right ones, {len(report['bare'])} of them once more without "
        f"their template, {len(accused)} are accused.",
        *(f"- {row['recording']}: {text}" for row in accused for text in row["text"]),
    ]
    return "\n".join(lines) + "\n"


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=Path, nargs="+", help="folders of right recordings")
    parser.add_argument("--spoil", nargs="+", metavar="NAME", help="recordings to spoil")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--smoke", action="store_true", help="one small towel")
    options = parser.parse_args(arguments)
    if not options.recordings and not options.smoke:
        parser.error("give --recordings DIR (clothtrack simulate makes some), or --smoke")
    return options


if __name__ == "__main__":
    sys.exit(main())
