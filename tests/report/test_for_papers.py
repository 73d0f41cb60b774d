import av
import cv2
import numpy as np
import pytest

from clothtrack.errors import StorageError
from clothtrack.report.exports import export_pictures


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
