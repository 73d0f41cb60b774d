"""Meshes in files of other programs."""

import numpy as np
import pytest

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidMeshError
from clothtrack.garments.garment_meshes import garment
from clothtrack.recordings.mesh_file import (
    READ_SUFFIXES,
    read_mesh,
    read_vertex_errors,
    write_mesh,
)

TOWEL = garment("towel", vertex_count=60, size_m=(0.2, 0.2))


@pytest.mark.parametrize("suffix", [*READ_SUFFIXES, ".OBJ", ".STL"])
def test_what_is_written_is_read(tmp_path, suffix):
    path = tmp_path / f"towel{suffix}"
    write_mesh(TOWEL, path)
    found = read_mesh(path)
    assert len(found.faces) == len(TOWEL.faces)
    corners = [
        np.sort(one.vertices[one.faces].reshape(-1, 9).round(5), axis=0) for one in (TOWEL, found)
    ]
    np.testing.assert_allclose(*corners, atol=2e-5)


@pytest.mark.parametrize("suffix", READ_SUFFIXES)
def test_damaged_files_are_refused_by_name(tmp_path, suffix, rng):
    path = tmp_path / f"towel{suffix}"
    write_mesh(TOWEL, path)
    whole = path.read_bytes()
    path.write_bytes(b"")
    with pytest.raises(InvalidMeshError, match="towel"):
        read_mesh(path)
    for _ in range(60):
        content = bytearray(whole[: rng.integers(1, len(whole))])
        for place in rng.integers(0, len(content), 5):
            content[place] = rng.integers(256)
        path.write_bytes(content)
        try:
            read_mesh(path)
        except ClothTrackError:
            continue


def test_a_missing_file_and_a_wrong_suffix_are_said(tmp_path):
    with pytest.raises(ClothTrackError, match=r"none\.ply"):
        read_mesh(tmp_path / "none.ply")
    with pytest.raises(InvalidConfigError, match=r"choose \.obj"):
        read_mesh(tmp_path / "mesh.glb")


@pytest.mark.parametrize("suffix", READ_SUFFIXES)
def test_a_ply_keeps_the_expected_error_of_each_vertex(tmp_path, suffix, rng):
    path, errors = tmp_path / f"towel{suffix}", rng.uniform(0, 0.05, TOWEL.vertex_count)
    write_mesh(TOWEL, path, expected_error_m=errors)
    found = read_vertex_errors(path)
    if suffix == ".ply":
        np.testing.assert_allclose(found, errors, atol=1e-8)
        np.testing.assert_allclose(read_mesh(path).vertices, TOWEL.vertices, atol=1e-6)
    else:
        assert found is None
    write_mesh(TOWEL, path)
    assert read_vertex_errors(path) is None
