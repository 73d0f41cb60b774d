"""The digest of a recording changes with all that is read from it, and with nothing else."""

import shutil

import pytest

from clothtrack.recordings.identity import recording_digest
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording

SHIPPED = shipped_recording()


@pytest.fixture
def folder(tmp_path):
    return shutil.copytree(SHIPPED, tmp_path / "copy")


def test_a_copy_elsewhere_is_the_same_recording(folder):
    (folder / "remarks.txt").write_text("not read")
    assert recording_digest(read_recording(folder)) == recording_digest(read_recording(SHIPPED))


@pytest.mark.parametrize(
    "name",
    [
        "recording.json",
        "picker.csv",
        "template.obj",
        "template_canonical.csv",
        "depth/000005.png",
        "color/000007.png",
    ],
)
def test_everything_that_is_read_counts(folder, name):
    recording = read_recording(folder)
    before = recording_digest(recording)
    with (folder / name).open("ab") as file:
        file.write(b"\n")
    assert recording_digest(recording) != before


def test_pictures_that_change_places_count(folder):
    recording = read_recording(folder)
    before = recording_digest(recording)
    first, second = folder / "depth" / "000001.png", folder / "depth" / "000002.png"
    first.rename(folder / "aside")
    second.rename(first)
    (folder / "aside").rename(second)
    assert recording_digest(recording) != before
