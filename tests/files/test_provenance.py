"""What a result was made with."""

import platform

import pytest

from clothtrack.files.provenance import made_with, processor

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


def test_where_no_list_is_python_is_asked(tmp_path):
    assert processor(tmp_path / "none") == (platform.processor() or platform.machine())


def test_a_result_names_processor_and_packages():
    made = made_with(["numpy", "no-such-package"])
    assert made["processor"] == processor()
    assert list(made["packages"]) == ["numpy"]
