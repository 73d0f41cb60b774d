"""Every kernel compiles for CUDA, on machines without a card too."""

import sys
from importlib import import_module
from pathlib import Path

import pytest
import warp as wp

import clothtrack

SOURCE = Path(clothtrack.__file__).parent
MODULES = sorted(
    ".".join((SOURCE.name, *path.relative_to(SOURCE).with_suffix("").parts))
    for path in SOURCE.rglob("*.py")
    if "\n@wp.kernel" in path.read_text(encoding="utf-8")
)
ARCHITECTURES = (75, 90)
"""A T4 and an H100: the oldest card that people still buy time on, and a new one."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "darwin", reason="Warp's build for macOS has no CUDA compiler")
@pytest.mark.parametrize("name", MODULES)
def test_kernels_compile_for_cuda(name, tmp_path):
    made = wp.compile_aot_module(import_module(name), arch=ARCHITECTURES, module_dir=tmp_path)
    assert len(made) == len(ARCHITECTURES)
    source = "".join(path.read_text(encoding="utf-8") for path in tmp_path.glob("*.cu"))
    kernels = (SOURCE.parent / name.replace(".", "/")).with_suffix(".py").read_text("utf-8")
    assert source.count("_cuda_kernel_forward(") >= kernels.count("\n@wp.kernel")
    assert all(path.stat().st_size > 0 for path in made)
