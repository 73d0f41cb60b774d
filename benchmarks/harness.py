"""What every benchmark shares: its command line, its JSON file, and the table that it prints."""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from clothtrack.geometry.devices import quiet_warp

PACKAGES = (
    "numpy", "scipy", "warp-lang", "opencv-python-headless", "mujoco-core", "newton", "torch"
)  # fmt: skip
Row = Mapping[str, object]


def run_benchmark(
    name: str, document: str, measure: Callable[[Path, bool], Mapping[str, object]]
) -> None:
    """Measure in an empty folder, quickly or not; write the result, and print its rows."""
    parser = argparse.ArgumentParser(description=document.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="where the result goes")
    parser.add_argument("--quick", action="store_true", help="the smallest sizes, once")
    options = parser.parse_args()
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix=f"bench-{name}-") as folder:
        result = measure(Path(folder), options.quick)
    content = {"benchmark": name, **result, "provenance": provenance()}
    options.json.parent.mkdir(parents=True, exist_ok=True)
    part = options.json.with_name(options.json.name + ".part")
    part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    part.replace(options.json)
    sys.stdout.write(table(result["rows"]))


def timed(work: Callable[[], object], repeats: int = 1) -> tuple[float, object]:
    """Return the median CPU time of some repeats [s], and the last result."""
    spent, result = [], None
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        spent.append(time.process_time() - start)
    return float(np.median(spent)), result


def spread(seconds: Sequence[float]) -> dict[str, float]:
    """Return the median and what 95 % stay below [s]."""
    median, most = np.percentile(seconds, [50, 95]).tolist()
    return {"median_s": median, "p95_s": most}


def table(rows: object) -> str:
    """Return the rows as text: a line for each measure, a column for each row."""
    assert isinstance(rows, list)
    columns = [flat(row) for row in rows]
    names = dict.fromkeys(name for column in columns for name in column)
    width = max(map(len, names))
    lines = [
        f"{name:<{width}} " + " ".join(f"{_shown(column.get(name)):>14}" for column in columns)
        for name in names
    ]
    return "\n".join(lines) + "\n"


def flat(row: Row) -> dict[str, object]:
    """Return a row whose groups are named GROUP.MEASURE."""
    found: dict[str, object] = {}
    for name, value in row.items():
        inner = flat(value) if isinstance(value, Mapping) else {"": value}
        found |= {f"{name}.{key}".rstrip("."): each for key, each in inner.items()}
    return found


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)


def provenance() -> dict[str, object]:
    """Return processor, versions and commit."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "machine": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "python": platform.python_version(),
        "packages": versions,
        "commit": _commit(),
    }


def _processor() -> str:
    """Return the processor's name as reported by Linux."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def _commit() -> str:
    """Return the commit of the checkout, with a mark when files differ from it."""
    asked = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return asked.stdout.strip()
