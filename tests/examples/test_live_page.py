"""The Python of docs/live.md runs as it is printed, from the first block to the last."""

import re
from pathlib import Path

import clothtrack as ct

PAGE = Path(__file__).parents[2] / "docs" / "live.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_page_can_be_followed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    controller, *others = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert len([line for line in controller.splitlines() if line]) <= 15
    names: dict = {}
    for block in (controller, *others):
        exec(compile(block, str(PAGE), "exec"), names)
    run = ct.load(tmp_path / "live.zarr", names["recording"])
    assert len(run.frames) == 12
    assert run.actions[0].held_vertices["gripper"]
    assert names["state"].acting
    assert "LiveState(" in capsys.readouterr().out
