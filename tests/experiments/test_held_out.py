"""What is learned from is never measured on, whatever it is called and wherever it lies."""

import json
import shutil

import cv2
import pytest
from shared import held_out

from clothtrack.errors import InvalidConfigError
from clothtrack.recordings.shipped import shipped_recording

SHIPPED = shipped_recording()


@pytest.fixture(autouse=True)
def _read_anew():
    held_out._pictures.cache_clear()


def renamed(folder):
    shutil.copytree(SHIPPED, folder)


def cut_short(folder):
    shutil.copytree(SHIPPED, folder)
    document = json.loads((folder / "recording.json").read_text())
    frames = [{**frame, "index": k} for k, frame in enumerate(document["frames"][3:9])]
    document["actions"], document["frames"] = [], frames
    (folder / "recording.json").write_text(json.dumps(document))


@pytest.mark.parametrize("disguise", [renamed, cut_short])
def test_a_recording_is_known_again_under_another_name(tmp_path, disguise):
    disguise(tmp_path / "elsewhere" / "towel_0007")
    other = tmp_path / "elsewhere" / "towel_0007"
    with pytest.raises(InvalidConfigError) as refused:
        held_out.require_apart([SHIPPED], [other])
    assert str(SHIPPED) in str(refused.value)
    assert str(other) in str(refused.value)


def test_recordings_of_other_pictures_are_apart(tmp_path):
    other = shutil.copytree(SHIPPED, tmp_path / SHIPPED.name)
    for picture in (other / "depth").iterdir():
        depth = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
        depth[0, 0] += 1
        cv2.imwrite(str(picture), depth)
    held_out.require_apart([SHIPPED], [other])
    # One black picture says nothing.
    (other / "depth" / "000000.png").write_bytes((SHIPPED / "depth" / "000000.png").read_bytes())
    held_out._pictures.cache_clear()
    held_out.require_apart([SHIPPED], [other])
    assert not held_out.same_film(frozenset(), frozenset())
