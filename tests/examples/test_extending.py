"""The Python of docs/extending.md runs as it is printed, from the first block to the last."""

import re
from pathlib import Path

import clothtrack as ct

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_page_can_be_followed(napkin, monkeypatch, capsys):
    # The page takes the shipped recording; a smaller one says the same sooner.
    monkeypatch.setattr(ct, "shipped_recording", lambda: napkin, raising=False)
    names: dict = {}
    for block in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        exec(compile(block, str(PAGE), "exec"), names)
    assert callable(names["my_segmenter"])
    assert capsys.readouterr().out.count("mm from the cloud") == 2
    # Both follow the cloth, and not in the same way.
    mine, ours = names["mine"].positions, names["ours"].positions
    assert 1e-4 < abs(mine - ours).max() < 0.05
