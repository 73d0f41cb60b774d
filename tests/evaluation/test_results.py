"""The rows of a table: right names, right floors, and numbers that obey the laws."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.results import (
    STAGES,
    as_json,
    evaluate,
    from_plain,
    table,
)
from clothtrack.evaluation.truth import Truth
from clothtrack.evaluation.verdict import trajectory_verdict
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.recording import Table
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack.tracking.configuration import MODES, ClothConfig, mode
from clothtrack.tracking.pipeline import RunConfig
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

HEIGHT_M = 0.6
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
DOWN[2, 3] = HEIGHT_M
CAMERA = Camera("top", 160, 120, 220.0, 220.0, 79.5, 59.5, DOWN)
SHEET = towel(0.24, 0.16, 0.02)


def folded(vertices):
    """The right half laid over the left, 10 mm above it; the camera sees the flap."""
    over = vertices + [0.0, 0.0, 0.0015]
    right = over[:, 0] > 1e-9
    over[right] = over[right] * [-1.0, 1.0, 1.0] + [0.0, 0.0, 0.01]
    return over


TRUE = np.stack([SHEET.vertices + [0.0, 0.0, 0.0015], folded(SHEET.vertices)])


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two frames of a towel that is folded, seen without noise from above."""
    folder = tmp_path_factory.mktemp("recording") / "fold"
    flat_table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    draw = Rasterizer(SHEET.faces, CAMERA)
    with RecordingWriter(folder, [CAMERA], {"top": 0.0001}, table=flat_table) as film:
        for index, vertices in enumerate(TRUE):
            view = draw.render(vertices)
            shown = view.faces >= 0
            depth = np.where(shown, view.depth, HEIGHT_M)
            film.add_frame(0.1 * index, depth={"top": depth}, mask={"top": shown})
    return read_recording(folder)


@pytest.fixture(scope="module")
def truth():
    """The truth on a finer triangulation: material points are found, not vertices compared."""
    fine = towel(0.24, 0.16, 0.008)
    positions = np.stack([fine.vertices + [0.0, 0.0, 0.0015], folded(fine.vertices)])
    return Truth(positions, fine.faces, np.arange(2), fine.canonical)


