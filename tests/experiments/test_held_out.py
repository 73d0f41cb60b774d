"""What is learned from is never measured on, whatever it is called and wherever it lies."""

import json
import shutil

import cv2
import pytest
from shared import held_out
from shared.bench_runs import trajectories
from tables import calibration

from clothtrack.errors import InvalidConfigError
from clothtrack.recordings import (
    read_recording,
    recording_digest,
    shipped_recording,
)

SHIPPED = shipped_recording()


def fill(bench, *names):
    for name in names:
        (bench / "recordings" / name).mkdir(parents=True)
        (bench / "truth").mkdir(exist_ok=True)
        (bench / "truth" / f"{name}.npz").write_text(name)
    return bench


@pytest.fixture(autouse=True)
def _read_anew():
    held_out._pictures.cache_clear()


@pytest.mark.parametrize(
    ("count", "learned"), [(50, 45), (20, 18), (10, 9), (3, 2), (2, 1), (1, 0)]
)
def test_a_folder_without_a_list_is_parted_as_the_paper_does(tmp_path, count, learned):
    fill(tmp_path, *(f"towel_{number:04d}" for number in range(count)), "tshirt_0000")
    first, last = held_out.parted(trajectories(tmp_path))
    assert last == held_out.measured_on(tmp_path, "test")
    towels = [one.name for one in first], [one.name for one in last if one.kind == "towel"]
    assert [len(names) for names in towels] == [learned, count - learned]
    assert not {one.name for one in first} & {one.name for one in last}
    assert [*towels[0], *towels[1]] == sorted([*towels[0], *towels[1]])


def test_so_many_are_held_out_as_are_asked_for(tmp_path):
    fill(tmp_path, *(f"towel_{number:04d}" for number in range(20)), "tshirt_0000", "tshirt_0001")
    for count, learned in ((1, 20), (None, 19)):
        first, last = held_out.parted(trajectories(tmp_path), count)
        assert last == held_out.measured_on(tmp_path, "test", count)
        assert (len(first), len(first) + len(last)) == (learned, 22)
    for count in (0, 2):
        with pytest.raises(InvalidConfigError, match=f"is {count}, and there are .*hold out 1 to"):
            held_out.measured_on(tmp_path, "test", count)


def test_a_list_decides_where_there_is_one(tmp_path):
    fill(tmp_path, "towel_0000", "towel_0001")
    entries = [
        {"name": f"towel_000{number}", "kind": "towel", "split": split}
        for number, split in enumerate(("test", "dev"))
    ]
    (tmp_path / "bench.json").write_text(json.dumps({"trajectories": entries}))
    assert [one.name for one in held_out.measured_on(tmp_path, "dev")] == ["towel_0001"]
    assert [one.name for one in held_out.measured_on(tmp_path, "test")] == ["towel_0000"]


def renamed(folder):
    shutil.copytree(SHIPPED, folder)


def with_another_document(folder):
    shutil.copytree(SHIPPED, folder)
    document = json.loads((folder / "recording.json").read_text())
    document["cloth"] = {"kind": "towel"}
    (folder / "recording.json").write_text(json.dumps(document))


def cut_short(folder):
    shutil.copytree(SHIPPED, folder)
    document = json.loads((folder / "recording.json").read_text())
    frames = [{**frame, "index": k} for k, frame in enumerate(document["frames"][3:9])]
    document["actions"], document["frames"] = [], frames
    (folder / "recording.json").write_text(json.dumps(document))


@pytest.mark.parametrize("disguise", [renamed, with_another_document, cut_short])
def test_a_recording_is_known_again_under_another_name(tmp_path, disguise):
    disguise(tmp_path / "elsewhere" / "towel_0007")
    other = tmp_path / "elsewhere" / "towel_0007"
    with pytest.raises(InvalidConfigError) as refused:
        held_out.require_apart([SHIPPED], [other])
    (line,) = str(refused.value).splitlines()
    assert str(SHIPPED) in line
    assert str(other) in line
    assert "record another" in line
    if disguise is not renamed:
        first, second = read_recording(SHIPPED), read_recording(other)
        assert recording_digest(first) != recording_digest(second)


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
    assert len(held_out.picture_digests(read_recording(SHIPPED))) > 10


def test_offline_parameters_do_not_come_from_what_is_measured(tmp_path, monkeypatch):
    class Setup:
        smoke, split, bench = False, None, fill(tmp_path, "towel_0000", "towel_0001")

        def trajectories(self, split=None):
            return trajectories(self.bench, split or self.split)

    compared = []
    monkeypatch.setattr(
        calibration, "require_apart", lambda *both: compared.append([[*one] for one in both])
    )
    learned, measured = calibration.chosen(Setup())
    assert [one.name for one in learned] == ["towel_0000"]
    assert [one.name for one in measured] == ["towel_0001"]
    assert compared == [[[learned[0].recording], [measured[0].recording]]]
