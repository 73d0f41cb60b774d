"""What `view` and `export` are given decides what they show; one clear line where it cannot be."""

import json
import signal
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.evaluation.label_review import LabelReview, review_path
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.mesh_file import write_mesh
from clothtrack.recordings.recording import ClothDescription
from clothtrack.recordings.store import RecordingWriter
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

POSE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]])
CAMERA = Camera("top", 96, 72, 90.0, 90.0, 47.5, 35.5, POSE)
TOWEL = garment("towel", vertex_count=80, size_m=(0.2, 0.2))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A recording of a towel that is lifted a little, and two tracked trajectories of it."""
    folder = tmp_path_factory.mktemp("world")
    states = [TOWEL.vertices + (0.0, 0.0, 0.004 + 0.01 * step) for step in range(3)]
    with RecordingWriter(
        folder / "recordings" / "lift", [CAMERA], {"top": 1e-4}, cloth=ClothDescription("towel")
    ) as writer:
        for step, vertices in enumerate(states):
            drawn = Rasterizer(TOWEL.faces, CAMERA).render(vertices)
            seen = drawn.faces >= 0
            depth = np.where(seen, drawn.depth, 0.6).astype(np.float32)
            writer.add_frame(0.1 * step, depth={"top": depth}, mask={"top": seen})
    none = Calibration("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)
    action = TrackedAction(0, 2, states[2], states[2], np.zeros(2), {}, none, {})
    tracked = TrackedTrajectory(
        name="lift",
        mesh=TOWEL,
        frames=np.arange(3),
        time_s=np.arange(3) / 10,
        positions=np.stack(states).astype(np.float32),
        visible=np.ones((3, TOWEL.vertex_count), bool),
        actions=(action,),
        steps=StepRecords.empty(3),
    )
    tracked.save(folder / "tracked" / "lift.zarr")
    truth = {"positions": np.stack(states), "faces": TOWEL.faces, "frames": np.arange(3)}
    (folder / "truth").mkdir()
    np.savez(folder / "truth" / "lift.npz", canonical=TOWEL.canonical, **truth)
    write_mesh(TOWEL, folder / "towel.obj")
    return folder


def test_a_trajectory_its_truth_and_its_review_are_in_one_page(world, tmp_path, capsys):
    tracked = TrackedTrajectory.load(world / "tracked" / "lift.zarr")
    path = review_path(world / "tracked" / "lift.zarr")
    LabelReview.blank(tracked).decided(0, "rejected").save(path)
    words = ["view", str(world / "tracked" / "lift.zarr"), "--html", str(tmp_path / "p.html")]
    words += ["--recordings", str(world / "recordings")]
    try:
        assert cli.main([*words, "--truth", str(world / "truth")]) == 0
        text = (tmp_path / "p.html").read_text(encoding="utf-8")
        assert "Error against the truth" in text
        assert "&quot;verdict&quot;: &quot;rejected&quot;" in text
        path.write_text('{"format": "clothtrack-label-review", "version": 7}')
        assert cli.main(words) == 1
        assert "version 1" in capsys.readouterr().err
    finally:
        path.unlink()


def test_a_recording_and_a_mesh_are_shown_without_more(world, tmp_path, capsys):
    for artifact in (world / "recordings" / "lift", world / "towel.obj"):
        page = tmp_path / f"{artifact.stem}.html"
        assert cli.main(["view", str(artifact), "--html", str(page)]) == 0
        assert page.exists()
        assert cli.main(["view", str(artifact), "--truth", str(world / "truth")]) == 1
        assert "is not tracked" in capsys.readouterr().err


def test_a_folder_has_an_index_that_names_what_is_broken(world, tmp_path, capsys):
    (world / "tracked" / "torn.zarr").mkdir()
    try:
        words = ["view", str(world / "tracked"), "--recordings", str(world / "recordings")]
        assert cli.main([*words, "--html", str(tmp_path / "index.html")]) == 0
    finally:
        (world / "tracked" / "torn.zarr").rmdir()
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert '<a href="lift.html">' in text
    assert "torn.zarr is not a tracked trajectory" in text
    assert (tmp_path / "lift.html").exists()


@pytest.mark.slow
def test_a_folder_is_served_and_stays_clean(world):
    words = ["view", "tracked", "--recordings", "recordings", "--json"]
    before = sorted((world / "tracked").rglob("*"))
    with subprocess.Popen(
        [sys.executable, "-c", VIEW, *words], cwd=world,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        said = ""
        while "}" not in said:
            said += process.stdout.readline()
        address = json.loads(said)["address"]
        assert 'href="lift.html"' in fetched(address, "lift.html")
        assert 'url=/lift/"' in fetched(f"{address}lift.html", "url")
        assert "<canvas" in fetched(f"{address}lift/", "<canvas")
        review = review_path(world / "tracked" / "lift.zarr")
        try:
            decide = urllib.request.Request(
                f"{address}lift/review", b'{"action": 0, "verdict": "accepted"}',
                {"Content-Type": "application/json"},
            )  # fmt: skip
            with urllib.request.urlopen(decide, timeout=20) as answer:
                assert "accepted" in answer.read().decode()
            assert review.exists()
        finally:
            review.unlink(missing_ok=True)
        process.send_signal(signal.SIGINT)
        rest, complaints = process.communicate(timeout=60)
    assert (process.returncode, rest, complaints) == (0, "", "")
    assert sorted((world / "tracked").rglob("*")) == before


def fetched(address, awaited):
    """A page, as soon as it says something."""
    page = ""
    while awaited not in page:
        time.sleep(0.2)
        with urllib.request.urlopen(address, timeout=20) as answer:
            page = answer.read().decode()
    return page


def test_a_name_in_a_result_leads_out_of_no_folder(world, tmp_path, capsys):
    tracked = TrackedTrajectory.load(world / "tracked" / "lift.zarr")
    replace(tracked, name="../../x").save(tmp_path / "lift.zarr")
    recording = ["--recordings", str(world / "recordings" / "lift")]
    for words in (["label", "--output", str(tmp_path / "a" / "b")], ["evaluate"]):
        assert cli.main([words[0], str(tmp_path / "lift.zarr"), *words[1:], *recording]) == 1
        told = capsys.readouterr().err
        assert "its name is '../../x'" in told
        assert told.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "lift.zarr"]
    assert list((tmp_path / "a" / "b").iterdir()) == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["view", "tracked/lift.zarr"], "add --recordings"),
        (["view", "tracked"], "add --recordings"),
        (["view", "nothing.zarr", "--recordings", "recordings"], "no such file or folder; view "),
        (["view", "truth"], "truth is a folder with lift.npz; view takes NAME.zarr that"),
        (["view", "truth/lift.npz"], "is a .npz file; view takes NAME.zarr that `track` wrote"),
        (["view", "recordings"], "such as recordings/lift"),
        (["view", "film.mcap"], "make a recording of it first: clothtrack import"),
        (["view", "half.zarr"], "has no zarr.json: it was not finished"),
        (["view", "none.ply"], "none.ply"),
        (["export", "tracked/lift.zarr", "--output", "x", "--format", "mp4"], "--recordings"),
        (["export", "tracked/lift.zarr", "--output", "x.mp4", "--format", "obj"], "contradicts"),
        (["view", "towel.obj", "--html", "truth"], "truth is a folder; name a file in it"),
        (
            ["view", "tracked", "--recordings", "recordings", "--html", "truth"],
            "truth is a folder; name a file in it",
        ),
    ],
)
def test_what_is_missing_is_said_in_one_line(world, monkeypatch, capsys, words, told):
    monkeypatch.chdir(world)
    (world / "film.mcap").touch()
    (world / "half.zarr").mkdir(exist_ok=True)
    assert cli.main(words) == 1
    shown = capsys.readouterr()
    assert told in shown.err
    assert shown.err.count("\n") == 1


# Whoever runs the tests in the background may have left Ctrl-C ignored.
VIEW = (
    "import signal, sys\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "from clothtrack.cli import main\n"
    "sys.exit(main())"
)


@pytest.mark.parametrize(
    "artifact",
    [
        pytest.param("towel.obj", marks=pytest.mark.slow),
        pytest.param("recordings/lift", marks=pytest.mark.slow),
        "tracked/lift.zarr",
    ],
)
def test_a_page_is_served_at_an_address_that_is_said_until_ctrl_c(world, artifact):
    words = ["view", artifact, *(["--recordings", "recordings"] if "zarr" in artifact else [])]
    with subprocess.Popen(
        [sys.executable, "-c", VIEW, *words], cwd=world,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        said = process.stdout.readline()
        address, rest = said.split(maxsplit=1)
        assert rest == "open this; Ctrl-C ends\n"
        page = ""
        while "<canvas" not in page:
            time.sleep(0.2)
            with urllib.request.urlopen(address, timeout=20) as answer:
                page = answer.read().decode()
        process.send_signal(signal.SIGINT)
        rest, complaints = process.communicate(timeout=60)
    assert (process.returncode, rest, complaints) == (0, "", "")
