"""Pictures are read exactly, or refused with the file's name."""

import pickle

import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings.pictures import (
    encode_png,
    read_cloud,
    read_color,
    read_depth,
    read_header,
    read_mask,
)

RNG = np.random.default_rng(0)


def test_header_tells_size_and_bits(tmp_path):
    (tmp_path / "a.png").write_bytes(encode_png(np.zeros((7, 9), np.uint16)))
    header = read_header(tmp_path / "a.png")
    assert (header.width, header.height, header.bits, header.color_type) == (9, 7, 16, 0)


@pytest.mark.parametrize("bits", [np.uint8, np.uint16])
def test_gray_is_kept_exactly(tmp_path, bits):
    picture = RNG.integers(0, np.iinfo(bits).max + 1, (31, 17)).astype(bits)
    (tmp_path / "a.png").write_bytes(encode_png(picture))
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"), -1), picture)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.7, 0.999])
@pytest.mark.parametrize("read", [read_color, read_mask, lambda path: read_depth(path, 0.001)])
def test_no_part_of_a_picture_passes_for_the_whole(tmp_path, share, read):
    data = encode_png(RNG.integers(0, 65536, (40, 40)).astype(np.uint16))
    (tmp_path / "a.png").write_bytes(data[: int(share * len(data))])
    with pytest.raises(InvalidRecordingError, match=r"a\.png"):
        read(tmp_path / "a.png")


def test_no_flipped_bit_of_a_picture_passes(tmp_path):
    picture = RNG.integers(0, 256, (20, 30)).astype(np.uint8)
    data = encode_png(picture)
    for place in RNG.integers(0, len(data), 200):
        torn = bytearray(data)
        torn[place] ^= 1 << int(RNG.integers(8))
        (tmp_path / "a.png").write_bytes(torn)
        try:
            shown = read_color(tmp_path / "a.png")
        except InvalidRecordingError:
            continue
        np.testing.assert_array_equal(shown[..., 0], picture)


def test_each_kind_refuses_what_is_not_its_own(tmp_path):
    deep, flat, colored = (tmp_path / f"{name}.png" for name in ("deep", "flat", "colored"))
    deep.write_bytes(encode_png(np.ones((4, 4), np.uint16)))
    flat.write_bytes(encode_png(np.ones((4, 4), np.uint8)))
    colored.write_bytes(encode_png(np.ones((4, 4, 3), np.uint8)))
    for path, read in (
        (deep, read_color),
        (deep, read_mask),
        (colored, read_mask),
        (flat, lambda path: read_depth(path, 1.0)),
        (colored, lambda path: read_depth(path, 1.0)),
    ):
        with pytest.raises(InvalidRecordingError, match=rf"{path.stem}\.png.*; write"):
            read(path)


def test_a_mask_is_whatever_is_not_black(tmp_path):
    (tmp_path / "a.png").write_bytes(encode_png(np.array([[0, 1], [255, 0]], np.uint8)))
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png"), [[False, True], [True, False]])


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("reading a cloud ran code",))


def test_a_cloud_cannot_run_code(tmp_path):
    array = np.empty(1, dtype=object)
    array[0] = Trap()
    np.savez(tmp_path / "a.npz", points=array)
    (tmp_path / "b.npz").write_bytes(pickle.dumps(Trap()))
    for name in ("a.npz", "b.npz"):
        with pytest.raises(InvalidRecordingError, match="not a readable npz"):
            read_cloud(tmp_path / name)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"cloud": np.zeros((3, 3))}, "no array named 'points'"),
        ({"points": np.zeros((3, 2))}, r"shape \(3, 2\)"),
        ({"points": np.array([["a", "b", "c"]])}, "type <U1"),
        ({"points": np.array([[0, 0, 0], [0, np.nan, 0]])}, r"points\[1\]"),
    ],
)
def test_a_cloud_of_another_make_is_refused(tmp_path, content, words):
    np.savez(tmp_path / "a.npz", **content)
    with pytest.raises(InvalidRecordingError, match=words):
        read_cloud(tmp_path / "a.npz")


def test_a_cut_cloud_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.zeros((100, 3)))
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(InvalidRecordingError, match="not a readable npz"):
        read_cloud(tmp_path / "a.npz")
    with pytest.raises(InvalidRecordingError, match="missing"):
        read_cloud(tmp_path / "b.npz")
