"""The learning curve: a power law is read back, and what does not belong together is refused."""

import json

import pytest
from figures import learning_curve

EXAMPLES = [100_000, 200_000, 400_000]


def rows_of(exponent):
    """Three networks on eight towels, half of them heaps twice as wrong."""
    return [
        {
            "weights": f"w{number}", "kind": "towel", "coverage": 0.4 if state % 2 else 0.9,
            "error_mm": (40.0 if state % 2 else 20.0) * (seen / EXAMPLES[0]) ** exponent,
        }
        for number, seen in enumerate(EXAMPLES)
        for state in range(8)
    ]  # fmt: skip


def test_a_power_of_the_examples_is_read_back():
    every, heaps = learning_curve.curves(rows_of(-0.5), EXAMPLES)
    assert (every.states, heaps.states) == (8, 4)
    assert every.errors_mm[0] == pytest.approx(30.0)
    # Sixteen times as many examples as at first: a quarter of the error.
    assert every.after(1_200_000) == pytest.approx(7.5)
    assert heaps.after(1_200_000) == pytest.approx(10.0)
    assert every.halving == pytest.approx(4.0)
    assert learning_curve.curves(rows_of(0.1), EXAMPLES)[0].halving == float("inf")


def test_the_figure_is_drawn_and_the_table_printed(tmp_path, capsys):
    file, image = tmp_path / "rows.json", tmp_path / "curve.png"
    file.write_text(json.dumps({"rows": rows_of(-0.5)}))
    words = ["--rows", str(file), "--image", str(image), "--examples", *map(str, EXAMPLES)]
    assert learning_curve.main(words) == 0
    assert image.stat().st_size > 5_000
    assert "| towel, below 55 % | 4 | 40.0 | 28.3 | 20.0 |" in capsys.readouterr().out


def test_numbers_that_are_not_those_of_the_networks_are_refused(tmp_path, capsys):
    file = tmp_path / "rows.json"
    file.write_text(json.dumps({"rows": rows_of(-0.5)}))
    assert learning_curve.main(["--rows", str(file), "--examples", "1", "2"]) == 1
    assert "2 numbers for 3 networks" in capsys.readouterr().err
    assert learning_curve.main(["--rows", str(tmp_path / "no.json"), "--examples", "1", "2"]) == 1
    assert "no.json" in capsys.readouterr().err
