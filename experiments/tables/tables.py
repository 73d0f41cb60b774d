"""The tables of the experiments, rebuilt from their rows.

python experiments tables --rows OUT/experiments              all of them
python experiments tables --rows OUT/experiments table1 --markdown FILE
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import _path  # noqa: F401
from shared.bench_runs import read_rows
from shared.figures import say
from shared.tables import TITLES, markdown


def main(arguments: Sequence[str] | None = None) -> int:
    """Rebuild the tables that rows are there for; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("experiments", nargs="*", help=f"of {', '.join(TITLES)}; all by default")
    parser.add_argument("--rows", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--markdown", type=Path, help="write the tables to this file too")
    options = parser.parse_args(arguments)
    wanted = options.experiments or [
        name for name in TITLES if (options.rows / f"{name}.jsonl").exists()
    ]
    unknown = [
        name for name in wanted
        if name not in TITLES or not (options.rows / f"{name}.jsonl").exists()
    ]  # fmt: skip
    if unknown or not wanted:
        say(f"no rows of {', '.join(unknown) or 'any experiment'} in {options.rows}\n")
        return 1
    text = "\n".join(markdown(name, read_rows(options.rows / f"{name}.jsonl")) for name in wanted)
    say(text)
    if options.markdown is not None:
        options.markdown.parent.mkdir(parents=True, exist_ok=True)
        temporary = options.markdown.with_name(f".{options.markdown.name}.partial")
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(options.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
