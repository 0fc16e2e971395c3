import dataclasses
import math

import pytest
import torch

from torchdt.app.outcomes import KIND, Outcome, load_outcomes, save_outcomes
from torchdt.app.report.scores import Quality
from torchdt.core.errors import InputError
from torchdt.metrics import Gospa
from torchdt.run.checkpoint import save_checkpoint


def test_round_trip(tmp_path):
    gospa = Gospa(*torch.rand(4, 2, 3, dtype=torch.float64), *torch.randint(3, (2, 2, 3)))
    quality = Quality("weak", runs=2, gospa=0.3, gospa_by_run=[0.25, 0.35])
    path = tmp_path / "checkpoint.pt"
    save_outcomes(
        path, {"runs": 2}, {"weak": {"direct": Outcome(quality, gospa, torch.rand(3, 2))}, "late": {}}
    )
    again = load_outcomes(path, {"runs": 2})
    assert list(again) == ["weak", "late"]
    found = again["weak"]["direct"]
    assert isinstance(found.gospa, Gospa)
    assert all(torch.equal(a, b) for a, b in zip(found.gospa, gospa, strict=True))
    assert found.estimates.shape == (3, 2)
    assert (found.quality.gospa, found.quality.gospa_by_run) == (0.3, [0.25, 0.35])
    assert math.isnan(found.quality.missed)


def test_no_file(tmp_path):
    assert load_outcomes(tmp_path / "none.pt", {}) == {}


SCORES = tuple(torch.zeros(1, 3) for _ in Gospa._fields)
FINE = {
    "quality": dataclasses.asdict(Quality("weak", runs=1)),
    "gospa": SCORES,
    "estimates": torch.zeros(2, 2),
}


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (1, "content.weak.direct: 1, expected the keys quality, gospa, estimates"),
        (
            {"quality": {}},
            "content.weak.direct: the keys quality, expected the keys quality, gospa, estimates",
        ),
        (
            FINE | {"quality": {"scenario": "weak", "x": 1}},
            "direct.quality: the keys scenario, x",
        ),
        (
            FINE | {"quality": FINE["quality"] | {"gospa": "low"}},
            "content.weak.direct.quality.gospa: 'low', expected float",
        ),
        (FINE | {"gospa": SCORES[:3]}, "content.weak.direct.gospa: 3 entries, expected 6 entries"),
        (FINE | {"gospa": (*SCORES[:5], 0)}, "content.weak.direct.gospa.5: 0, expected Tensor"),
        (FINE | {"gospa": (*SCORES[:5], torch.zeros(1, 2))}, r"tensors .*expected scores \(runs, steps\)"),
        (FINE | {"gospa": (torch.zeros(2, 3),) * 6}, r"tensors .*expected scores \(runs, steps\)"),
        (FINE | {"estimates": torch.zeros(2)}, r"tensors .*estimates \(objects, coordinates\)"),
    ],
)
def test_another_content(tmp_path, row, words):
    path = tmp_path / "other.pt"
    save_checkpoint(path, KIND, {}, {"weak": {"direct": row}})
    with pytest.raises(InputError, match=rf"other.pt': found .*{words}.*; another folder starts anew"):
        load_outcomes(path, {})


def test_the_content_that_the_others_change_is_fine(tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, KIND, {}, {"weak": {"direct": FINE}})
    assert load_outcomes(path, {})["weak"]["direct"].quality.runs == 1
