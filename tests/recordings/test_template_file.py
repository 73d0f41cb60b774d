"""OBJ files: order kept, polygons cut, loose pieces refused."""

import numpy as np
import pytest

from clothtrack.errors import InvalidMeshError, InvalidRecordingError
from clothtrack.recordings.template_file import canonical_text, obj_text, read_canonical, read_obj


def write(folder, text):
    (folder / "a.obj").write_text(text)
    return folder / "a.obj"


def test_vertices_keep_their_order_and_faces_may_name_texture_and_normal(tmp_path):
    mesh = read_obj(
        write(
            tmp_path,
            "# a comment\no cloth\nv 1 1 0 0.5 0.5 0.5\nv 0 0 0\nv 1 0 0\nvt 0 0\nvn 0 0 1\n"
            "usemtl x\ns off\nf 2/1/1 3/1/1 1/1/1\n",
        )
    )
    np.testing.assert_array_equal(mesh.vertices, [[1, 1, 0], [0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(mesh.faces, [[1, 2, 0]])


def test_a_polygon_becomes_a_fan_of_the_same_area_and_direction(tmp_path):
    angles = np.arange(5) * 2 * np.pi / 5
    corners = "".join(f"v {np.cos(a)} {np.sin(a)} 0\n" for a in angles)
    mesh = read_obj(write(tmp_path, corners + "f 1 2 3 4 5\n"))
    assert len(mesh.faces) == 3
    sides = mesh.vertices[mesh.faces]
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    assert (normals[:, 2] > 0).all()
    assert normals[:, 2].sum() / 2 == pytest.approx(2.5 * np.sin(2 * np.pi / 5))


def cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def test_a_concave_face_is_cut_within_itself(tmp_path):
    """An L and a star in a tilted plane: the triangles cover the polygon, and none lies outside."""
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
    angles = np.arange(10) * np.pi / 5
    star = (
        np.stack([np.cos(angles), np.sin(angles)], 1) * np.where(np.arange(10) % 2, 0.4, 1)[:, None]
    )
    ell = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    for flat in (ell, np.roll(ell, 3, axis=0), star, star[::-1]):
        corners = "".join(f"v {x} {y} {z}\n" for x, y, z in flat @ tilt)
        face = "f " + " ".join(map(str, range(1, len(flat) + 1)))
        mesh = read_obj(write(tmp_path, f"{corners}{face}\n"))
        a, b, c = flat[mesh.faces.T]
        areas = 0.5 * cross(b - a, c - a)
        whole = 0.5 * cross(flat, np.roll(flat, -1, axis=0)).sum()
        assert len(areas) == len(flat) - 2
        assert (np.sign(areas) == np.sign(whole)).all()
        assert areas.sum() == pytest.approx(whole)


def test_remarks_are_in_any_encoding(tmp_path):
    text = "# Ärmel, 3 µm genau\no blusa_niña\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    for encoding in ("latin-1", "cp1252", "utf-8", "utf-8-sig"):
        (tmp_path / "a.obj").write_bytes(text.encode(encoding))
        assert read_obj(tmp_path / "a.obj").vertex_count == 3


def test_negative_indices_count_from_the_end(tmp_path):
    mesh = read_obj(write(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n"))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def test_writing_then_reading_gives_every_bit_back(tmp_path, square):
    rng = np.random.default_rng(0)
    moved = square.with_vertices(square.vertices + rng.normal(size=(4, 3)) / 100)
    (tmp_path / "a.csv").write_text(canonical_text(moved.canonical))
    back = read_obj(write(tmp_path, obj_text(moved)), tmp_path / "a.csv")
    np.testing.assert_array_equal(back.vertices, moved.vertices)
    np.testing.assert_array_equal(back.faces, moved.faces)
    np.testing.assert_array_equal(back.canonical, moved.canonical)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4.*no vertex 0"),
        ("v 0 0\n", "line 1.*2 numbers"),
        ("v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3.*at least three"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 a 2\n", "line 4"),
        ("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n", "line 5.*crosses itself"),
    ],
)
def test_a_line_that_says_nothing_is_named(tmp_path, text, words):
    with pytest.raises(InvalidRecordingError, match=rf"a\.obj: {words}"):
        read_obj(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no triangle"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "names vertex 3"),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0\nv 1 0 0\nv 0 -1 0\nf 1 2 3\nf 4 6 5\n",
            "vertices 0 and 3 lie at the same place.*merge",
        ),
    ],
)
def test_what_cannot_be_a_cloth_is_refused_with_the_file(tmp_path, text, words):
    with pytest.raises(InvalidMeshError, match=rf"a\.obj: .*{words}"):
        read_obj(write(tmp_path, text))


def test_canonical_coordinates_need_their_head(tmp_path):
    (tmp_path / "a.csv").write_text("0,0,0\n")
    with pytest.raises(InvalidRecordingError, match="must be 'x_m,y_m,z_m'"):
        read_canonical(tmp_path / "a.csv")
