import pytest
import torch
from oracles.arrays import complex_normal, direct_log_likelihood

from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.base import Noise
from torchdt.model.noise.white import update_noise

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


@pytest.mark.parametrize("missing", [[], [0, 4]])
@pytest.mark.parametrize("floor", [0.0, 2.0])
def test_gradient_where_eigenvalues_coincide(floor, missing):
    """Two objects on six sensors leave four more eigenvalues: zero, or the floor of a diffuse part, which may
    also bend in a direction of full rank."""
    rng = torch.Generator().manual_seed(3)
    _, snapshots, prior = scene(0)
    snapshots[..., missing] = torch.nan
    measurement = from_snapshots(snapshots)
    response, direction = complex_normal(rng, 2, TONES, SENSORS), complex_normal(rng, TONES, SENSORS, SENSORS)
    strength = torch.tensor([[3.0, 1.0], [2.0, 4.0]], dtype=torch.float64)
    shift = torch.zeros(TONES, dtype=torch.float64)
    inputs = (strength, response, shift, prior.variance[:, 2:6], prior.log_weight[:, 2:6])
    inputs = tuple(t.clone().requires_grad_() for t in inputs)

    def log_weight(strength, response, shift, variance, log_weight):
        signal = torch.einsum("ni,nim,nik->imk", strength.to(response), response, response.conj())
        diffuse = floor * (torch.eye(SENSORS) + shift[:, None, None] * (direction + direction.mH))
        return update_noise(Noise(variance, log_weight), measurement, signal + diffuse).log_weight

    assert torch.autograd.gradcheck(log_weight, inputs)
    slopes = torch.autograd.grad(log_weight(*inputs)[:, 0].sum(), inputs)
    assert [bool(g.abs().max() > 1e-3) for g in slopes] == [True, True, floor > 0, True, True]


def test_value_with_a_gradient_is_the_value_without():
    signal, snapshots, prior = scene(3)
    measurement = from_snapshots(snapshots)
    found = update_noise(prior, measurement, signal.clone().requires_grad_()).log_weight
    assert found.requires_grad
    torch.testing.assert_close(found.detach(), update_noise(prior, measurement, signal).log_weight)
