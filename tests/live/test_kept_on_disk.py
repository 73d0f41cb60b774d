"""What a live tracker keeps of hours lies on a disk, and is what it was when it is asked for."""

import gc
import tracemalloc

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.live.growing_frames import GrowingFrames
from clothtrack.live.growing_recording import GrowingPath
from clothtrack.recordings.recording import Frame
from clothtrack.tracking.recorder import MeshLog

CAMERA = Camera("top", 4, 3, 5.0, 5.0, 1.5, 1.0, np.eye(4))


def mesh(value):
    return np.full((2, 3), value, np.float32)


@pytest.mark.parametrize("on_disk", [False, True])
def test_a_log_of_meshes_is_overwritten_filled_and_read(on_disk):
    log = MeshLog(2, on_disk=on_disk)
    log.append(mesh(0))
    log.fill(1, 150, mesh(1))
    log.write(3, np.stack([mesh(3), mesh(4)]))
    log.append(mesh(9))
    assert len(log) == 151
    assert np.array_equal(log.newest(), mesh(9))
    values = log.meshes()[:, 0, 0]
    assert values.tolist() == [0, 1, 1, 3, 4, *[1] * 145, 9]
    read = log.meshes()
    read[:] = 7
    assert np.array_equal(log.meshes()[0], mesh(0))


def frame(index):
    rng = np.random.default_rng(index)
    return Frame.of_arrays(
        index, 0.1 * index, CAMERA, depth=rng.random((3, 4)).astype(np.float32),
        color=rng.integers(0, 255, (3, 4, 3), dtype=np.uint8), mask=rng.random((3, 4)) < 0.5,
    )  # fmt: skip


def test_pictures_that_are_put_away_come_back_and_forgotten_ones_do_not():
    frames = GrowingFrames()
    for index in range(5):
        frames.add(frame(index))
    frames.put_away(1, keep=True)
    frames.put_away(2, keep=False)
    frames.put_away(3, keep=True)
    assert [one.time_s for one in frames] == [0.1 * index for index in range(5)]
    for index in (0, 1, 3, 4, -1):
        back, made = frames[index], frame(index % 5)
        for kind in ("depth", "color", "mask"):
            here, there = getattr(back, kind)["top"], getattr(made, kind)["top"]
            assert here.dtype == there.dtype
            assert np.array_equal(here, there)
    assert not frames[2].depth
    assert [one.index for one in frames[1:4]] == [1, 2, 3]
    frames.take_back()
    assert len(frames) == 4
    with pytest.raises(IndexError):
        frames[4]


def test_a_path_grows_takes_no_older_sample_and_keeps_what_it_gave_away():
    path = GrowingPath()
    for index in range(200):
        assert path.add(0.1 * index, np.full(3, float(index)), index % 2 == 0)
    given = path.since(15.05)
    assert given.time_s[0] == pytest.approx(15.0)
    assert len(given.time_s) == 50
    assert not path.add(3.0, np.zeros(3), True)
    assert path.add(path.latest_s, np.full(3, -1.0), True)
    assert path.closed
    assert given.positions[-1].tolist() == [199] * 3
    assert path.since(np.inf).positions.tolist() == [[-1.0] * 3]
    assert len(path.since(-np.inf).time_s) == 200


@pytest.mark.slow
def test_memory_does_not_grow_with_the_pictures(film):
    tracker = film.tracker()
    picture, count = film.picture(0), 80

    def known(last):
        for index in range(last - count, last):
            tracker.update(**(picture | {"time_s": 0.1 * index, "picker": None}))
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        known(count)
        before = known(2 * count)
        grown = known(3 * count) - before
    finally:
        tracemalloc.stop()
    # The time of a picture, and what the judge leaves; its mesh alone has 12 bytes a vertex.
    assert grown / count < 2 * tracker.mesh.vertex_count
    assert len(tracker.close().frames) == 3 * count