def tracked(before, after=None, config=None):
    after = before if after is None else after
    nothing = Calibration("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)
    losses = np.array([np.nan, np.nan])
    action = TrackedAction(0, 1, before, after, losses, {"table_friction": 0.5}, nothing, {})
    return TrackedTrajectory(
        name="fold",
        mesh=SHEET,
        frames=np.arange(2),
        time_s=np.array([0.0, 0.1]),
        positions=np.stack([TRUE[0], after]),
        visible=np.ones((2, SHEET.vertex_count), bool),
        actions=(action,),
        steps=StepRecords.empty(2),
        config=config or asdict(RunConfig()),
        provenance={"commit": "abc"},
    )


def test_the_truth_has_no_error_and_scores_its_floor(recording, truth):
    result = evaluate(tracked(TRUE[1]), recording, truth)
    assert [row.stage for row in result.rows] == list(STAGES)
    for row in result.rows:
        assert (row.recording, row.action, row.frame) == ("fold", 0, 1)
        assert (row.method, row.floor_of) == ("default", "truth")
        # Across the crease the finer mesh has a vertex where ours has an edge.
        assert row.vertex_error_mm["all"].median < 0.05
        assert row.vertex_error_mm["all"].max < 10.0
        assert row.chamfer_pc == pytest.approx(row.chamfer_floor, rel=0.1)
        assert row.chamfer_pc_rms_mm == pytest.approx(1e3 * np.sqrt(row.chamfer_pc / 2))
    assert result.provenance == {"commit": "abc"}


def test_five_millimeters_are_five_millimeters_visible_and_hidden(recording, truth):
    moved = TRUE[1] + [0.003, 0.004, 0.0]
    (row, _) = evaluate(tracked(moved), recording, truth).rows
    for key in ("all", "visible", "hidden"):
        assert row.vertex_error_mm[key].median == pytest.approx(5.0, abs=0.05)


def test_the_layer_underneath_is_the_hidden_one(recording, truth):
    under = SHEET.vertices[:, 0] < -0.01
    moved = TRUE[1] + np.where(under[:, None], [0.0, 0.008, 0.0], 0.0)
    (row, _) = evaluate(tracked(moved), recording, truth).rows
    assert row.vertex_error_mm["hidden"].median == pytest.approx(8.0, abs=0.1)
    assert row.vertex_error_mm["visible"].median < 0.05
    assert row.vertex_error_mm["hidden"].count == pytest.approx(under.sum(), abs=12)


def test_without_truth_there_is_no_vertex_error_but_a_floor(recording):
    (row, _) = evaluate(tracked(TRUE[1]), recording).rows
    assert row.floor_of == "cloud halves"
    assert row.chamfer_floor > 0.0
    assert row.vertex_error_mm == {}
    assert np.isnan(row.chamfer_surface)


def test_a_trajectory_of_another_recording_is_refused(recording, truth):
    other = tracked(TRUE[1])
    late = replace(other.actions[0], last_frame=7)
    with pytest.raises(InvalidResultError, match="has 2 frames"):
        evaluate(replace(other, actions=(late,)), recording, truth)


@pytest.mark.parametrize("name", MODES)
def test_a_stored_configuration_names_its_mode(recording, name):
    stored = json.loads(json.dumps(asdict(replace(mode(name), seed=7))))
    assert evaluate(tracked(TRUE[1], config=stored), recording).rows[0].method == name
    stored["objective"]["length_weight"] = 0.123
    assert evaluate(tracked(TRUE[1], config=stored), recording).rows[0].method == "custom"


def test_a_thick_cloth_lies_higher_on_the_table(recording):
    """The mesh lies at 1.5 mm, where half of 3 mm is right and half of 20 mm is not."""
    flat = SHEET.vertices + [0.0, 0.0, 0.0015]
    for thickness_m, share in ((0.003, 0.0), (0.02, 1.0)):
        stored = asdict(RunConfig(cloth=ClothConfig(thickness_m=thickness_m)))
        (row, _) = evaluate(tracked(flat, config=stored), recording).rows
        assert row.cloth.below_table == share


def test_settings_of_another_version_are_no_default_ones(recording):
    stored = {"tracker": {"solver": {"thickness_m": 0.02}}}
    with pytest.raises(InvalidResultError, match="fold: its settings are of another version"):
        evaluate(tracked(TRUE[1], config=stored), recording)


def test_one_word_for_one_label(recording):
    """What the stored verdict knows of the recording, every label of it is told with."""
    doubt = Finding("picker_clock", 0.4, 0.1, "s", "picker.csv", "the picker is 0.4 s late")
    run = tracked(TRUE[1])
    judged = trajectory_verdict(evaluate(run, recording).labels, [doubt])
    found = evaluate(replace(run, verdict_fields=judged.as_dict()), recording)
    assert [one.word for one in found.verdicts] == [judged.word] == ["look"]
    (plain,) = json.loads(as_json([found]))
    assert plain["verdicts"][0]["word"] == "look"
    assert plain["verdicts"][0]["trusted_up_to_m"] == 0.008
    assert from_plain(plain).verdicts[0].word == "look"
    assert "  look" in str(found).splitlines()[1]
    assert "at most 8 and nothing speaks against it" in str(found)


def test_the_table_has_a_line_per_row_and_says_its_units(recording, truth):
    known, unknown = (evaluate(tracked(TRUE[1]), recording, one) for one in (truth, None))
    head, *lines, legend = table([known, unknown]).splitlines()
    assert len(lines) == 4
    for word in ("Ch.PC", "floor", "visible", "hidden", "strain", "cross", "expect"):
        assert word in head
    assert [line.split()[2] for line in lines] == ["before", "after"] * 2
    assert lines[2].split()[6:10] == ["-"] * 4
    # What is judged is the label, the mesh after the final alignment.
    assert lines[0].split()[-1] == "-"
    assert float(lines[1].split()[-1]) > 0.0
    assert "m^2" in legend
    assert "[mm]" in legend


def test_names_that_the_truth_does_not_share_are_told(recording, truth):
    half_turn = folded(SHEET.vertices * [-1.0, -1.0, 1.0])
    told = " ".join(str(evaluate(tracked(half_turn), recording, truth)).split())
    assert "fold, action 1: the true error is many times the expected one" in told
    assert "other names" not in str(evaluate(tracked(half_turn), recording))
    assert "other names" not in str(evaluate(tracked(TRUE[1] + [0.01, 0.0, 0.0]), recording, truth))
