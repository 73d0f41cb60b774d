"""What a result was made with."""

import platform

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.provenance import made_with, processor, require_same

XEON = """processor\t: 0
model name\t: Intel(R) Xeon(R) Processor @ 2.00GHz
flags\t\t: fpu sse4_2 avx avx2 avx512f
bugs\t\t: spectre_v1
"""
EPYC = XEON.replace("Intel(R) Xeon(R) Processor @ 2.00GHz", "AMD EPYC").replace(" avx512f", "")
ARM = "processor\t: 0\nFeatures\t: fp asimd evtstrm\n"


@pytest.mark.parametrize(
    ("listing", "expected"),
    [
        (XEON, "Intel(R) Xeon(R) Processor @ 2.00GHz, avx512f"),
        (EPYC, "AMD EPYC, avx2"),
        (ARM, f"{platform.machine()}, asimd"),
        ("", platform.machine()),
    ],
)
def test_a_processor_is_its_model_and_its_widest_vectors(tmp_path, listing, expected):
    (tmp_path / "cpuinfo").write_text(listing)
    assert processor(tmp_path / "cpuinfo") == expected


def test_a_result_names_processor_and_packages():
    made = made_with(["numpy", "no-such-package"])
    assert made["processor"] == processor()
    assert list(made["packages"]) == ["numpy"]


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (
            {"seed": 1, "reach": (2, 3), "planner": {"strip_m": 0.0}},
            r"planner\.strip_m \(0\.06, now",
        ),
        (
            {"seed": 1, "reach": (2, 3), "planner": {"strip_m": 0.06}, "new": 3},
            r"new \(null, now 3\)",
        ),
        ({"reach": (2, 3), "planner": {"strip_m": 0.06}}, r"seed \(1, now null\)"),
    ],
)
def test_a_folder_begun_with_other_settings_is_refused(tmp_path, asked, told):
    stored = {"seed": 1, "reach": [2, 3], "planner": {"strip_m": 0.06}}
    require_same(tmp_path, stored, {**stored, "reach": (2, 3)})
    with pytest.raises(InvalidConfigError, match=f"begun with another {told}"):
        require_same(tmp_path, stored, asked)
