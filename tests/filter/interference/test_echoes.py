"""Echoes of stronger objects, against the density of all snapshots together."""

import math

import pytest
import torch
from oracles.line_array import make_tracker, simulate

from torchdt.core.random import RandomStreams
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.interference.echoes import echo_gain
from torchdt.filter.interference.settings import FreeSignatures
from torchdt.filter.interference.signatures import SURPRISE
from torchdt.model.measurement import from_snapshots
from torchdt.model.prior import data_priors

TONES, SNAPSHOTS, SENSORS, SHARE = 2, 4, 5, 0.1


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, dtype=torch.complex128, generator=torch.Generator().manual_seed(seed))


def background(seed: int = 1) -> torch.Tensor:
    root = draw(TONES, SENSORS, SENSORS, seed=seed)
    return root @ root.mH + torch.eye(SENSORS)


def by_density(z, sigma, response, amplitudes):
    """Log-ratio of `CN(0, I x Sigma + tau^2 sum_p (s_p a)(s_p a)^H)` and `CN(0, I x Sigma)`."""
    total = 0.0
    for tone in range(TONES):
        plain = torch.block_diag(*[sigma[tone]] * SNAPSHOTS)
        columns = torch.stack([torch.kron(s, response[tone]) for s in amplitudes[tone]], -1)
        data = z[tone].mT.reshape(-1) if z.ndim == 2 else z[tone].reshape(-1)
        both = plain + SHARE * columns @ columns.mH

        def log_density(covariance, data=data):
            misfit = (data.conj() @ torch.linalg.solve(covariance, data)).real
            return -torch.linalg.slogdet(covariance).logabsdet.real - misfit

        total += float(log_density(both) - log_density(plain))
    return total


@pytest.mark.parametrize("scale", [0.3, 3.0])
def test_the_gain_is_that_of_the_exact_density_given_the_amplitudes(scale):
    sigma, response, parents = (
        background(),
        scale * draw(TONES, SENSORS, seed=2),
        draw(2, TONES, SENSORS, seed=3),
    )
    z, power = 3 * draw(TONES, SNAPSHOTS, SENSORS, seed=4), torch.tensor([[2.0, 1.0], [0.5, 3.0]]).double()
    whitener = whiten(from_snapshots(z), sigma)
    seen = torch.linalg.solve(sigma, z.mT)  # Sigma^-1 Z
    amplitudes = power.mT[..., None] * (parents.movedim(0, 1).conj() @ seen)
    expected = by_density(z, sigma, response, amplitudes)
    for new, prior in ((True, math.exp(-SURPRISE)), (False, 1.0)):
        found = echo_gain(whitener, response, parents, power, SHARE, torch.tensor(new))
        mixture = math.log((1 + prior * math.exp(expected)) / (1 + prior))
        assert found.item() == pytest.approx(max(mixture, 0.0), abs=1e-9)


def test_without_parents_there_is_no_echo():
    whitener = whiten(from_snapshots(draw(TONES, SNAPSHOTS, SENSORS)), background())
    parents, power = draw(3, TONES, SENSORS), torch.zeros(3, TONES, dtype=torch.float64)
    found = echo_gain(whitener, draw(TONES, SENSORS), parents, power, SHARE, torch.tensor(False))
    assert found.item() == 0


def test_an_object_whose_response_is_not_right_is_still_one_object():
    """25 dB over the noise of an element, 6 and 16 % of the energy beside the response: found, in its place,
    and nothing else, where all that a free signature could take was taken from it before."""
    errors = torch.randn(2, 8, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    for size in (0.25, 0.4):
        at = {"snr_db": 25.0, "num_snapshots": 8}
        data = [simulate(seed, ((0.0, -20.0), (20.0, -10.0)), **at)[0] for seed in range(4)]
        wrong = torch.stack(data) * (1 + size * torch.complex(*errors) / 2**0.5)
        measurement = from_snapshots(wrong)
        streams = RandomStreams.from_seeds(range(4), (4,), torch.float64)
        with torch.inference_mode():
            history = make_tracker().run(measurement, data_priors(measurement), streams)
        near = (history.position[..., 0] + 15).abs() < 8
        assert history.declared.sum(-1).eq(1).all()
        assert (history.declared & near).any(-1).all()


def heard(own: torch.Tensor, level: float, count: int = 4) -> float:
    """What echoes are worth for a source of amplitudes `(J,)` and some power beside one of power 100."""
    field = make_tracker().field
    responses = [field(torch.tensor([b, 0.0], dtype=torch.float64)) for b in (-20.0, 25.0)]
    moment = torch.stack([a[..., None] * a[..., None, :].conj() for a in responses])
    strength = torch.tensor([[100.0] * 2, [level] * 2], dtype=torch.float64)
    parent = 10 * PARENT[:count]
    z = parent[:, None] * responses[0][:, None] + level**0.5 * own[:count, None] * responses[1][:, None]
    others = 100 * moment[0] + 0.01 * torch.eye(8)
    whitener = whiten(from_snapshots(z + 0.1 * draw(2, count, 8, seed=9)), others)
    at, new = torch.tensor(1), torch.tensor(False)
    return FreeSignatures().echo(whitener, at, moment, strength, new).item()


PARENT = draw(8, seed=6)


def test_amplitudes_tell_an_echo_from_an_object():
    """Of the parent's amplitudes; of its own, of which the parent's explain a share of 1 / J; as strong as a
    fifth of its parent and more, which is no echo; and of one snapshot, of which nobody can tell."""
    echo, own = heard(PARENT, 1.0, 8), heard(draw(8, seed=7), 1.0, 8)
    assert echo > 200
    assert own < 0.5 * echo
    assert heard(PARENT, 25.0, 8) == 0
    assert heard(PARENT, 1.0, 1) == 0
