"""What a name ends in says the format; a format that contradicts it is refused before any work."""

from pathlib import Path

import pytest

from clothtrack.api.export_format import export_format
from clothtrack.errors import InvalidConfigError


@pytest.mark.parametrize(
    ("name", "wanted", "format_"),
    [
        ("my.mp4", None, "mp4"),
        ("out/my.PNG", None, "sheet"),
        ("my.npz", None, "npz"),
        ("meshes", None, "obj"),
        ("meshes", "ply", "ply"),
        ("sheet", "sheet", "sheet"),
        ("out/run.2", None, "obj"),
    ],
)
def test_the_suffix_decides(name, wanted, format_):
    assert export_format(Path(name), wanted) == format_


@pytest.mark.parametrize(
    ("name", "wanted", "told"),
    [
        ("my.mp4", "npz", "--format npz contradicts .mp4, which is mp4"),
        ("my.npz", "obj", "--format obj contradicts .npz"),
        ("my.obj", None, "obj is one file per frame, in a folder; leave out .obj"),
        ("my.ply", "ply", "leave out .ply and add --format ply"),
        ("my.avi", "mp4", "nothing is exported as .avi; end the name in .npz, .png, .mp4"),
        ("my.gif", None, "nothing is exported as .gif"),
        ("my", "gif", "format is 'gif'; choose one of obj"),
    ],
)
def test_a_mismatch_is_refused(name, wanted, told):
    with pytest.raises(InvalidConfigError, match=told):
        export_format(Path(name), wanted)
