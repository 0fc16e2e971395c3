"""Signals of free signature: what they are worth, what they cost, and how they go on."""

import math

import pytest
import torch
from oracles.arrays import complex_normal, random_covariance
from oracles.interferers import any_level
from torch import Tensor

from torchdt.filter.interference.signatures import SURPRISE, fit, follow, free_gains, peak_gain, price
from torchdt.model.measurement import Measurement, from_snapshots, gaussian_log_likelihood
from torchdt.model.noise.white import WHITE

F64 = torch.float64
SENSORS, SNAPSHOTS = 5, 4


def scene(seed: int, *batch: int) -> tuple[Measurement, Tensor]:
    """Snapshots of noise of random colour and one signal, and the covariance of the noise."""
    rng = torch.Generator().manual_seed(seed)
    covariance = random_covariance(rng, *batch, sensors=SENSORS)
    noise = (torch.linalg.cholesky(covariance) @ complex_normal(rng, *batch, SENSORS, SNAPSHOTS)).mT
    signature = 2 * complex_normal(rng, *batch, 1, SENSORS)
    return from_snapshots(noise + complex_normal(rng, *batch, SNAPSHOTS, 1) * signature), covariance


def free(measurement: Measurement, covariance: Tensor, number: int) -> Tensor:
    """Columns of so many signals, for nothing."""
    before = torch.zeros(*covariance.shape[:-1], number, dtype=covariance.dtype)
    nothing = torch.zeros_like(measurement.num_snapshots)
    return fit(measurement, covariance, before, nothing, memory=2.0, new=True)[0].columns


def gain(measurement: Measurement, covariance: Tensor, columns: Tensor) -> Tensor:
    """By the likelihoods with and without."""
    whole = gaussian_log_likelihood(measurement, covariance + columns @ columns.mH)
    return whole - gaussian_log_likelihood(measurement, covariance)


@pytest.mark.parametrize("number", [1, 3])
def test_the_gain_is_that_of_the_likelihood(number):
    measurement, covariance = scene(1, 2, 3)
    columns = free(measurement, covariance, number)
    expected = free_gains(measurement, covariance, number).sum(-1)
    torch.testing.assert_close(gain(measurement, covariance, columns), expected, rtol=1e-9, atol=1e-9)


def test_no_other_signal_is_worth_more():
    measurement, covariance = scene(2, 1)
    best = free_gains(measurement, covariance, 1)[..., 0]
    columns = free(measurement, covariance, 1)
    rng = torch.Generator().manual_seed(3)
    for scale in (1e-3, 1e-2, 0.1, 1.0, 10.0):
        near = columns + scale * complex_normal(rng, 300, 1, SENSORS, 1)
        assert (gain(measurement, covariance, near) < best).all()


def test_a_missing_sensor_is_as_none():
    measurement, covariance = scene(4, 1)
    kept = [0, 1, 3, 4]
    fewer = Measurement(measurement.factor[..., kept, :], measurement.num_snapshots, torch.ones(1, 4).to(F64))
    present = torch.ones(1, SENSORS, dtype=F64)
    present[:, 2] = 0
    broken = Measurement(measurement.factor * present[..., None], measurement.num_snapshots, present)
    expected = free_gains(fewer, covariance[..., kept, :][..., kept], 2)
    both = present[..., :, None] * present[..., None, :]
    apart = covariance * both + torch.diag_embed(1 - present)
    torch.testing.assert_close(free_gains(broken, apart, 2), expected)
    variance = torch.ones(1, dtype=F64)
    torch.testing.assert_close(price(broken, variance), price(fewer, variance))


def exact_evidence(measurement: Measurement) -> float:
    """`log integral p(z | c) p(c) dc - log p(z | 0)` with `c ~ CN(0, E/M I)` in noise of variance one.

    With `c = sqrt(p) v`, p is Gamma and the squared parts q of v along the eigenvectors of S are uniform on a
    simplex: `(1 + p)^-J E exp(p / (1 + p) sum_i q_i lambda_i)`, a divided difference of exp; quadrature of p.
    """
    level = torch.linalg.eigvalsh(measurement.factor @ measurement.factor.mH)[0]
    M, J = level.numel(), measurement.num_snapshots.item()
    t = torch.linspace(-9, 6, 6001, dtype=F64)
    p = t.exp() * measurement.energy / M
    exponent = (p / (1 + p))[:, None] * level
    apart = exponent[:, :, None] - exponent[:, None, :] + torch.eye(M, dtype=F64)
    top = exponent.max(-1, keepdim=True).values
    simplex = top[:, 0] + ((exponent - top).exp() / apart.prod(-1)).sum(-1).log() + math.lgamma(M)
    log_density = M * t - t.exp() - math.lgamma(M)  # of t
    return ((log_density - J * (1 + p).log() + simplex).logsumexp(0) + (t[1] - t[0]).log()).item()


@pytest.mark.parametrize("sensors", [2, 3])
@pytest.mark.parametrize("level", [1.0, 10.0, 100.0, 1000.0])
def test_the_price_of_a_vector_is_that_of_its_volume(sensors, level):
    """Laplace's approximation against the exact evidence: 2.5 nats, at gains of up to thousands."""
    for seed in range(5):
        rng = torch.Generator().manual_seed(seed)
        signature = (level / sensors) ** 0.5 * complex_normal(rng, 1, 1, sensors)
        noise = complex_normal(rng, 1, SNAPSHOTS, sensors)
        measurement = from_snapshots(noise + complex_normal(rng, 1, SNAPSHOTS, 1) * signature)
        best = free_gains(measurement, torch.eye(sensors, dtype=torch.complex128)[None], 1).item()
        J = measurement.num_snapshots
        of_noise = peak_gain(J, (J.sqrt() + sensors**0.5).square())
        whole = price(measurement, torch.ones(1, dtype=F64))
        volume = (whole - of_noise - SURPRISE).item()
        worth = exact_evidence(measurement)
        assert best - worth == pytest.approx(volume, abs=2.5)
        assert best - whole < worth  # it errs against the signal


