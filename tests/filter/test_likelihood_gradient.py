"""Gradients of the likelihood: against finite differences, and the two of the motion against each other."""

from collections.abc import Callable
from functools import partial

import pytest
import scipy.stats
import torch
from oracles.likelihood import differentiate, evaluate, frozen_proposals, measurements, model, rewind
from oracles.line_array import FREQS, POSITIONS, make_region, make_tracker, simulate
from torch import Tensor

from torchdt.core.resampling import Systematic
from torchdt.field.plane_wave import LineArrayField
from torchdt.filter.bp.evidence import GaussianEvidence, SampledEvidence
from torchdt.filter.direct import DirectTracker
from torchdt.filter.intensity import undetected
from torchdt.filter.intensity.undetected import log_ratio
from torchdt.filter.interference.settings import NoInterference
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.model import stack_models
from torchdt.model.motion.driving import Reparameterised, Score

pytestmark = pytest.mark.slow
F64 = torch.float64
SMALL = {"particles": 40, "resampler": Systematic(below=0.0)}
PROPOSALS = pytest.mark.parametrize("proposal", [Adapted(rounds=4, round_size=64), AsPredicted()])
EVIDENCES = pytest.mark.parametrize("evidence", [SampledEvidence(), GaussianEvidence()])
MODES = pytest.mark.parametrize("gradient", [Score(), Reparameterised()])


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    """Four steps."""
    return Measurement(*(part[:, :4] for part in measurements()))


def central_difference(value: Callable[[Tensor], float], at: Tensor, relative: float = 1e-5) -> float:
    step = relative * at
    return (value(at + step) - value(at - step)) / (2 * step.item())


@PROPOSALS
@EVIDENCES
@MODES
def test_gradient_in_the_parameters_equals_finite_differences(measurement, proposal, evidence, gradient):
    """Common random numbers, nothing resampled: relative error 1e-5. The driving variance moves particles,
    which for the score is no part of the gradient. Nor is how much objects are doubted for what is none."""
    parts = {"proposal": proposal, "evidence": evidence, "gradient": gradient}
    tracker = make_tracker(interference=NoInterference(), **parts, **SMALL)
    with frozen_proposals() as tapes:
        _, found = differentiate(tracker, measurement)
        assert tapes[2].record

        def value(name: str, at: Tensor) -> float:
            rewind(tapes)
            return evaluate(tracker.with_model(model(**{name: at})), measurement).sum().item()

        for name, start in model().known().items():
            if gradient == Score() and name == "driving_variance":
                continue
            slope = central_difference(partial(value, name), start)
            assert found[name].sum().item() == pytest.approx(slope, rel=1e-5, abs=1e-6), name


class StretchedArray(LineArrayField):
    """The line array with its sensors moved apart by a factor."""

    def __init__(self, stretch: Tensor):
        super().__init__(FREQS, POSITIONS, dtype=F64)
        self._places = stretch * self._places


@PROPOSALS
@pytest.mark.parametrize(
    ("evidence", "gradient"), [(SampledEvidence(), Reparameterised()), (GaussianEvidence(), Score())]
)
def test_gradient_in_the_field_equals_finite_differences(measurement, proposal, evidence, gradient):
    base = make_tracker(proposal=proposal, evidence=evidence, gradient=gradient, **SMALL)
    stretch = torch.tensor(1.02, dtype=F64, requires_grad=True)

    def value(at: Tensor) -> Tensor:
        tracker = DirectTracker(StretchedArray(at), make_region(), 1.0, base.config, model())
        return evaluate(tracker, measurement).sum()

    with frozen_proposals() as tapes:
        (found,) = torch.autograd.grad(value(stretch), stretch)

        def replayed(at: Tensor) -> float:
            rewind(tapes)
            return value(at).item()

        slope = central_difference(replayed, stretch.detach(), 1e-6)
    assert abs(slope) > 1
    assert found.item() == pytest.approx(slope, rel=1e-5)


def test_what_an_undetected_object_explains_is_a_constant(measurement, monkeypatch):
    """Not of the tempering either, from which its statistics are freed again: no search knows a gradient."""
    seen = []

    def spy(*arguments):
        seen.append(log_ratio(*arguments))
        return seen[-1]

    monkeypatch.setattr(undetected, "log_ratio", spy)
    differentiate(make_tracker(**SMALL), measurement)
    assert len(seen) >= 4  # one a step, and again where a new object shows itself
    assert not any(ratio.requires_grad for ratio in seen)
    assert any(ratio.abs().max() > 1 for ratio in seen)


def test_both_gradients_of_the_motion_agree_in_expectation():
    """Two sources that turn, 24 runs with the same random numbers for both. The mean of the difference stays
    below 6.4 of its standard errors: false alarm of 1e-5 for the six parameters together (Student's t)."""
    runs = 24
    turning = (((0.0, -30.0), (2.0, -33.0), (5.0, -20.0)), ((0.0, 30.0), (3.0, 25.0), (6.0, 33.0)))
    data = from_snapshots(simulate(1, *turning, steps=6)[0].expand(runs, -1, -1, -1, -1))
    each, evidence = stack_models([model()], runs), SampledEvidence(256)
    value, slopes = zip(
        *(
            differentiate(make_tracker(gradient=gradient, evidence=evidence), data, each, range(runs))
            for gradient in (Score(), Reparameterised())
        ),
        strict=True,
    )
    torch.testing.assert_close(*value)
    bound = scipy.stats.t.isf(1e-5 / 12, runs - 1)
    for name, score in slopes[0].items():
        difference = (score - slopes[1][name]).flatten()
        assert difference.mean().abs() < bound * difference.std() / runs**0.5, name
    # Without a gradient, or with one of the wrong sign, the driving variance would not pass.
    moving = slopes[1]["driving_variance"].mean()
    assert moving > bound * slopes[1]["driving_variance"].std() / runs**0.5
    assert 2 * moving > bound * slopes[0]["driving_variance"].std() / runs**0.5
