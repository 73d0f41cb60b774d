import importlib.metadata
import json
import shlex
import sys

import pytest

from clothtrack.files.extras import install_command


class Installed:
    def __init__(self, noted):
        self._noted = noted

    def read_text(self, name):
        assert name == "direct_url.json"
        return self._noted


@pytest.fixture
def installed(monkeypatch):
    """Have pip's note about this copy say something else."""

    def note(origin):
        text = None if origin is None else json.dumps(origin)
        monkeypatch.setattr(importlib.metadata, "distribution", lambda _: Installed(text))

    return note


def test_an_editable_copy_is_extended_where_its_checkout_lies(installed, tmp_path):
    checkout = tmp_path / "a checkout"
    checkout.mkdir()
    (checkout / "constraints.txt").touch()
    installed({"url": checkout.as_uri(), "dir_info": {"editable": True}})
    assert shlex.split(install_command("learn")) == [
        sys.executable, "-m", "pip", "install",
        "-c", str(checkout / "constraints.txt"), "-e", f"{checkout}[learn]",
    ]  # fmt: skip


def test_a_copy_from_a_wheel_is_extended_from_that_file(installed, tmp_path):
    wheel = tmp_path / "clothtrack-0.1.0-py3-none-any.whl"
    wheel.touch()
    installed({"url": wheel.as_uri(), "archive_info": {}})
    assert shlex.split(install_command("learn"))[3:] == ["install", f"{wheel}[learn]"]


@pytest.mark.parametrize(
    "origin",
    [None, {"url": "file:///no/such/folder", "dir_info": {}}, {"url": "https://example.org/c.whl"}],
)
def test_a_copy_of_unknown_origin_is_extended_in_a_checkout(installed, origin):
    installed(origin)
    assert install_command("learn") == "make learn (in a checkout of clothtrack)"
    assert install_command("ray") == "make EXTRAS=ray install (in a checkout of clothtrack)"