@pytest.mark.parametrize(("sensors", "snapshots"), [(3, 2), (8, 3), (8, 20), (21, 5)])
def test_noise_alone_is_hardly_ever_a_signal(sensors, snapshots):
    """Of 20,000 tones and steps fewer than one in a thousand, at the true noise level."""
    rng = torch.Generator().manual_seed(5)
    measurement = from_snapshots(complex_normal(rng, 20_000, snapshots, sensors))
    eye = torch.eye(sensors, dtype=torch.complex128)
    best = free_gains(measurement, eye, 1)[..., 0]
    assert (best > price(measurement, torch.ones_like(measurement.num_snapshots))).double().mean() < 1e-3


def test_nor_is_it_where_the_level_is_not_known():
    rng = torch.Generator().manual_seed(6)
    measurement = from_snapshots(complex_normal(rng, 3000, 2, 3, 8))
    nothing = torch.zeros(3000, 2, 8, 3, dtype=torch.complex128)
    signal = torch.zeros(3000, 2, 8, 8, dtype=torch.complex128)
    found = follow(measurement, WHITE, any_level(3000, 2), signal, nothing, 2.0, True, 0.01)
    assert (found.columns != 0).any(-2).any(-1).double().mean() < 1e-3


def test_a_loud_signal_is_found_whatever_the_level():
    """Its power and its direction, at the level of the noise that is there."""
    rng = torch.Generator().manual_seed(7)
    signature = 10 * complex_normal(rng, 4, 2, 8, 1)
    snapshots = complex_normal(rng, 4, 2, 3, 8) + complex_normal(rng, 4, 2, 3, 1) * signature.mT
    before, signal = (torch.zeros(4, 2, 8, n, dtype=torch.complex128) for n in (3, 8))
    found = follow(from_snapshots(snapshots), WHITE, any_level(4, 2), signal, before, 2.0, True, 0.01)
    number = (found.columns != 0).any(-2).sum(-1)
    assert number.eq(1).all()
    loudest = found.columns.abs().square().sum(-2).argmax(-1)
    column = found.columns.gather(-1, loudest[..., None, None].expand(4, 2, 8, 1))
    share = (
        (column.mH @ signature).abs().squeeze() / column.norm(dim=-2)[..., 0] / signature[..., 0].norm(dim=-1)
    )
    assert (share > 0.99).all()
    assert (found.cost > SURPRISE).all()


def going_on(seed: int, signature: Tensor, power: float) -> tuple[Measurement, Tensor]:
    """A step of a signal of known signature in white noise, and the covariance of the noise."""
    rng = torch.Generator().manual_seed(seed)
    sound = power**0.5 * complex_normal(rng, 1, 3, 1) * signature.mT
    return from_snapshots(complex_normal(rng, 1, 3, 8) + sound), torch.eye(8, dtype=torch.complex128)[None]


def test_what_goes_on_is_cheap_and_what_begins_is_not():
    signature = torch.ones(1, 8, 1, dtype=torch.complex128)
    measurement, covariance = going_on(1, signature, 2.0)
    cost = free_gains(measurement, covariance, 1)[..., 0] + 1.0
    for before, new, found in ((signature, False, True), (0 * signature, True, False)):
        interferers, net = fit(measurement, covariance, before, cost, memory=2.0, new=new)
        assert interferers.any is found
        assert (net > 0).all() == found
    paid = fit(measurement, covariance, signature, cost, 2.0, False)[0].cost
    assert ((paid > SURPRISE) & (paid < 0.5 * cost)).all()


def test_nothing_new_begins_where_it_must_not():
    signature = torch.ones(1, 8, 1, dtype=torch.complex128)
    measurement, covariance = going_on(1, signature, 100.0)
    nothing = torch.zeros_like(measurement.num_snapshots)
    assert fit(measurement, covariance, 0 * signature, nothing, 2.0, True)[0].any
    assert not fit(measurement, covariance, 0 * signature, nothing, 2.0, False)[0].any


def test_memory_makes_signatures_steadier():
    """A weak one, whose direction three snapshots tell badly."""
    signature = complex_normal(torch.Generator().manual_seed(8), 1, 8, 1)
    signature = signature / signature.norm()
    error = {}
    for memory in (1e-6, 5.0):
        columns, miss = 0 * signature, []
        for seed in range(40):
            measurement, covariance = going_on(seed, signature, 20.0)
            nothing = torch.zeros_like(measurement.num_snapshots)
            columns = fit(measurement, covariance, columns, nothing, memory, True)[0].columns
            miss.append(1 - ((columns.mH @ signature).abs() / columns.norm()).item() ** 2)
        error[memory] = sum(miss[5:]) / len(miss[5:])
    assert error[5.0] < 0.5 * error[1e-6]


def test_without_data_what_went_on_goes_on():
    measurement, covariance = scene(9, 2)
    before = complex_normal(torch.Generator().manual_seed(1), 2, SENSORS, 3)
    silent = measurement.silent()
    interferers, net = fit(silent, covariance, before, torch.ones(2, dtype=F64), 2.0, True)
    assert torch.equal(interferers.columns, before)
    assert interferers.cost.eq(0).all()
    assert net.eq(0).all()
    assert price(silent, torch.ones(2, dtype=F64)).isfinite().all()
    assert free_gains(silent, covariance, 2).eq(0).all()
