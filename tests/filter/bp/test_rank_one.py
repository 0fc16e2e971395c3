import pytest
import torch
from oracles.arrays import complex_normal, direct_log_likelihood, random_covariance

from torchdt.core.linalg import NumericalError
from torchdt.filter.bp.rank_one import log_likelihood_ratio, peak_log_likelihood_ratio, statistics, whiten
from torchdt.model.measurement import from_snapshots

TONES, SNAPSHOTS, SENSORS, PARTICLES = 2, 3, 6, 7


def scene(seed: int = 3):
    rng = torch.Generator().manual_seed(seed)
    background = random_covariance(rng, TONES, sensors=SENSORS)
    snapshots = complex_normal(rng, TONES, SNAPSHOTS, SENSORS)
    response = complex_normal(rng, TONES, PARTICLES, SENSORS)
    power = torch.logspace(-3, 4, 8, dtype=torch.float64)
    return background, snapshots, response, power


def ratio_of(measurement, background, response, power):
    """(I, P, G)"""
    s, q = statistics(whiten(measurement, background), response)
    return log_likelihood_ratio(measurement.num_snapshots[:, None, None], power, s[..., None], q[..., None])


def direct_ratio(snapshots, background, response, power):
    """Difference of two full log-likelihoods, (I, P, G)."""
    outer = response[..., :, None] * response[..., None, :].conj()
    with_object = background[:, None, None] + power[:, None, None] * outer[:, :, None]
    z = snapshots[:, None, None]
    return direct_log_likelihood(z, with_object) - direct_log_likelihood(z, background[:, None, None])


def test_ratio_is_the_difference_of_two_likelihoods():
    background, snapshots, response, power = scene()
    found = ratio_of(from_snapshots(snapshots), background, response, power)
    expected = direct_ratio(snapshots, background, response, power)
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-10)


def test_statistics_equal_their_definition():
    background, snapshots, response, _ = scene()
    s, q = statistics(whiten(from_snapshots(snapshots), background), response)
    for i in range(TONES):
        inverse = torch.linalg.inv(background[i])
        scatter = snapshots[i].mT @ snapshots[i].conj()
        for p in range(PARTICLES):
            a = response[i, p]
            assert s[i, p].item() == pytest.approx((a.conj() @ inverse @ a).real.item())
            assert q[i, p].item() == pytest.approx((a.conj() @ inverse @ scatter @ inverse @ a).real.item())


def test_missing_sensors_are_a_smaller_array():
    background, snapshots, response, power = scene()
    background = torch.diag_embed(background.diagonal(dim1=-2, dim2=-1))  # masked ones are diagonal there
    dead, kept = 2, [0, 1, 3, 4, 5]
    broken = snapshots.clone()
    broken[..., dead] = torch.nan
    found = ratio_of(from_snapshots(broken), background, response, power)
    expected = direct_ratio(
        snapshots[..., kept], background[..., kept, :][..., kept], response[..., kept], power
    )
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-10)


def test_nothing_heard_says_nothing():
    background, snapshots, response, power = scene()
    measurement = from_snapshots(torch.full_like(snapshots, torch.nan))
    assert ratio_of(measurement, background, response, power).eq(0).all()


