"""The long proofs of reliability in short: a few cases, and what their parts promise."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shared import damage, fuzz, kills, near_physics, random_physics, soak
from shared.trial import Trial

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_a_few_cases_of_each_kind_show_no_defect_and_are_not_done_twice(tmp_path):
    """In a process of its own: it forks, which one that has computed must not."""
    pytest.importorskip("torch", reason="the small world has a network")
    pytest.importorskip("rosbags", reason="the small world has bags")
    words = [ROOT / "experiments" / "tables" / "reliability.py", "--smoke", "--out", tmp_path]
    # Wrong and harmless inputs may show what no one has mended yet: tests/experiments/
    # test_wrong_proof.py runs them.
    others = ["--only", "kills", "fuzz", "soak", "physics", "near", "disk"]
    environment = dict(os.environ, PYTHONPATH=str(ROOT / "src"), OMP_NUM_THREADS="1")
    for again in (False, True):
        # The long run is one process: there is nothing to go on from.
        more = ["--json", tmp_path / "all.json", "--only", "kills", "fuzz", "physics"]
        more = more if again else others
        done = subprocess.run(
            [sys.executable, *map(str, words), *map(str, more)],
            env=environment, capture_output=True, text=True, check=False, timeout=900,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
        if again:
            break
        first = {path.name: path.read_text() for path in tmp_path.glob("[fkpd]*.jsonl")}
    assert {path.name: path.read_text() for path in tmp_path.glob("[fkpd]*.jsonl")} == first
    report = json.loads((tmp_path / "all.json").read_text())
    assert {row["outcome"] for row in report["rows"]["fuzz"]} <= {"accepted", "refused"}
    assert all(row[check] for row in report["rows"]["kills"] for check in kills.CHECKS)


def trial(code, *complaints, **more):
    parts = {"out": "", "cpu_s": 1.0, "peak_bytes": 1, "changes": 0, "outside": (), **more}
    return Trial(code=code, complaints=complaints, **parts)


@pytest.mark.parametrize(
    ("ended", "expected"),
    [
        (trial(0), "accepted"),
        (trial(1, "clothtrack: x is 3; give 2"), "refused"),
        (trial(2, "clothtrack: no such verb"), "refused"),
        (trial(1), "silent"),
        (trial(1, "one", "two"), "2 lines"),
        (trial(70, "Traceback (most recent call last):", "ValueError"), "traceback"),
        (trial(0, "x.py:3: RuntimeWarning: overflow"), "warning"),
        (trial(1, "closed is " + damage.LONG[:400]), "long echo"),
        (trial(0, outside=("/elsewhere",)), "writes outside: /elsewhere"),
        (trial(-11), "ended by signal 11"),
        (trial(-9, cpu_s=31.0), "hangs"),
        (trial(0, peak_bytes=3 << 30), "too much memory"),
        (trial(3, "x"), "exit code 3"),
    ],
)
def test_every_defect_has_a_name(ended, expected):
    assert fuzz.outcome(ended, "track") == expected


def test_a_case_of_damage_depends_on_its_seed_alone(tmp_path):
    document = {"a": [1, 2.5, {"b": "x"}], "c": True}
    for spoil in (
        lambda rng: damage.damaged(bytes(range(200)), rng),
        lambda rng: damage.spoilt_text("a,b\n1,2\n3,4\n", rng),
        lambda rng: repr(damage.spoilt_document(json.loads(json.dumps(document)), rng)),
        lambda rng: repr(damage.spoilt_arrays({"x": np.arange(6.0), "y": np.eye(3)}, rng)),
    ):
        once, again = ([spoil(np.random.default_rng(k)) for k in range(30)] for _ in range(2))
        assert once == again
        assert len(set(map(str, once))) > 15


@pytest.mark.parametrize("number", range(4))
def test_drawn_physics_stay_finite_bounded_and_above_the_table(number):
    drawn = random_physics.drawn(np.random.default_rng([7, number]))
    row = random_physics.rolled_out(*drawn)
    assert not random_physics.violates(row), row


@pytest.mark.parametrize("number", range(4))
def test_physics_near_the_default_gain_no_energy(number):
    drawn = near_physics.drawn(np.random.default_rng([7, number]))
    row = random_physics.rolled_out(*drawn)
    assert not near_physics.violates(row), row


def test_what_must_hold_of_physics_can_fail():
    row = {"finite": True, "gained": 0.3, "depth_over_thickness": 0.2}
    assert not random_physics.violates(row)
    for broken in ({"finite": False}, {"gained": 1.2}, {"depth_over_thickness": 1.5}):
        assert random_physics.violates({**row, **broken})


def test_a_process_that_grows_is_seen():
    row = {"code": 0, "grown_mb": 2.0, "more_files": 0}
    assert not soak.violates(row)
    for broken in ({"code": 1}, {"grown_mb": 80.0}, {"more_files": 9}):
        assert soak.violates({**row, **broken})
