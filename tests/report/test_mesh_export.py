from dataclasses import replace

import numpy as np
import pytest
import trimesh

from clothtrack.errors import StorageError
from clothtrack.report.exports import export


def test_the_archive_holds_the_trajectory(tracked, tmp_path):
    path = export(tracked, tmp_path / "fold", "npz")
    assert path == tmp_path / "fold.npz"
    with np.load(path, allow_pickle=False) as archive:
        assert set(archive) == {
            "rest_positions",
            "positions",
            "positions_before_final_alignment",
            "faces",
            "frames",
            "visible",
            "time_s",
        }
        np.testing.assert_array_equal(archive["positions"], tracked.positions)
        np.testing.assert_array_equal(archive["visible"], tracked.visible)
        np.testing.assert_allclose(archive["rest_positions"], tracked.mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(
            archive["positions_before_final_alignment"][1],
            tracked.actions[1].positions_before_final_alignment,
        )


def test_the_archive_holds_canonical_coordinates_where_the_mesh_has_them(tracked, tmp_path):
    canonical = tracked.mesh.vertices[::-1].copy()
    named = replace(tracked, mesh=replace(tracked.mesh, canonical=canonical))
    with np.load(export(named, tmp_path / "named.npz", "npz"), allow_pickle=False) as archive:
        np.testing.assert_allclose(archive["canonical"], canonical, atol=1e-6)


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_another_program_reads_the_same_mesh(tracked, tmp_path, kind):
    folder = export(tracked, tmp_path / kind, kind)
    assert len(list(folder.iterdir())) == len(tracked.frames) + 2 * len(tracked.actions)
    mesh = trimesh.load(folder / f"frame_000003.{kind}", process=False)
    np.testing.assert_allclose(mesh.vertices, tracked.positions[3], atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, tracked.mesh.faces)
    after = trimesh.load(folder / f"action_01_after.{kind}", process=False)
    np.testing.assert_allclose(after.vertices, tracked.positions[5], atol=1e-6)


def test_a_glb_stands_upright_in_other_programs(tracked, tmp_path):
    folder = export(tracked, tmp_path / "glb", "glb")
    scene = trimesh.load(folder / "frame_000003.glb", process=False)
    np.testing.assert_array_equal(scene.geometry["cloth"].faces, tracked.mesh.faces)
    np.testing.assert_allclose(scene.geometry["cloth"].vertices, tracked.positions[3], atol=1e-6)
    x, y, z = tracked.positions[3].T
    turned = scene.to_geometry().vertices
    np.testing.assert_allclose(turned, np.stack([x, z, -y], axis=1), atol=1e-6)


def test_a_full_folder_is_not_overwritten(tracked, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("work of years")
    with pytest.raises(StorageError, match="not empty"):
        export(tracked, tmp_path / "mine", "obj")
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "work of years"
