"""A run: tracked, saved, read back, judged, exported; and what is refused in one line."""

import json
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.evaluation.verdict import judge, trajectory_verdict
from clothtrack.tracking import pipeline


def test_a_run_says_where_every_vertex_was(run, recording):
    frames, vertices = len(recording.frames), run.mesh.vertex_count
    assert run.positions.shape == (frames, vertices, 3)
    assert run.visible.shape == (frames, vertices)
    assert run.provenance["config_hash"]
    assert run.recording is recording


def test_a_saved_run_comes_back_as_it_was(run, recording, tmp_path):
    run.save(str(tmp_path / "napkin.zarr"))
    again = ct.load(str(tmp_path / "napkin.zarr"), recording)
    np.testing.assert_array_equal(again.positions, run.positions)
    # The rest shape is stored in single precision.
    assert again.labels[0].expected_error_mm == pytest.approx(
        run.labels[0].expected_error_mm, rel=1e-5
    )


def test_the_class_reads_a_run_as_the_function_does(run, recording, tmp_path):
    run.save(tmp_path / "napkin.zarr")
    again = ct.Run.load(tmp_path / "napkin.zarr", recording)
    assert isinstance(again, ct.Run)
    assert again.recording is recording
    assert again.path == tmp_path / "napkin.zarr"


def test_a_label_is_the_mesh_at_the_end_of_an_action_with_its_expected_error(run):
    (label,) = run.labels
    assert label.frame == run.actions[0].last_frame
    np.testing.assert_array_equal(label.positions, run.actions[0].positions_after_final_alignment)
    assert label.expected_error_mm > 0
    assert run.labels is run.labels  # judged once


def test_frames_after_the_last_action_keep_its_mesh_and_are_told(world, run, tmp_path):
    folder = tmp_path / "towel_0003"
    shutil.copytree(world / "recordings" / "towel_0003", folder)
    document = json.loads((folder / "recording.json").read_text())
    last = document["actions"][0]["last_frame"] = run.actions[0].last_frame - 3
    (folder / "recording.json").write_text(json.dumps(document))
    (told,) = ct.track_many([folder], output=tmp_path / "tracked", mode="open_loop", force=True)
    after = ct.load(tmp_path / "tracked" / "towel_0003.zarr", folder)
    frames = after.frames_after_last_action
    assert frames.tolist() == list(range(last + 1, len(after.frames)))
    assert (after.positions[frames] == after.positions[last]).all()
    assert f"  after the last action, in frames {frames[0]} to {frames[-1]}, " in told.text()
    assert told.as_dict()["frames_after_last_action"] == (frames[0], frames[-1])
    assert run.frames_after_last_action.size == 0


def test_what_tracking_has_looked_at_gives_the_verdict_of_looking_anew(run, recording):
    inspection = ct.inspect_recording(recording.folder)
    assert run.verdict == trajectory_verdict(ct.judge_labels(run, recording), inspection.geometry)


def test_trust_says_what_it_rests_on_where_nothing_has_a_known_length(run, recording):
    said = "neither size nor template confirms the focal length"
    bare = replace(recording.cloth, template=None, size_m=None, held_vertices={})
    for known in (replace(bare, size_m=(0.26, 0.2)), replace(bare, template=run.mesh)):
        given = judge(run, replace(recording, cloth=known))
        assert said not in {one.text for one in given.evidence}
    found = judge(run, replace(recording, cloth=bare))
    (rests_on,) = (one for one in found.evidence if one.text == said)
    assert rests_on.word == "trust"
    good = [replace(one, expected_error_mm=2.0) for one in ct.judge_labels(run, recording)]
    told = trajectory_verdict(good, rests_on=[rests_on])
    assert str(told) == f"trust: expected error 2.0 mm (trusted up to 8); {said}"


def test_a_run_finds_the_recording_that_lies_where_simulate_puts_it(run, world):
    run.save(world / "tracked" / "towel_0003.zarr")
    found = ct.load(world / "tracked" / "towel_0003.zarr").recording
    assert found is not None
    assert found.folder == world / "recordings" / "towel_0003"


