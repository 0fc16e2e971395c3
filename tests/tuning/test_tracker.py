import pytest
import torch
from oracles.line_array import SMALL, make_field, make_region, make_tracker, simulate

from torchdt.core.random import RandomStreams
from torchdt.data.prepare import prepare
from torchdt.data.recording import validate
from torchdt.filter.config import TrackerConfig
from torchdt.model.hyperparameters import Hyperparameters, HyperparameterSettings
from torchdt.model.model import Model
from torchdt.run.track import derive_seed
from torchdt.tuning.sequences import stack_recordings
from torchdt.tuning.tracker import TrackerFamily, TrackerObjective

pytestmark = pytest.mark.slow
PATH = ((0.0, -20.0), (10.0, -15.0))


@pytest.fixture(scope="module")
def family():
    field, config = make_field(), TrackerConfig(**SMALL)
    return TrackerFamily(lambda values: field, make_region(), 1.0, config, Model())


@pytest.fixture(scope="module")
def parts():
    """Two sequences, of six and of four steps."""
    return [validate(step_s=1.0, snapshots=simulate(seed, PATH, steps=k)[0]) for seed, k in ((1, 6), (2, 4))]


def objective(family, recordings, seeds, **options):
    batch, mask = stack_recordings(recordings, pad=True)
    prepared = prepare(batch, make_field(), family.region, family.config)
    return TrackerObjective(family, prepared, mask, seeds, **options)


def values(**starts):
    hyperparameters = Hyperparameters(
        {name: HyperparameterSettings(start=start) for name, start in starts.items()},
        Model().all_quantities(),
    )
    return hyperparameters, hyperparameters()


def test_evidence_of_the_tracker_with_these_values(family, parts):
    """The same as tracking with the values in the configuration, and another than with the default ones."""
    _, given = values(survival=0.8, birth_mean=1e-2, driving_variance=[1e-2])
    ours = objective(family, parts[:1], [5])(given)
    prepared = prepare(parts[0], make_field(), family.region, family.config)

    def tracked(**config):
        tracker = make_tracker(**config)
        streams = RandomStreams.from_seeds([derive_seed(5, "filter")], (1,), torch.float64)
        return tracker.run(prepared.measurement, prepared.priors, streams).log_evidence.sum(-1)

    torch.testing.assert_close(ours.detach(), tracked(survival=0.8, birth_mean=1e-2, driving_variance=[1e-2]))
    assert (ours - tracked()).abs() > 1e-3


def test_same_random_numbers_in_every_call(family, parts):
    target = objective(family, parts[:1], [5])
    _, given = values(survival=0.8)
    assert torch.equal(target(given), target(given))
    assert not torch.equal(target(given), objective(family, parts[:1], [6])(given))


def test_padding_does_not_count(family, parts):
    both, (_, given) = objective(family, parts, [5, 6]), values(survival=0.9)
    assert both.num_steps == 10
    alone = [objective(family, [part], [seed])(given) for part, seed in zip(parts, (5, 6), strict=True)]
    torch.testing.assert_close(both(given), torch.cat(alone))


def test_gradient_reaches_the_unconstrained_values(family, parts):
    """Against a difference quotient with the same random numbers; in checkpointed blocks."""
    hyperparameters, _ = values(birth_mean=1e-2)
    target = objective(family, parts, [5, 6], block=2)
    target(hyperparameters()).sum().backward()
    slope = hyperparameters.get_parameter("birth_mean").grad.item()
    ends = [target(values(birth_mean=1e-2 * (1 + e))[1]).sum().item() for e in (1e-4, -1e-4)]
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-2)
    assert abs(slope) > 0.1
