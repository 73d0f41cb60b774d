from dataclasses import replace

import av
import numpy as np
import pytest

from clothtrack.report.overlay import (
    Overlay,
    OverlayConfig,
    step_words,
    write_overlay_video,
)

SMALL = OverlayConfig(height=120)


def test_a_close_up_holds_the_cloth_in_every_frame(tracked, two_cameras):
    overlay = Overlay(tracked, two_cameras, config=replace(SMALL, closest=0.3))
    for view in overlay.views:
        pixels, _ = view.camera.project(tracked.positions.reshape(-1, 3).astype(float))
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        assert (low > (view.columns.start - 0.5, view.rows.start - 0.5)).all()
        assert (high < (view.columns.stop - 0.5, view.rows.stop - 0.5)).all()
    assert overlay.views[1].camera.width > 160


def test_only_the_hidden_part_is_drawn_in_the_hidden_hue(tracked, two_cameras):
    bare = replace(two_cameras, picker_paths={})
    config = replace(SMALL, cameras=1, wires=0.0)
    all_seen = replace(tracked, visible=np.ones_like(tracked.visible))
    with_hidden = Overlay(tracked, bare, config=config).draw(5).astype(int)
    without = Overlay(all_seen, bare, config=config).draw(5).astype(int)
    changed = (with_hidden != without).any(axis=2)
    view = Overlay(tracked, bare, config=config).views[0]
    pixels, _ = view.camera.project(tracked.positions[5][~tracked.visible[5]].astype(float))
    rows, columns = np.nonzero(changed)
    assert len(rows) > 50
    assert columns.max() <= pixels[:, 0].max() - view.columns.start + 12
    assert columns.min() >= pixels[:, 0].min() - view.columns.start - 12


def test_the_color_of_the_cloth_does_not_make_it_look_hidden(tracked, two_cameras, monkeypatch):
    bare = replace(two_cameras, picker_paths={})
    all_seen = replace(tracked, visible=np.ones_like(tracked.visible))
    overlay = Overlay(all_seen, bare, config=replace(SMALL, cameras=1, wires=0.0))
    camera = overlay.views[0].camera
    red = np.full((*overlay.observation(0).shape[:2], 3), (190, 30, 30), np.uint8)
    monkeypatch.setattr(overlay, "_observations", lambda step: [red])
    drawn = overlay.draw(0).astype(int)
    bluer = drawn[..., 2] > drawn[..., 0]
    pixels, _ = camera.project(tracked.positions[0].astype(float))
    column, row = np.rint(pixels.mean(axis=0)).astype(int)
    row, column = row - overlay.views[0].rows.start, column - overlay.views[0].columns.start
    assert bluer[row - 8 : row + 9, column - 8 : column + 9].all()
    assert not bluer[0].any()


def test_a_recording_without_pictures_is_drawn_on_paper(tracked, clouds_only):
    overlay = Overlay(tracked, clouds_only, config=SMALL)
    seen = overlay.observation(0)
    dots = (seen != seen[0, 0]).any(axis=2)
    assert 100 < dots.sum() < 0.5 * dots.size
    drawn = overlay.draw(0)
    assert (drawn[0, 0] == seen[0, 0]).all()
    assert (drawn[dots] != seen[dots]).any()


@pytest.mark.parametrize("recording", ["two_cameras", "clouds_only"])
def test_the_video_has_the_chosen_frames(tracked, recording, request, tmp_path):
    overlay = Overlay(tracked, request.getfixturevalue(recording), config=SMALL)
    rate = write_overlay_video(overlay, tmp_path / "v.mp4", steps=[0, 2, 4])
    assert rate == pytest.approx(5.0)
    with av.open(str(tmp_path / "v.mp4")) as container:
        assert len(list(container.decode(video=0))) == 3


def test_frames_after_the_last_action_say_whose_mesh_they_have(tracked):
    early = replace(tracked, actions=tracked.actions[:1])
    said = ["the mesh of frame 2" in step_words(early, step)[1] for step in range(6)]
    assert said == [False, False, False, True, True, True]
    assert not any("the mesh of" in step_words(tracked, step)[1] for step in range(6))
