import math

import pytest
import torch

from torchdt.checkpoint import save_checkpoint
from torchdt.errors import InputError
from torchdt.experiment.outcomes import KIND, Outcome, load_outcomes, save_outcomes
from torchdt.metrics import Gospa
from torchdt.report.quality import Quality


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


@pytest.mark.parametrize(
    "content",
    [
        {"weak": 1},
        {"weak": {"direct": {"quality": {}}}},
        {"weak": {"direct": {"quality": {"scenario": "weak", "x": 1}, "gospa": (), "estimates": 0}}},
    ],
)
def test_another_content(tmp_path, content):
    path = tmp_path / "other.pt"
    save_checkpoint(path, KIND, {}, content)
    with pytest.raises(InputError, match=r"other.pt'.*expected a complete checkpoint of 'compare'"):
        load_outcomes(path, {})
