"""A recording in memory is the one on disk, to the bit; arrays that do not fit are refused."""

from dataclasses import replace

import jaxtyping
import numpy as np
import pytest

import clothtrack as ct
from clothtrack.recordings.identity import recording_digest
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.store import write_recording


@pytest.fixture(scope="module")
def on_disk():
    return ct.read_recording(ct.shipped_recording())


def in_memory(recording, **changes):
    """The same recording, its pictures handed over as a driver would."""
    (camera,) = recording.cameras
    name, unit_m = camera.name, recording.depth_units_m[camera.name]
    frames = recording.frames
    given = {
        "depth": [ct.read_depth(frame.depth[name], unit_m) for frame in frames],
        "color": [ct.read_color(frame.color[name]) for frame in frames],
        "times_s": [frame.time_s for frame in frames],
        "camera": camera,
        "picker": recording.picker_paths,
        "cloth": recording.cloth,
        "actions": recording.actions,
        "table": recording.table,
        "name": recording.name,
    }
    return ct.Recording.from_arrays(**given | changes)


def test_it_is_tracked_to_the_same_bits_as_from_disk(on_disk):
    first = on_disk.actions[0]
    short = replace(on_disk, actions=(first,), frames=on_disk.frames[: first.last_frame + 1])
    quick = ["search.method=none"]
    there, here = (ct.track(one, settings=quick) for one in (short, in_memory(short)))
    assert np.array_equal(there.positions, here.positions)
    assert np.array_equal(there.visible, here.visible)
    assert there.labels[0].expected_error_mm == here.labels[0].expected_error_mm
    assert here.verdict.word == there.verdict.word


def test_it_is_inspected_like_the_one_on_disk(on_disk):
    there, here = ct.inspect_recording(on_disk.folder), ct.inspect_recording(in_memory(on_disk))
    assert here.valid
    assert dict(there.facts) == dict(here.facts)
    assert there.geometry == here.geometry


def test_it_is_written_and_read_back(on_disk, tmp_path):
    mask = [np.arange(240)[:, None] + np.zeros((1, 320)) > 100 for _ in on_disk.frames]
    back = write_recording(in_memory(on_disk, mask=mask), tmp_path / "written")
    for written, frame in zip(back.frames, on_disk.frames, strict=True):
        now = ct.read_depth(written.depth["top"], back.depth_units_m["top"])
        then = ct.read_depth(frame.depth["top"], on_disk.depth_units_m["top"])
        assert np.abs(now - then).max() < 1e-6
        assert np.array_equal(read_mask(written.mask["top"]), mask[0])
    assert back.actions == on_disk.actions


def test_its_digest_changes_with_every_picture_and_with_the_camera(on_disk):
    whole = in_memory(on_disk)
    digest = recording_digest(whole)
    assert digest == recording_digest(in_memory(on_disk))
    other = [np.array(frame.depth["top"]) for frame in whole.frames]
    other[7][3, 5] += 0.001
    moved = replace(on_disk.cameras[0], fx=on_disk.cameras[0].fx + 0.1)
    for change in ({"depth": other}, {"camera": moved}, {"color": None}, {"table": None}):
        assert recording_digest(in_memory(on_disk, **change)) != digest


def test_actions_are_where_the_picker_is_closed_when_nobody_names_them(on_disk):
    found = in_memory(on_disk, actions=None).actions
    assert [one.pickers for one in found] == [("gripper",), ("gripper",)]
    path = on_disk.picker_paths["gripper"]
    for one in found:
        inside = [path.closed_at(on_disk.frames[n].time_s) for n in
                  range(one.first_frame + 1, one.last_frame)]  # fmt: skip
        assert all(inside)


