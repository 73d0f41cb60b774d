import resource

import av
import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, StorageError
from clothtrack.report.video import frame_rate, write_picture, write_video


def test_a_browser_gets_what_was_drawn(tmp_path):
    grays = [40, 90, 140, 190, 240]
    pictures = (np.full((61, 83, 3), gray, dtype=np.uint8) for gray in grays)
    assert write_video(pictures, tmp_path / "v.mp4", frames_per_second=12.5) == 5
    with av.open(str(tmp_path / "v.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == (84, 62)
        assert float(stream.average_rate) == 12.5
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    np.testing.assert_allclose([picture.mean() for picture in shown], grays, atol=4)


def test_no_picture_is_no_video(tmp_path):
    with pytest.raises(InvalidConfigError, match=r"v\.mp4"):
        write_video([], tmp_path / "v.mp4", frames_per_second=10.0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("times", "rate"),
    [(np.arange(9) / 30, 30.0), (np.arange(9) * 5.0, 2.0), (np.array([0.0]), 10.0)],
)
def test_the_video_runs_as_fast_as_the_recording(times, rate):
    assert frame_rate(times) == pytest.approx(rate)


def test_a_full_disk_is_one_error_and_nothing_said_besides(tmp_path, rng, capfd):
    picture = rng.integers(0, 256, (200, 300, 3), dtype=np.uint8)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(StorageError, match=r"sheet.* free some space"):
            write_picture(tmp_path / "sheet.png", picture)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""
