import re
import shutil
import subprocess
import sys

import av
import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, StorageError
from clothtrack.files.extras import install_command
from clothtrack.report.exports import export_pictures
from clothtrack.report.rerun_file import write_rerun


def test_a_sheet_has_as_many_rows_as_asked_for(tracked, two_cameras, tmp_path):
    heights = []
    for rows in (2, 4):
        path = export_pictures(tracked, two_cameras, tmp_path / f"s{rows}", "sheet", rows=rows)
        assert path == tmp_path / f"s{rows}.png"
        heights.append(cv2.imread(str(path)).shape[0])
    assert heights[1] == 2 * heights[0]


def test_a_video_has_every_frame(tracked, clouds_only, tmp_path):
    path = export_pictures(tracked, clouds_only, tmp_path / "fold.mp4", "mp4")
    with av.open(str(path)) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(pictures) == len(tracked.frames)
    assert np.abs(pictures[0].astype(int) - pictures[-1]).mean() > 2


def test_a_place_that_cannot_be_written_to_is_named(tracked, clouds_only, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        export_pictures(tracked, clouds_only, tmp_path / "file" / "x", "mp4")


def test_without_the_extra_rerun_is_named(tracked, clouds_only, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InvalidConfigError, match=re.escape(install_command("rerun"))):
        write_rerun(tracked, clouds_only, tmp_path / "fold.rrd", clouds=[])
    assert list(tmp_path.iterdir()) == []


def test_rerun_reads_what_was_written_without_a_warning(tracked, two_cameras, tmp_path, capfd):
    pytest.importorskip(
        "rerun",
        reason="writing .rrd needs rerun-sdk and its pyarrow: make EXTRAS=rerun install",
        exc_type=ImportError,
    )
    path = export_pictures(tracked, two_cameras, tmp_path / "fold", "rrd")
    assert capfd.readouterr().err == ""
    assert path == tmp_path / "fold.rrd"
    assert path.stat().st_size > 10_000
    program = shutil.which("rerun", path=str(sys.executable).rpartition("/")[0])
    if program is None:
        pytest.skip("reading .rrd back needs the program rerun, which lies beside another Python")
    told = subprocess.run(
        [program, "rrd", "print", str(path)],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    for entity in ("/world/cloth", "/world/cloth_cloud", "/world/observed", "/camera/top"):
        assert entity in told.stdout, told.stdout[:2000]
