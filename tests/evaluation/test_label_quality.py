"""The expected error of a label: monotone and recoverable."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_evidence import EVIDENCE_NAMES, LabelEvidence
from clothtrack.evaluation.label_quality import (
    SCALES,
    QualityModel,
    fit_quality,
    shipped_model,
)

PLANTED = QualityModel(
    math.log(0.001),
    {"silhouette_gap": 0.5, "cloud_gap_m": 0.8, "action": 0.3},
)


def some_evidence(count, seed=0):
    rng = np.random.default_rng(seed)
    spread = np.exp(rng.normal(0.7, 1.0, (count, len(EVIDENCE_NAMES) - 1)))
    scales = [SCALES[name] for name in EVIDENCE_NAMES[:-1]]
    return [LabelEvidence(*row, action=1 + index % 3) for index, row in enumerate(spread * scales)]


def test_a_planted_relation_is_found_again():
    evidence = some_evidence(200)
    errors = np.array([PLANTED.expected_error_m(one) for one in evidence])
    found = fit_quality(evidence, errors, shrinkage=0.0)
    assert found.log_error == pytest.approx(PLANTED.log_error, abs=1e-6)
    for name in EVIDENCE_NAMES:
        assert found.weights[name] == pytest.approx(PLANTED.weights.get(name, 0.0), abs=1e-6)


def test_evidence_at_its_scale_doubles_the_error_once_per_weight():
    (one,) = some_evidence(1)
    at_scale = replace(one, silhouette_gap=0.005, cloud_gap_m=5e-4, action=1)
    assert PLANTED.expected_error_m(at_scale) == pytest.approx(0.001 * 2 ** (0.5 + 0.8 + 0.3))


def test_evidence_that_speaks_for_an_error_never_speaks_against_it():
    evidence = some_evidence(200)
    errors = np.array([0.005 / (1.0 + 100.0 * one.silhouette_gap) for one in evidence])
    assert fit_quality(evidence, errors).weights["silhouette_gap"] == 0.0


@pytest.mark.parametrize("name", EVIDENCE_NAMES)
@pytest.mark.parametrize("model", [PLANTED, shipped_model()], ids=["planted", "shipped"])
def test_what_looks_worse_is_never_expected_to_be_better(model, name):
    for one in some_evidence(20, seed=3):
        worse = replace(one, **{name: 2 * one.as_dict()[name]})
        assert model.expected_error_m(worse) >= model.expected_error_m(one)
        if model.weights.get(name, 0.0) > 0:
            assert model.expected_error_m(worse) > model.expected_error_m(one)


def test_a_model_is_read_as_it_was_written_and_another_file_is_no_model(tmp_path):
    file = tmp_path / "model.json"
    with pytest.raises(InvalidResultError, match="--fit"):
        QualityModel.load(file)
    model = replace(PLANTED, provenance={"split": "dev", "labels": 60})
    model.save(file)
    assert QualityModel.load(file) == model
    document = json.loads(file.read_text())
    for changes, told in (({"version": 99}, "99"), ({"weights": {"action": -0.1}}, "action"),
                          ({"weights": {"beauty": 0.1}}, "beauty")):  # fmt: skip
        file.write_text(json.dumps(document | changes))
        with pytest.raises((InvalidResultError, InvalidConfigError), match=told):
            QualityModel.load(file)
