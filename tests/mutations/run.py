"""Break the source in one place after another; the named tests must notice each.

    python tests/mutations/run.py                 all of mutations.toml; 1 when one survives
    python tests/mutations/run.py --only solver   those whose file or text has this word

Each mutation is one line of `mutations.toml`: the file, its text, the text in its place, the tests.
They are applied to a copy of this checkout. Where a change of the source has moved the text, name
the new one: the place, not the text, is what is protected.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
COPIED = ("src", "tests", "experiments", "examples", "docs", "pyproject.toml")
LONGEST_S = 600


def mutations() -> list[dict]:
    """Return all mutations: file, old, new, tests."""
    return tomllib.loads(Path(__file__).with_name("mutations.toml").read_text("utf-8"))["mutation"]


def misplaced(one: dict) -> str:
    """Return why a mutation cannot be applied to this checkout; empty when it can."""
    file = ROOT / one["file"]
    count = file.read_text("utf-8").count(one["old"]) if file.is_file() else 0
    if count != 1:
        return f"{one['file']} has this text {count} times instead of once: {one['old']}"
    missing = [test for test in one["tests"] if not (ROOT / test.split("::")[0]).is_file()]
    return f"there is no {missing[0]}" if missing else ""


def tested(copy: Path, tests: list[str], longest_s: float | None) -> tuple[int, str]:
    """Return the exit code of the tests in a copy, and the end of what they print."""
    command = [sys.executable, "-m", "pytest", "-qxm", "not gpu", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(copy / "src"), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [*command, *tests], cwd=copy, env=environment, capture_output=True, text=True,
            timeout=longest_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 1, f"no end within {longest_s} s"
    return done.returncode, "\n".join(done.stdout.strip().splitlines()[-3:])


def outcome(copy: Path, one: dict) -> str:
    """Apply a mutation to the copy, test, take it back; return what came of it."""
    if problem := misplaced(one):
        return problem
    file = copy / one["file"]
    right = file.read_text("utf-8")
    try:
        file.write_text(right.replace(one["old"], one["new"]), encoding="utf-8")
        forget_bytecode(file)
        code, said = tested(copy, one["tests"], LONGEST_S)
    finally:
        file.write_text(right, encoding="utf-8")
        forget_bytecode(file)
    return {0: "SURVIVED", 1: "caught"}.get(code, f"its tests do not run:\n{said}")


def forget_bytecode(file: Path) -> None:
    """Remove what Python has compiled of a file: two versions of one second look alike to it."""
    for compiled in (file.parent / "__pycache__").glob(f"{file.stem}.*"):
        compiled.unlink()


def main() -> int:
    """Run the unbroken tests first, then every mutation; 1 unless all are caught."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="word of the file or of the text")
    word = parser.parse_args().only
    chosen = [one for one in mutations() if word in one["file"] + one["old"]]
    with tempfile.TemporaryDirectory(prefix="mutations") as folder:
        copy = Path(folder)
        left_out = shutil.ignore_patterns("__pycache__")
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, copy / name, ignore=left_out)
            else:
                shutil.copy(source, copy / name)
        unbroken = sorted({test for one in chosen for test in one["tests"]})
        code, said = tested(copy, unbroken, None) if chosen else (1, f"{word!r} names none")
        if code:
            sys.stderr.write(f"the tests fail without any mutation:\n{said}\n")
            return 1
        caught = 0
        for number, one in enumerate(chosen, start=1):
            before = time.monotonic()
            result = outcome(copy, one)
            caught += result == "caught"
            sys.stdout.write(
                f"{number:3d} {time.monotonic() - before:5.1f} s  {result:<9} {one['file']}  "
                f"{one['old']}  ->  {one['new']}\n"
            )
            sys.stdout.flush()
    sys.stdout.write(f"{caught} of {len(chosen)} are caught\n")
    return 0 if caught == len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
