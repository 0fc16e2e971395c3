import pytest
import torch
from oracles.arrays import complex_normal, direct_log_likelihood

from torchdt.bp.noise import update_noise
from torchdt.model.measurement import from_snapshots
from torchdt.state import Noise

TONES, SNAPSHOTS, SENSORS, POINTS = 2, 3, 6, 9


def scene(num_objects: int):
    rng = torch.Generator().manual_seed(num_objects)
    response = complex_normal(rng, num_objects, TONES, SENSORS)
    strength = 10 * torch.rand(num_objects, TONES, generator=rng).double()
    signal = torch.einsum("ni,nim,nik->imk", strength.to(response), response, response.conj())
    snapshots = complex_normal(rng, TONES, SNAPSHOTS, SENSORS)
    variance = torch.logspace(-2, 2, POINTS, dtype=torch.float64).expand(TONES, -1)
    log_weight = torch.randn(TONES, POINTS, generator=rng).double().log_softmax(-1)
    return signal, snapshots, Noise(variance, log_weight)


def direct_posterior(prior: Noise, signal, snapshots):
    """The Gaussian likelihood of every support point, one by one."""
    eye = torch.eye(signal.shape[-1])
    points = [direct_log_likelihood(snapshots, signal + v[:, None, None] * eye) for v in prior.variance.mT]
    return (prior.log_weight + torch.stack(points, -1)).log_softmax(-1)


@pytest.mark.parametrize("num_objects", [0, 1, 3])
@pytest.mark.parametrize("missing", [[], [1], [0, 4]])
def test_weights_equal_the_direct_likelihood(num_objects, missing):
    signal, snapshots, prior = scene(num_objects)
    kept = [m for m in range(SENSORS) if m not in missing]
    broken = snapshots.clone()
    broken[..., missing] = torch.nan
    found = update_noise(prior, from_snapshots(broken), signal)
    expected = direct_posterior(prior, signal[:, kept][:, :, kept], snapshots[..., kept])
    torch.testing.assert_close(found.log_weight, expected, rtol=1e-9, atol=1e-9)
    assert found.variance is prior.variance


def test_nothing_heard_keeps_the_prior():
    signal, snapshots, prior = scene(1)
    found = update_noise(prior, from_snapshots(torch.full_like(snapshots, torch.nan)), signal)
    torch.testing.assert_close(found.log_weight, prior.log_weight)


def test_batch_equals_single():
    scenes = [scene(n) for n in (0, 1, 3)]
    signal, snapshots = (torch.stack(parts) for parts in list(zip(*scenes, strict=True))[:2])
    prior = Noise(*(torch.stack(parts) for parts in zip(*(s[2] for s in scenes), strict=True)))
    batch = update_noise(prior, from_snapshots(snapshots), signal)
    for n, (one_signal, one_snapshots, one_prior) in enumerate(scenes):
        alone = update_noise(one_prior, from_snapshots(one_snapshots), one_signal)
        torch.testing.assert_close(batch.log_weight[n], alone.log_weight, rtol=1e-10, atol=1e-10)
