"""Archives that tell when they are damaged."""

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.files.sealed_npz import read_npz, write_npz

ARRAYS = {"points": np.arange(6.0).reshape(2, 3), "text": np.array("äöü"), "none": np.zeros((0, 3))}


def test_what_was_written_is_read(tmp_path):
    write_npz(tmp_path / "a.npz", ARRAYS)
    found = read_npz(tmp_path / "a.npz")
    assert found.keys() == ARRAYS.keys()
    for name, values in ARRAYS.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("points", ARRAYS["points"] + 1e-12, "points is damaged"),
        ("points", ARRAYS["points"].astype(np.float32), "points is damaged"),
        ("points", ARRAYS["points"].reshape(3, 2), "points is damaged"),
        ("points", None, "points is missing"),
        ("other", np.zeros(1), "other is damaged"),
        ("sha256", np.array("{"), "list of its SHA-256"),
        ("sha256", np.array("3"), "list of its SHA-256"),
        ("sha256", np.array("{}"), "is damaged"),
    ],
)
def test_a_replaced_array_is_named(tmp_path, name, values, words):
    path = tmp_path / "a.npz"
    write_npz(path, ARRAYS)
    with np.load(path) as file:
        arrays = {**file, name: values}
    np.savez(path, **{name: one for name, one in arrays.items() if one is not None})
    with pytest.raises(InvalidResultError, match=words):
        read_npz(path)


def test_no_altered_byte_goes_unnoticed_or_ends_in_a_traceback(tmp_path):
    path = tmp_path / "a.npz"
    write_npz(path, ARRAYS)
    whole = path.read_bytes()
    refused = 0
    for place in range(0, len(whole), 5):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        try:
            found = read_npz(path)
        except InvalidResultError:
            refused += 1
            continue
        # What ZIP says twice, or notes of dates and systems.
        assert all(np.array_equal(found[name], ARRAYS[name]) for name in ARRAYS)
    assert refused > len(whole) / 10
