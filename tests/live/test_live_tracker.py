"""A live tracker makes of the same pictures what `track` makes, and survives what is missing."""

import time
from dataclasses import replace

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.live.live_action import LONGEST_GAP_S, SETTLE_S, HurriedCloth
from clothtrack.recordings.identity import recording_digest
from clothtrack.tracking.picking import Grasp, HeldCloth


@pytest.fixture(scope="module")
def offline(film):
    return ct.track(film.recording, settings=["search.method=none"])


@pytest.fixture(scope="module")
def followed(film):
    """A tracker that has seen everything, all of its states, and its run."""
    tracker = film.tracker()
    states = film.follow(tracker, range(len(film)))
    return tracker, states, tracker.close()


def test_what_comes_of_the_same_pictures_is_what_track_makes_to_the_bit(followed, offline):
    _, states, run = followed
    assert np.array_equal(run.positions, offline.positions)
    assert np.array_equal(run.visible, offline.visible)
    for here, there in zip(run.actions, offline.actions, strict=True):
        assert (here.first_frame, here.last_frame) == (there.first_frame, there.last_frame)
        assert here.held_vertices == there.held_vertices
        assert here.parameters == there.parameters
    assert np.array_equal(run.steps.loss_after, offline.steps.loss_after, equal_nan=True)
    assert [one.expected_error_mm for one in run.labels] == [
        one.expected_error_mm for one in offline.labels
    ]
    ends = {one.last_frame: one for one in run.actions}
    for state, positions in zip(states, offline.positions, strict=True):
        # The final alignment of an action is made beside the stream.
        wanted = positions
        if state.settling:
            wanted = ends[max(end for end in ends if end <= state.frame)]
            wanted = wanted.positions_before_final_alignment
        assert np.array_equal(state.positions, wanted)


def test_the_final_alignment_comes_with_a_later_picture_and_the_next_action_waits_for_it(film):
    tracker, action = film.tracker(), film.recording.actions[0]
    (last,) = film.follow(tracker, range(action.last_frame + 1))[-1:]
    assert last.settling
    picture, state = film.picture(action.last_frame), last
    for later in range(1, 200):
        state = tracker.update(**(picture | {"time_s": picture["time_s"] + 0.01 * later}))
        if not state.settling:
            break
        time.sleep(0.05)
    assert not state.settling
    assert not np.array_equal(state.positions, last.positions)
    assert not state.acting
    run = tracker.close()
    (ended,) = run.actions
    assert np.array_equal(state.positions, ended.positions_after_final_alignment)
    assert np.array_equal(last.positions, ended.positions_before_final_alignment)