def test_a_run_without_its_recording_asks_for_it(run, tmp_path):
    run.save(tmp_path / "napkin.zarr")
    alone = ct.load(tmp_path / "napkin.zarr")
    assert alone.recording is None
    with pytest.raises(ct.InvalidRecordingError, match="recording=FOLDER"):
        _ = alone.labels


def test_a_damaged_recording_nearby_does_not_keep_a_run_from_being_read(run, tmp_path):
    run.save(tmp_path / "napkin.zarr")
    (tmp_path / "towel_0003").mkdir()
    (tmp_path / "towel_0003" / "recording.json").write_text("{")
    assert ct.load(tmp_path / "napkin.zarr").recording is None


def test_another_recording_of_the_same_name_is_not_taken_for_the_tracked_one(run, world, tmp_path):
    other = replace(run, provenance={**run.provenance, "recording_sha256": "0" * 64})
    other.save(tmp_path / "recordings" / "napkin.zarr")
    (tmp_path / "recordings" / "towel_0003").symlink_to(world / "recordings" / "towel_0003")
    assert ct.load(tmp_path / "recordings" / "napkin.zarr").recording is None


def test_a_run_is_measured_against_the_truth_only_when_it_is_evaluated(run, world):
    measured = ct.evaluate(run, truth=world / "truth" / "towel_0003.npz")
    assert measured.rows[0].vertex_error_mm["all"].mean > 0
    assert "towel_0003" in str(measured)
    assert ct.evaluate(run).rows[0].vertex_error_mm == {}


def test_a_report_is_one_page(run, tmp_path):
    page = ct.write_report(run, tmp_path / "napkin.html")
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")


def test_settings_change_the_run_and_are_kept_with_it(run):
    assert run.config["seed"] == 7


def test_an_unknown_part_of_the_algorithm_is_named_with_those_that_there_are(recording):
    with pytest.raises(ct.InvalidConfigError, match=r"no part 'aline'.* align,"):
        ct.track(recording, aline=None)


def test_a_function_that_is_given_replaces_that_of_the_method(recording, monkeypatch):
    @dataclass(frozen=True)
    class Method:
        align: object = "the usual one"
        dynamics: object = "the usual ones"

    class FakeTracker:
        def __init__(self, *arguments, **options):
            self.method = Method()

        def track(self, progress, watch):
            told.append(self.method)
            raise ct.SimulationDivergedError("far enough")

    told = []
    monkeypatch.setattr(pipeline, "Tracker", FakeTracker)
    with pytest.raises(ct.SimulationDivergedError):
        ct.track(recording, align="mine")
    assert told == [Method(align="mine")]


def test_a_configuration_and_a_mode_contradict_each_other(recording):
    with pytest.raises(ct.InvalidConfigError, match="mode='open_loop'"):
        ct.track(recording, ct.RunConfig(), mode="open_loop")


@pytest.mark.parametrize("kind", ["npz", "obj"])
def test_a_run_goes_out_to_other_programs(run, tmp_path, kind):
    assert ct.export(run, tmp_path / "napkin", kind).exists()


def test_what_garment_a_depth_array_shows_must_be_said():
    depth = np.full((48, 64), 0.6)
    depth[20:30, 20:30] = 0.55
    with pytest.raises(ct.InvalidConfigError, match="garment='towel'"):
        ct.reconstruct(depth)


def test_a_run_is_looked_at_on_a_local_page(run, monkeypatch, tmp_path):
    served = {}

    def serve(name, write, port, *, decisions, opened):
        served[name] = write(tmp_path / "page.html").read_text("utf-8")

    monkeypatch.setattr("clothtrack.report.live.serve", serve)
    ct.view(run)
    ct.view(run.recording)
    ct.view(run.mesh)
    assert set(served) == {run.name, run.recording.name, "mesh"}


def test_decisions_that_are_made_in_a_view_are_kept_beside_the_run(
    run, recording, monkeypatch, tmp_path
):
    def serve(name, write, port, *, decisions, opened):
        decisions.take(0, "rejected")

    monkeypatch.setattr("clothtrack.report.live.serve", serve)
    copy = ct.Run.of(run, recording)
    assert copy.path is None
    copy.save(tmp_path / "napkin.zarr")
    ct.view(copy)
    assert '"rejected"' in (tmp_path / "napkin.review.json").read_text("utf-8")
    again = ct.load(tmp_path / "napkin.zarr", recording)
    text = ct.write_report(again, tmp_path / "napkin.html").read_text("utf-8")
    assert "&quot;verdict&quot;: &quot;rejected&quot;" in text


