"""Check whether a code change keeps tracked results to the last bit, and compare the speed.

Tracks recordings in every mode with two checkouts in turn and compares the positions, frame by
frame, and the CPU time of each run. A refactoring must leave every row at 0; for an intended change
the rows show its size.

    python experiments same_bits --before CHECKOUT --after CHECKOUT --json OUT RECORDING...

Finished results next to OUT are kept, so the same command resumes after an interrupt.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import _path  # noqa: F401
import numpy as np
import zarr
from shared.figures import say

MODES = ("default", "paper", "open_loop")
RUN = "import sys; from clothtrack.cli import main; sys.exit(main())"


def track(checkout: Path, recording: Path, mode: str, output: Path) -> None:
    """Track one recording with the code of a checkout, unless that was done before."""
    if (output / f"{recording.name}.zarr").exists():
        return
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout.resolve() / "src"),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    words = ["track", str(recording), "--output", str(output), "--mode", mode]
    before = os.times()
    subprocess.run([sys.executable, "-c", RUN, *words], env=environment, check=True)
    after = os.times()
    spent = after.children_user + after.children_system
    spent -= before.children_user + before.children_system
    (output / f"{recording.name}.cpu_s").write_text(f"{spent:.2f}\n", encoding="utf-8")


def compared(recording: Path, mode: str, before: Path, after: Path) -> dict[str, object]:
    """Return the difference of two results of a recording and mode [m], and CPU times [s]."""
    positions, spent = [], []
    for output in (before, after):
        group = zarr.open_group(output / f"{recording.name}.zarr", mode="r")
        positions.append(np.asarray(group["positions"]))
        spent.append(float((output / f"{recording.name}.cpu_s").read_text(encoding="utf-8")))
    same = np.array_equal(*positions)
    return {
        "recording": recording.name,
        "mode": mode,
        "same_bits": same,
        "largest_m": float(np.abs(positions[0] - positions[1]).max()),
        "cpu_s_before": spent[0],
        "cpu_s_after": spent[1],
    }


def main() -> int:
    """Run both checkouts in turn, print a row per recording and mode; 1 when a bit differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--before", required=True, type=Path, help="checkout before the change")
    parser.add_argument("--after", required=True, type=Path, help="checkout after it")
    parser.add_argument("--json", required=True, type=Path, help="the rows; results lie beside it")
    parser.add_argument("--modes", nargs="+", default=MODES, choices=MODES)
    options = parser.parse_args()
    rows = []
    for recording in options.recordings:
        for mode in options.modes:
            outputs = []
            for name in ("before", "after"):
                output = options.json.parent / name / mode
                output.mkdir(parents=True, exist_ok=True)
                track(getattr(options, name), recording, mode, output)
                outputs.append(output)
            row = compared(recording, mode, *outputs)
            rows.append(row)
            say(
                f"{row['recording']:<24}{row['mode']:<28}"
                f"{'same bits' if row['same_bits'] else 'DIFFERENT'}  {row['largest_m']:.1e} m"
                f"  CPU {row['cpu_s_after'] / row['cpu_s_before']:.2f} of before"
            )
    text = json.dumps({"made": time.strftime("%Y-%m-%d"), "rows": rows}, indent=2)
    options.json.write_text(text + "\n", encoding="utf-8")
    return 0 if all(row["same_bits"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
