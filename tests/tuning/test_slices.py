import math

import pytest
import torch

from torchdt.model.hyperparameters import HyperparameterSettings
from torchdt.tuning.slices import slices


def test_slices(make, quadratic):
    """Each number moves alone, evenly in unconstrained units, and comes back."""
    hyperparameters = make(birth_mean=HyperparameterSettings(trainable=False))
    before = {name: value.clone() for name, value in hyperparameters.state_dict().items()}
    objective = quadratic(fail_at={6: "nan"})
    found = slices(hyperparameters, objective, 1.0, 5)
    assert [line.name for line in found] == ["survival", "mismatch_share_1", "mismatch_share_2"]
    assert objective.calls == 15
    for line, centre in zip(found, (0.6, 0.1, 0.1), strict=True):
        assert line.centre == pytest.approx(centre)
        logits = [math.log(v / (1 - v)) for v in line.values]
        expected = [math.log(centre / (1 - centre)) + offset for offset in (-1, -0.5, 0, 0.5, 1)]
        assert logits == pytest.approx(expected)
    assert found[0].objective[2] == found[2].objective[2]
    assert [math.isnan(value) for value in found[1].objective] == [False, True, False, False, False]
    # The optimum of survival is 1.79 above the start: a parabola that still rises.
    first = torch.tensor(found[0].objective)
    assert first.diff(n=2).tolist() == pytest.approx([-2 * 0.25] * 3, rel=1e-4)
    assert (first.diff() > 0).all()
    for name, value in hyperparameters.state_dict().items():
        assert torch.equal(value, before[name])