def test_a_state_says_what_is_seen_held_and_expected(followed, offline):
    _, states, _ = followed
    first = offline.actions[0]
    middle = states[(first.first_frame + first.last_frame) // 2]
    assert middle.acting
    assert middle.held == first.held_vertices
    assert not states[-1].acting
    for state, visible in zip(states, offline.visible, strict=True):
        assert state.settling or np.array_equal(state.visible, visible)
        assert state.latency_s > 0
    last = states[-1]
    assert 0 <= last.judged_s <= last.time_s
    assert 1e-4 < last.expected_error_m.mean() < 0.05
    assert not last.lost.all()


def test_the_run_is_saved_and_read_and_its_recording_judges_its_labels(followed, tmp_path):
    _, _, run = followed
    run.save(tmp_path / "live.zarr")
    back = ct.load(tmp_path / "live.zarr", run.recording)
    assert np.array_equal(back.positions, run.positions)
    assert back.verdict.word == run.verdict.word
    assert back.provenance["recording_sha256"] == recording_digest(run.recording)
    with_pictures = {frame.index for frame in run.recording.frames if frame.depth}
    ends = {n for one in run.recording.actions for n in (one.first_frame, one.last_frame)}
    assert ends <= with_pictures <= ends | {0, len(run.frames) - 1}
    page = ct.write_report(run, tmp_path / "live.html")
    assert page.stat().st_size > 10_000


def test_actions_begin_and_end_with_the_gripper(film):
    tracker = film.tracker()
    states = film.follow(tracker, range(len(film)), by_call=False)
    run = tracker.close()
    (path,) = film.recording.picker_paths.values()
    times = [frame.time_s for frame in film.recording.frames]
    closures = path.closures()
    assert len(run.actions) == len(closures) > 0
    for action, (closed_s, opened_s) in zip(run.actions, closures, strict=True):
        assert times[action.first_frame] >= closed_s - 1e-9
        assert times[action.first_frame - 1] < closed_s or action.first_frame == 0
        settled = times[action.last_frame] - opened_s
        longest = max(np.diff(times))
        assert SETTLE_S - 1e-6 <= settled <= SETTLE_S + longest or action is run.actions[-1]
        assert all(action.held_vertices.values())
    assert np.isfinite(states[-1].positions).all()


def test_over_missing_pictures_the_held_vertex_follows_the_path_of_the_picker(film, offline):
    action, shown = offline.actions[0], []
    tracker = film.tracker(watch=lambda _, __, frame, ___: shown.append(frame))
    gap = range(action.first_frame + 4, action.first_frame + 9)
    film.follow(tracker, range(gap.start))
    for index in gap:
        picture = film.picture(index)
        tracker.drop(picture["time_s"], picture["picker"])
    (state,) = film.follow(tracker, [gap.stop])
    assert state.frame == gap.stop
    assert state.dropped == len(gap)
    (name,) = action.held_vertices
    held = list(action.held_vertices[name])
    assert np.abs(state.positions[held] - offline.positions[gap.stop][held]).max() < 1e-4
    # There is no picture to lay a dropped one's mesh over.
    assert {frame.index for frame in shown} == {*range(gap.start), gap.stop}
    run = tracker.close(film.recording)
    assert len(run.frames) == gap.stop + 1
    for index in gap:
        assert np.array_equal(run.positions[index], run.positions[gap.start - 1])


def test_over_a_long_gap_the_dynamics_are_rolled_for_a_short_time_along_all_of_the_path(film):
    (path,) = film.recording.picker_paths.values()
    start, end = path.closures()[0]
    grasp = Grasp("gripper", path, np.array([3]), np.zeros((1, 3)))
    cloth = HeldCloth((grasp,), np.zeros(3))
    usual, hurried = (
        one.action(start, end - 1e-3) for one in (cloth, HurriedCloth(cloth.grasps, cloth.offset))
    )
    assert usual.duration_s > LONGEST_GAP_S
    assert hurried.duration_s == pytest.approx(LONGEST_GAP_S)
    assert np.array_equal(hurried.motion.waypoints, usual.motion.waypoints)
    assert hurried.speed * hurried.duration_s == pytest.approx(usual.speed * usual.duration_s)
    short = HurriedCloth(cloth.grasps, cloth.offset).action(start, start + 0.5 * LONGEST_GAP_S)
    assert short.duration_s == pytest.approx(0.5 * LONGEST_GAP_S)


def test_a_picture_without_cloth_leaves_the_mesh_and_the_next_one_goes_on(film):
    tracker = film.tracker()
    start = film.recording.actions[0].first_frame
    before = film.follow(tracker, range(start + 5))[-1]
    hidden = film.picture(start + 5)
    table = film.recording.table
    camera = film.recording.cameras[0]
    rows, columns = np.mgrid[: camera.height, : camera.width]
    sight = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)], -1
    )
    toward = sight @ (camera.world_from_camera[:3, :3].T @ table.normal)
    bare = ((table.point - camera.position) @ table.normal / toward).astype(np.float32)
    blind = tracker.update(**(hidden | {"depth": bare, "color": np.zeros_like(hidden["color"])}))
    assert any("no cloth is found" in note for note in blind.notes)
    assert np.array_equal(blind.positions, before.positions)
    after = film.follow(tracker, [start + 6])[-1]
    assert not after.notes
    assert not np.array_equal(after.positions, before.positions)
    assert len(tracker.close().frames) == start + 7


def test_a_first_picture_without_cloth_is_refused_and_the_next_one_begins(film):
    tracker = film.tracker()
    first = film.picture(0)
    with pytest.raises(ct.InvalidRecordingError, match="no cloth is found"):
        tracker.update(**(first | {"color": np.zeros_like(first["color"])}))
    with pytest.raises(ct.InvalidConfigError, match="no picture"):
        tracker.close()
    state = tracker.update(**film.picture(1))
    assert state.frame == 0


def test_the_table_is_found_and_gives_the_world(film):
    recording = film.recording
    camera = replace(recording.cameras[0], world_from_camera=np.eye(4))
    cloth = ct.ClothDescription(recording.cloth.kind, recording.cloth.color)
    tracker = ct.LiveTracker(cloth, camera, table="find")
    state = tracker.update(**(film.picture(0) | {"picker": None}))
    height = tracker.camera.world_from_camera[2, 3]
    assert abs(height - recording.cameras[0].position[2]) < 0.005
    assert np.abs(state.positions[:, 2]).max() < 0.02


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time_s": 0.0}, "in order of time"),
        ({"time_s": float("nan")}, "in order of time"),
        ({"depth": np.full((3, 4), 0.6)}, "has shape"),
        ({"picker": {"arm": ((0.0, 0.0), False)}}, "give x, y and z"),
        ({"picker": {"arm": ((0.0, 0.0, np.inf), False)}}, "give x, y and z"),
    ],
)
def test_what_cannot_be_is_refused_and_the_next_picture_goes_on(film, change, words):
    tracker = film.tracker()
    tracker.update(**film.picture(0))
    with pytest.raises(ct.InvalidRecordingError, match=words):
        tracker.update(**(film.picture(1) | change))
    assert tracker.update(**film.picture(1)).frame == 1


def test_a_sample_that_is_older_than_the_last_is_not_taken_and_said(film):
    tracker = film.tracker()
    tracker.update(**film.picture(0))
    tracker.move_picker(0.05, {"gripper": ((0.0, 0.0, 0.1), False)})
    tracker.move_picker(0.04, {"gripper": ((1.0, 0.0, 0.1), False)})
    state = tracker.update(**(film.picture(1) | {"picker": None}))
    assert state.notes == ("picker gripper: a sample that is older than the last",)


def test_after_close_nothing_is_tracked(film):
    tracker = film.tracker()
    tracker.update(**film.picture(0))
    tracker.close()
    with pytest.raises(ct.InvalidConfigError, match="closed"):
        tracker.update(**film.picture(1))