def test_the_page_of_a_view_can_be_a_file(run, world, tmp_path):
    run.save(tmp_path / "napkin.zarr")
    shown = ct.view(
        tmp_path / "napkin.zarr", world / "recordings", truth=world / "truth",
        html=tmp_path / "napkin.html",
    )  # fmt: skip
    assert "Error against the truth" in shown.page.read_text("utf-8")
    with pytest.raises(ct.InvalidConfigError, match="is not tracked"):
        ct.view(world / "recordings" / "towel_0003", truth=world / "truth")
    with pytest.raises(ct.InvalidConfigError, match="there is no such file"):
        ct.view(tmp_path / "nothing.zarr")


def test_labels_that_were_rejected_are_not_learned_from(run, recording, tmp_path):
    pytest.importorskip("torch")
    from clothtrack.evaluation.label_review import LabelReview, review_path

    copy = ct.Run.of(run, recording)
    copy.save(tmp_path / "napkin.zarr")
    LabelReview.blank(copy).decided(0, "rejected").save(review_path(copy.path))
    file = ct.label(copy, tmp_path / "napkin.labels.npz")
    with np.load(file) as arrays:
        assert "0/positions" in arrays
        assert "1/positions" not in arrays


def test_a_mode_is_no_setting(recording):
    with pytest.raises(ct.InvalidConfigError, match="give --mode paper"):
        ct.track(recording, settings=["mode=paper"])


def test_what_is_printed_is_one_short_line(run):
    for thing in (run, run.mesh, run.labels[0]):
        assert len(repr(thing)) < 120
        assert "\n" not in repr(thing)
    assert repr(run).startswith("Run('towel_0003', ")


def test_places_may_be_texts(world):
    folder = world / "recordings" / "towel_0003"
    recording = ct.read_recording(str(folder))
    assert ct.inspect_recording(str(folder)).valid
    (depth,) = recording.frames[0].depth.values()
    assert ct.read_depth(str(depth), 0.001).any()
    truth = ct.Truth.load(str(world / "truth" / "towel_0003.npz"))
    assert len(repr(truth)) < 120


def test_many_runs_find_their_recordings_beside_them(run, world):
    run.save(world / "tracked" / "towel_0003.zarr")
    evaluations = ct.evaluate_many([str(world / "tracked" / "towel_0003.zarr")])
    (found,) = evaluations.each
    assert found.name == "towel_0003"
    assert evaluations.text().startswith("recording ")


def test_labels_are_judged_with_the_segmenter_that_the_run_was_tracked_with(run):
    def middle(color, depth_m, camera, table):
        mask = np.zeros(depth_m.shape, bool)
        row, column = (side // 2 for side in mask.shape)
        mask[row - 10 : row + 10, column - 10 : column + 10] = True
        return mask

    elsewhere = replace(run, segmenter=middle)
    assert elsewhere.labels[0].expected_error_mm > 2.0 * run.labels[0].expected_error_mm


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (lambda depth: np.zeros(depth.shape[::-1], bool), r"bool of shape \(320, 240\)"),
        (lambda depth: np.zeros(depth.shape, np.uint8), r"uint8 of shape \(240, 320\)"),
        (lambda depth: np.zeros((*depth.shape, 1), bool), r"bool of shape \(240, 320, 1\)"),
        (lambda depth: None, r"object of shape \(1,\)"),
    ],
)
def test_a_mask_that_is_none_is_refused_in_one_line(recording, given, told):
    with pytest.raises(
        ct.InvalidConfigError,
        match=rf"frame 0: the segmenter gave {told} .* return bool of shape \(240, 320\)",
    ) as refused:
        ct.track(recording, mode="open_loop", segmenter=lambda c, depth, *_: given(depth))
    assert "\n" not in str(refused.value)
