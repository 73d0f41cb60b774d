"""States of other data sets, from files that the tests write."""

from pathlib import Path

import numpy as np
import pytest
import zarr

from clothtrack.errors import InvalidMeshError, InvalidResultError
from clothtrack.reconstruction.data.import_states import import_garmentnets, import_mesh_folder
from clothtrack.reconstruction.data.state_store import open_states, read_shard, write_states

REST = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 2], [0, 0, 2], [0, -0.1, 1]], float) * 0.3
QUADS = "f 1 2 3 4\nf -5/1/1 4/2/1 -1/3/1\n"
TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 3, 4]]


def write_obj(path: Path, vertices: np.ndarray, faces: str = QUADS) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    path.write_text("# cloth\n" + "\n".join(lines) + "\nvt 0 0\n" + faces)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_obj(tmp_path / "rest.obj", REST)
    for number in (2, 0, 1):
        write_obj(tmp_path / f"frame_{number:03d}.obj", REST + [5.0, 6.0, 7.0 + 0 * number])
    write_obj(tmp_path / "frame_001.obj", REST * [1.0, 1.0, 0.5])
    return tmp_path


def test_a_folder_of_meshes_becomes_a_shard(folder: Path) -> None:
    shard = import_mesh_folder(folder, "dress")
    assert shard.kind == "dress"
    assert shard.positions.shape == (3, 5, 3)
    assert shard.mesh.faces.tolist() == TRIANGLES
    assert shard.recipes == ("imported",) * 3
    assert shard.episodes.tolist() == [0, 1, 2]
    assert shard.positions[:, :, 2].min(axis=1) == pytest.approx(0.0)
    assert np.ptp(shard.positions[:, :, 2], axis=1) == pytest.approx([0.6, 0.3, 0.6], abs=1e-6)
    middle = shard.positions[:, :, :2].min(axis=1) + shard.positions[:, :, :2].max(axis=1)
    assert middle == pytest.approx(0.0, abs=1e-6)


def test_the_rest_mesh_lies_with_its_front_up(folder: Path) -> None:
    canonical = import_mesh_folder(folder, "dress").mesh.canonical
    assert np.ptp(canonical, axis=0) == pytest.approx([0.3, 0.6, 0.03])
    # What was in front (-y) and half-way up is above, and in the middle of the length.
    assert canonical[4, 2] == canonical[:, 2].max()
    assert canonical[4, 1] == pytest.approx(0.0)
    # Laying down is a rotation: no mirror image.
    edges = np.diff(REST[[0, 1, 2, 4]], axis=0)
    laid = np.diff(canonical[[0, 1, 2, 4]], axis=0)
    assert np.linalg.det(laid) == pytest.approx(np.linalg.det(edges))


def test_files_with_y_up_give_the_same(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "y_up"
    other.mkdir()
    for name, vertices in (("rest.obj", REST), ("a.obj", REST + 1.0)):
        write_obj(other / name, np.column_stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]]))
    ours, theirs = import_mesh_folder(folder, "x"), import_mesh_folder(other, "x", y_up=True)
    assert theirs.mesh.vertices == pytest.approx(ours.mesh.vertices)
    assert theirs.positions[0] == pytest.approx(ours.positions[0], abs=1e-6)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("frame_001.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "those of rest.obj"),
        ("frame_001.obj", "v 0 0\n", "line 1"),
        ("frame_001.obj", "v 0 0 0\nf 1 2 3\n", "line 2"),
        ("frame_001.obj", "v 0 0 x\n", "line 1"),
        ("frame_001.obj", "v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
        ("frame_001.obj", "", "0 vertices"),
        ("rest.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 1 3\n", "frame_000"),
    ],
)
def test_a_bad_file_is_named(folder: Path, name: str, text: str, told: str) -> None:
    (folder / name).write_text(text)
    with pytest.raises(InvalidMeshError, match=told):
        import_mesh_folder(folder, "dress")


