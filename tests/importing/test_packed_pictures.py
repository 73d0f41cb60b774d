"""PNG files that are taken over as they are: the same bits, and nothing damaged among them."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from import_makers import Film, color_of, depth_of, png, write_folder

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.images import packed_color, packed_depth
from clothtrack_capture.importing.import_recording import import_recording


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def gray16(rows, width, height, *, interlaced=0):
    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, interlaced)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def with_chunk(data, kind, content):
    return data[:33] + chunk(kind, content) + data[33:]


def test_what_changes_the_pixels_is_decoded(film):
    gray = png(film.color[0][..., 0])
    jpeg = cv2.imencode(".jpg", film.color[0])[1].tobytes()
    turned = with_chunk(png(film.color[0]), b"eXIf", b"MM\0*\0\0\0\x08\0\0")
    seen_through = with_chunk(png(film.color[0]), b"tRNS", bytes(6))
    for data in (gray, jpeg, turned, seen_through, png(film.depth[0])):
        assert packed_color(data).plain_png() is None
    interlaced = gray16(bytes(3), 1, 1, interlaced=1)
    assert packed_depth(interlaced).plain_png() is None


@pytest.mark.parametrize(
    "rows", [bytes(9), bytes(11), b"\x05" + bytes(9)], ids=["few", "many", "filter"]
)
def test_pixels_that_contradict_the_header_are_refused(rows):
    """Every checksum is right; a 2 x 2 picture has two rows of a filter and two samples."""
    assert packed_depth(gray16(bytes(10), 2, 2)).plain_png() is not None
    with pytest.raises(TruncatedError):
        packed_depth(gray16(rows, 2, 2)).plain_png()


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_a_broken_file_is_refused(share, film):
    data = png(film.depth[0])
    flipped = bytearray(data)
    flipped[int(share * (len(data) - 12))] ^= 1
    for broken in (data[: int(share * len(data))], bytes(flipped)):
        with pytest.raises(TruncatedError):
            packed_depth(broken).plain_png()


def test_files_are_taken_over_or_left_out(tmp_path):
    """Byte by byte; a damaged picture costs its frame only, and a wrong size as well."""
    film = Film(frames=5)
    source = write_folder(tmp_path / "film", film, "open3d")
    files = sorted((source / "depth").iterdir())
    kept = files[0].read_bytes()
    files[1].write_bytes(kept[:-30])
    files[3].write_bytes(png(film.depth[3][:, :-1]))
    report = import_recording(source, tmp_path / "out")
    assert (tmp_path / "out" / "depth" / "000000.png").read_bytes() == kept
    assert np.array_equal(depth_of(tmp_path / "out"), film.depth[[0, 2, 4]])
    assert np.array_equal(color_of(tmp_path / "out"), film.color[[0, 2, 4]])
    assert any("31 x 24" in one for one in report.dropped)


def test_plain_files_stay_but_for_remarks(film):
    for packed, picture in ((packed_depth, film.depth[0]), (packed_color, film.color[0])):
        data = png(picture)
        for one in (data, with_chunk(data, b"tEXt", b"Author\0somebody")):
            assert packed(one).plain_png() == data
            assert np.array_equal(packed(one).decode(), picture)