@pytest.mark.parametrize("snr_db", [33.0, 47.0])
def test_single_precision_beside_a_strong_interferer(snr_db):
    """Errors must stay far below one wherever the log-likelihood ratio is not itself many thousands."""
    rng = torch.Generator().manual_seed(8)
    power = 10 ** (snr_db / 10)
    sine = torch.sin(torch.deg2rad(torch.linspace(-60, 60, 241, dtype=torch.float64)))
    line = torch.polar(torch.ones(1).double(), -torch.pi * sine[:, None] * torch.arange(21)) / 21**0.5
    interferer, wanted = line[150], line[100]
    amplitude = power**0.5 * complex_normal(rng, 2, SNAPSHOTS, 1)
    snapshots = amplitude[0] * interferer + amplitude[1] * wanted + complex_normal(rng, SNAPSHOTS, 21)
    background = power * torch.outer(interferer, interferer.conj()) + torch.eye(21)
    grid = torch.logspace(0, 5, 16, dtype=torch.float64)
    exact = [t[None] for t in (snapshots, background, line)]
    rounded = [t.to(torch.complex64) for t in exact]

    def ratio(arguments, power):
        return ratio_of(from_snapshots(arguments[0]), *arguments[1:], power)

    double, single = ratio(exact, grid), ratio(rounded, grid.float())
    same_input = ratio([t.to(torch.complex128) for t in rounded], grid)
    assert single.dtype == torch.float32
    assert double.amax() > 0.3 * power  # a strong source is there to be found, the test is not idle
    # Rounding of the computation, and rounding of a background of this dynamic range.
    assert (single - same_input).abs().amax() < 1e-6 * double.amax()
    assert (single - double).abs().amax() < 1e-4 * double.amax()


def test_peak_is_the_maximum():
    rng = torch.Generator().manual_seed(1)
    s = torch.rand(50, generator=rng).double() + 0.1
    q = 8 * torch.rand(50, generator=rng).double()
    J = torch.full_like(s, 3.0)
    peak, best = peak_log_likelihood_ratio(J, s, q)
    grid = torch.cat([torch.zeros(1), torch.logspace(-6, 4, 40001)]).double()
    brute = log_likelihood_ratio(J[:, None], grid, s[:, None], q[:, None])
    assert (brute.amax(-1) <= peak + 1e-12).all()
    torch.testing.assert_close(peak, brute.amax(-1), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(log_likelihood_ratio(J, best, s, q), peak)
    torch.testing.assert_close(best, grid[brute.argmax(-1)], rtol=1e-3, atol=1e-5)
    assert 5 < int((best > 0).sum()) < 45  # both kinds: worth an object, and not


@pytest.mark.parametrize(("J", "s"), [(0.0, 1.0), (3.0, 0.0)])
def test_peak_without_data_or_response_is_zero(J, s):
    peak, best = peak_log_likelihood_ratio(torch.tensor(J), torch.tensor(s), torch.tensor(0.0))
    assert (peak.item(), best.item()) == (0.0, 0.0)


def test_gradients_in_power_and_quadratic_forms():
    J, power, s, q = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (3.0, 0.7, 1.3, 9.0))
    assert torch.autograd.gradcheck(log_likelihood_ratio, (J, power, s, q))


def test_gradients_in_the_response():
    background, snapshots, response, _ = scene()
    whitener = whiten(from_snapshots(snapshots), background)
    response.requires_grad_()
    assert torch.autograd.gradcheck(lambda a: statistics(whitener, a), (response,))


def test_gradients_in_the_background():
    """Hermitian by construction, as the sum of a real parameterisation."""
    _, snapshots, response, power = scene()
    measurement = from_snapshots(snapshots)
    rng = torch.Generator().manual_seed(4)
    root = torch.randn(TONES, SENSORS, SENSORS, 2, generator=rng, dtype=torch.float64, requires_grad=True)
    noise = torch.tensor([0.3, 0.8], dtype=torch.float64, requires_grad=True)

    def background(root, noise):
        factor = torch.view_as_complex(root)
        return factor @ factor.mH / SENSORS + noise[:, None, None] * torch.eye(SENSORS)

    def quadratic_forms(root, noise):
        return statistics(whiten(measurement, background(root, noise)), response)

    def ratio(root, noise):
        return ratio_of(measurement, background(root, noise), response, power[::3])

    assert torch.autograd.gradcheck(quadratic_forms, (root, noise))
    assert torch.autograd.gradcheck(ratio, (root, noise))


def test_an_indefinite_background_is_named():
    background, snapshots, _, _ = scene()
    background[1] -= 50 * torch.eye(SENSORS)
    with pytest.raises(NumericalError, match=r"background covariance: .*\(1,\)"):
        whiten(from_snapshots(snapshots), background)