@pytest.fixture
def unchecked(monkeypatch):
    """Without the types that only tests check, as in a user's program."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


def saved_and_mapped(pictures, folder):
    np.save(folder / "pictures.npy", np.stack(pictures))
    return np.load(folder / "pictures.npy", mmap_mode="r")


def read_only(pictures):
    for picture in pictures:
        picture.setflags(write=False)
    return pictures


LAYOUTS = {
    "columns reversed": lambda some, _: [one[:, ::-1].copy()[:, ::-1] for one in some],
    "channels reversed": lambda some, _: [one[..., ::-1].copy()[..., ::-1] for one in some],
    "transposed": lambda some, _: [one.swapaxes(0, 1).copy().swapaxes(0, 1) for one in some],
    "by columns": lambda some, _: np.asfortranarray(np.stack(some)),
    "read-only": lambda some, _: read_only([one.copy() for one in some]),
    "mapped from a file": saved_and_mapped,
    "every second row": lambda some, _: [np.repeat(one, 2, axis=0)[::2] for one in some],
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_strides_do_not_matter(on_disk, layout, tmp_path):
    short = replace(on_disk, frames=on_disk.frames[:5], actions=())
    mask = [np.arange(240)[:, None] + np.zeros((1, 320)) > 100 for _ in short.frames]
    plain = in_memory(short, mask=mask)
    pictures = {
        "color": [ct.read_color(frame.color["top"]) for frame in short.frames],
        "depth": [ct.read_depth(frame.depth["top"], 0.001) for frame in short.frames],
        "mask": mask,
    }
    places = {kind: tmp_path / kind for kind in pictures}
    for place in places.values():
        place.mkdir()
    given = {kind: layout(some, places[kind]) for kind, some in pictures.items()}
    recording = in_memory(short, **given)
    assert recording_digest(recording) == recording_digest(plain)
    assert ct.inspect_recording(recording).geometry == ct.inspect_recording(plain).geometry


def test_a_path_and_a_table_may_be_lists(on_disk, unchecked):
    path = on_disk.picker_paths["gripper"]
    lists = (path.time_s.tolist(), path.positions.tolist(), path.closed.astype(int).tolist())
    flat = ct.Table([0, 0, 0], [0, 0, 1])
    found = in_memory(on_disk, picker={"gripper": ct.PickerPath(*lists)}, table=flat)
    assert np.array_equal(found.picker_paths["gripper"].closed, path.closed)
    assert recording_digest(found) == recording_digest(in_memory(on_disk))


def picker(**changes):
    known = {"time_s": np.array([0.0, 9.0]), "positions": np.zeros((2, 3))}
    made = ct.PickerPath(**known | {"closed": np.array([True, False])} | changes)
    return {"picker": made, "actions": None}


def table(normal):
    return {"table": ct.Table(np.zeros(3), np.array(normal, float))}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: {"times_s": [0.0] * len(r.frames)}, "not after the frame before"),
        (lambda r: {"times_s": [0.0, 1.0]}, "43 pictures of depth for 2 times"),
        (lambda r: {"depth": [np.full((240, 320), 750.0)] * 43}, "give meters"),
        (lambda r: {"depth": np.full((43, 240, 320), 750, np.uint16)}, "depth is uint16"),
        (lambda r: {"depth": np.full((43, 24, 32), 0.75)}, "320 x 240"),
        (lambda r: {"color": np.zeros((43, 240, 320, 3), np.float32)}, "uint8"),
        (lambda r: {"mask": np.zeros((43, 240, 320), np.uint8)}, "bool"),
        (lambda r: {"actions": [(5, 5)]}, "frame 5 to 5"),
        (lambda r: {"actions": [(0, 43)]}, "frames run from 0 to 42"),
        (lambda r: {"picker": None}, "path of picker 'gripper' does not cover"),
        (lambda r: {"picker": None, "actions": [(0, 5)]}, "path of picker 'picker'"),
        (lambda r: {"depth": None}, "depth is a NoneType; give a list"),
        (lambda r: {"color": np.zeros((43, 240, 320, 4), np.uint8)}, r"give \(240, 320, 3\)"),
        (lambda r: {"color": np.zeros((43, 320, 240, 3), np.uint8)}, "color has shape"),
        (lambda r: {"mask": np.zeros((43, 240, 320), float)}, "mask > 0"),
        (lambda r: {"times_s": ["soon"] * 43}, "times_s is .* give N numbers"),
        (lambda r: {"times_s": np.zeros((43, 2))}, r"times_s has shape \(43, 2\)"),
        (lambda r: {"camera": {"fx": 300}}, "camera is a dict; give a ct.Camera"),
        (lambda r: {"cloth": "towel"}, "cloth is a str; give a ct.ClothDescription"),
        (lambda r: {"table": 0.5}, "table is a float; give a ct.Table"),
        (lambda r: table([0, 0, 2]), "table.normal .* its length is 2"),
        (lambda r: table([0, 1, 0]), "table.normal .* the world has y up"),
        (lambda r: {"picker": [1, 2]}, "give a ct.PickerPath"),
        (lambda r: picker(positions=np.zeros((3, 2))), r"positions has shape \(3, 2\); give 2 x 3"),
        (lambda r: picker(closed=np.zeros(3, bool)), "closed has shape"),
        (lambda r: picker(time_s=np.array([1.0, 0.5])), "sample 1 at 0.5 s"),
        (lambda r: picker(positions=np.full((2, 3), np.nan)), "finite positions"),
        (lambda r: {"actions": [("a", "b")]}, "give its first and last frame"),
        (lambda r: {"actions": [3]}, "give its first and last frame"),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(on_disk, change, words, unchecked):
    with pytest.raises(ct.InvalidRecordingError, match=words) as refused:
        in_memory(on_disk, **change(on_disk))
    assert "\n" not in str(refused.value)
