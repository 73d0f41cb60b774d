"""The fronts: every name is there, none is heavy, and what is tracked comes back as it was."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import clothtrack

FRONTS = ["clothtrack", "clothtrack_capture", "clothtrack_lab"]
HEAVY = ("cv2", "jaxtyping", "mujoco", "numpy", "scipy", "torch", "warp", "zarr")


@pytest.mark.parametrize("front", FRONTS)
def test_every_name_of_a_front_is_there_and_listed_once(front):
    module = import_module(front)
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    assert dir(module) == sorted(module.__all__)


@pytest.mark.parametrize("front", FRONTS)
def test_a_front_lists_what_it_imports(front):
    module = import_module(front)
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imported = {name.asname or name.name for one in block.body for name in one.names}
    assert imported == set(module.__all__) - {"__version__"}


@pytest.mark.parametrize("front", FRONTS)
def test_no_name_of_a_front_is_also_a_module_beside_it(front):
    """Python would give the module or the function, whichever was imported last."""
    module = import_module(front)
    beside = {path.stem for path in Path(module.__file__).parent.iterdir()}
    assert not beside & set(module.__all__)


def test_a_name_that_a_front_lacks_is_refused_with_the_name():
    with pytest.raises(AttributeError, match="'clothtrack' has no attribute 'trak'"):
        clothtrack.trak  # noqa: B018


@pytest.mark.parametrize("front", FRONTS)
def test_importing_a_front_loads_nothing_heavy(front):
    script = f"import sys, {front}\nprint(*sorted(sys.modules))"
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not set(HEAVY) & set(loaded)
    ours = [name for name in loaded if name.startswith("clothtrack")]
    assert len(ours) <= 4, ours


def test_the_help_of_the_command_line_loads_nothing_heavy():
    script = (
        "import sys\nfrom clothtrack.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print(*sorted(sys.modules), file=sys.stderr)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stderr.split()
    assert "clothtrack.cli.command_line" in loaded
    assert not set(HEAVY) & set(loaded)
