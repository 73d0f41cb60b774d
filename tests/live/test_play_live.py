"""`clothtrack live` plays a recording at the speed of its clock and leaves a trajectory."""

import time
from dataclasses import replace

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.cli.command_line import main
from clothtrack.recordings.store import write_recording


@pytest.fixture
def short(film, tmp_path):
    """The first action of the recording."""
    recording = film.recording
    action = recording.actions[0]
    frames = recording.frames[: action.last_frame + 1]
    return write_recording(
        replace(recording, actions=(action,), frames=frames), tmp_path / "short"
    ).folder


def test_it_takes_the_time_of_the_recording_and_writes_what_load_reads(short, tmp_path, capsys):
    recording = ct.read_recording(short)
    begun_s = time.monotonic()
    assert main(["live", str(short), "--output", str(tmp_path / "out")]) == 0
    assert time.monotonic() - begun_s > recording.frames[-1].time_s
    said = capsys.readouterr().out
    assert "ms median" in said
    assert "dropped" in said
    run = ct.load(tmp_path / "out" / "short.zarr", short)
    assert len(run.frames) == len(recording.frames)
    assert run.name == "short"
    assert np.isfinite(run.positions).all()
    assert run.config["search"]["method"] == "none"
    assert f"verdict  {run.verdict.word}" in said
    assert ct.evaluate(run).rows


def test_a_result_that_is_there_is_not_replaced(short, tmp_path):
    (tmp_path / "short.zarr").mkdir()
    with pytest.raises(ct.InvalidConfigError, match="is there already"):
        ct.play_live(short, output=tmp_path)