def test_a_folder_without_rest_or_states_is_told(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidMeshError, match=r"flat\.obj"):
        import_mesh_folder(folder, "dress", rest="flat.obj")
    for path in folder.glob("frame_*"):
        path.unlink()
    with pytest.raises(InvalidMeshError, match="no state"):
        import_mesh_folder(folder, "dress")


CENTRE = np.array([0.01, -0.02, 0.3])
SCALE = 0.6


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Two garments of a category; the first is gripped at two vertices."""
    root = zarr.open_group(tmp_path / "nets.zarr", mode="w", zarr_format=2)
    category = root.create_group("Tshirt")
    put(category, "summary/cloth_canonical_aabb_union", np.stack([CENTRE - 0.7, CENTRE + 0.7]))
    for name, offset in (("00007_Top_1", 0.0), ("00007_Top_22", 1.0), ("00009_Tshirt_3", 0.0)):
        sample = category.create_group(f"samples/{name}")
        sample.attrs["scale"] = SCALE
        put(sample, "mesh/cloth_verts", (REST + offset).astype(np.float32))
        put(sample, "mesh/cloth_nocs_verts", ((REST - CENTRE) * SCALE + 0.5).astype(np.float32))
        put(sample, "mesh/cloth_faces_tri", np.array(TRIANGLES, np.int64))
    return tmp_path / "nets.zarr"


def put(group: zarr.Group, name: str, values: np.ndarray) -> None:
    array = group.create_array(name, shape=values.shape, dtype=values.dtype, overwrite=True)
    array[...] = values


def test_garmentnets_samples_become_a_shard_per_garment(store: Path, folder: Path) -> None:
    first, second = import_garmentnets(store, "Tshirt", "tshirt")
    assert (len(first.positions), len(second.positions)) == (2, 1)
    # Normalised coordinates are metres again: the same garment as the one in the mesh files.
    expected = import_mesh_folder(folder, "tshirt").mesh
    assert first.mesh.canonical == pytest.approx(expected.canonical, abs=1e-6)
    assert np.array_equal(first.mesh.faces, expected.faces)
    assert first.positions[0] == pytest.approx(first.positions[1], abs=1e-6)


def test_what_is_imported_can_be_stored(store: Path, tmp_path: Path) -> None:
    shards = list(import_garmentnets(store, "Tshirt", "tshirt"))
    write_states(tmp_path / "set", "tshirt", shards, {"source": "GarmentNets"})
    found = open_states(tmp_path / "set")
    assert np.array_equal(read_shard(found.shards[0]).positions, shards[0].positions)


def test_a_bad_sample_is_named(store: Path) -> None:
    group = zarr.open_group(store, mode="r+")["Tshirt/samples/00007_Top_22"]
    put(group, "mesh/cloth_faces_tri", np.array(TRIANGLES[::-1], np.int64))
    with pytest.raises(InvalidResultError, match=r"00007_Top_22.*other faces"):
        list(import_garmentnets(store, "Tshirt", "tshirt"))
    put(group, "mesh/cloth_nocs_verts", np.zeros((4, 3), np.float32))
    with pytest.raises(InvalidResultError, match="00007_Top_22"):
        list(import_garmentnets(store, "Tshirt", "tshirt"))
    del group["mesh/cloth_verts"]
    with pytest.raises(InvalidResultError, match="cloth_verts"):
        list(import_garmentnets(store, "Tshirt", "tshirt"))
    group.attrs["scale"] = -1.0
    with pytest.raises(InvalidResultError, match="00007_Top_22"):
        list(import_garmentnets(store, "Tshirt", "tshirt"))


def test_a_category_that_is_not_there_is_told(store: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidResultError, match="Skirt"):
        list(import_garmentnets(store, "Skirt", "skirt"))
    with pytest.raises(InvalidResultError, match="GarmentNets"):
        list(import_garmentnets(tmp_path / "nothing", "Tshirt", "tshirt"))
