"""A wheel holds all that clothtrack needs, away from the checkout that it was built from."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NO_SOURCE = shutil.ignore_patterns("__pycache__", "*.egg-info")


def done(command, folder):
    """Standard output of a command that must go well, without our source folder on its path."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    # From a copy: a build/ of an earlier day may hold files that are no longer there.
    copy = tmp_path_factory.mktemp("copy")
    shutil.copytree(ROOT / "src", copy / "src", ignore=NO_SOURCE)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    done([sys.executable, "-m", "pip", "wheel", ".", "--no-deps", "--wheel-dir", "dist"], copy)
    return next((copy / "dist").glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder with the commands of an environment that has the wheel and borrows what it needs."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps"]
    done([*pip, str(wheel)], folder)
    site = Path(
        done(
            [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder
        ).strip()
    )
    # Folders named here are searched last, and .pth files in them (our own checkout's) not read.
    borrowed = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "borrowed.pth").write_text("\n".join(borrowed))
    return folder / "bin"


def test_a_wheel_holds_every_file_of_the_package(wheel):
    listed = subprocess.run(
        ["git", "ls-files", "src"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    held = {f"src/{name}" for name in zipfile.ZipFile(wheel).namelist()}
    # What a training goes on from is nobody's to use.
    assert set(listed) - held <= {"src/clothtrack/reconstruction/weights/next.safetensors"}


def test_the_demo_runs_from_a_wheel_and_writes_its_report(installed, tmp_path):
    where = "import clothtrack; print(clothtrack.__file__)"
    assert str(installed.parent) in done([installed / "python", "-c", where], tmp_path)
    assert "demo" in done([installed / "clothtrack", "--help"], tmp_path)
    told = done([installed / "clothtrack", "demo"], tmp_path)
    report = next((tmp_path / "out" / "demo").glob("*.html"))
    assert f"report   {report.relative_to(tmp_path)}" in told
    assert "</html>" in report.read_text(encoding="utf-8")


def test_a_copy_from_a_wheel_names_it_where_an_extra_is_missing(installed, wheel, tmp_path):
    asked = "from clothtrack.files.extras import install_command; print(install_command('learn'))"
    assert f"{wheel}[learn]" in done([installed / "python", "-c", asked], tmp_path)
