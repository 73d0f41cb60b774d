"""Every mutation of the list can be made: a change of the source takes the list along."""

import importlib.util
from pathlib import Path

_spec = importlib.util.spec_from_file_location("mutate", Path(__file__).with_name("run.py"))
mutate = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(mutate)


def test_every_text_is_there_once_and_so_are_its_tests():
    mutations = mutate.mutations()
    assert len(mutations) >= 60
    assert [problem for one in mutations if (problem := mutate.misplaced(one))] == []
    assert all(one["old"] != one["new"] for one in mutations)
