"""Run one experiment, from any folder.

    python experiments                      the list, which is README.md
    python experiments NAME [OPTION ...]    one of its scripts; NAME --help for options

Python searches for imports next to this file, so scripts share modules by their full names (`from
shared.bench_runs import Task`) and nothing has to be installed.
"""

import sys
from importlib import import_module
from pathlib import Path

from shared.figures import say

from clothtrack.files.extras import install_command

HERE = Path(__file__).parent
FOLDERS = ("tables", "figures", "real")


def scripts() -> dict[str, str]:
    """Return the module of every script by its name; scripts are the files with a `main`."""
    return {
        file.stem: f"{folder}.{file.stem}"
        for folder in FOLDERS
        for file in sorted((HERE / folder).glob("[!_]*.py"))
        if "\ndef main(" in file.read_text(encoding="utf-8")
    }


def main() -> int | None:
    """Run the script that the command line names; returns its exit code."""
    name, *options = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        say((HERE / "README.md").read_text(encoding="utf-8"))
        return 0
    known = scripts()
    if name not in known:
        sys.stderr.write(f"there is no experiment {name!r}; known are {', '.join(known)}\n")
        return 2
    sys.argv = [f"experiments {name}", *options]
    sys.path.append(str(HERE / FOLDERS[0]))
    try:
        return import_module(known[name]).main()
    except ModuleNotFoundError as error:
        missing = str(error.name).partition(".")[0]
        if missing.startswith("clothtrack") or (HERE / missing).exists():
            raise
        sys.stderr.write(
            f"experiments {name} needs {missing}, which tracking does not; install with: "
            f"{install_command('experiments')}\n"
        )
        return 1


if __name__ == "__main__":
    sys.exit(main())
