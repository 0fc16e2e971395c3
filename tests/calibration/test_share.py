"""Share of each tone that the field does not cover, on data made with a known share."""

import pytest
import torch
from oracles.arrays import direct_log_likelihood

from torchdt.calibration.share import SHARES, mismatch_share

F64 = torch.float64


def truth_of(tracks, steps: int = 16):
    return tracks(steps), torch.ones(steps, 2, dtype=torch.bool)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_exact_data_leave_nothing(nominal, tracks, measure, seed):
    truth, active = truth_of(tracks)
    assert (mismatch_share(nominal, truth, active, measure(nominal(truth), seed)) <= 0.003).all()


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("share", [0.02, 0.08, 0.3])
def test_finds_the_share_of_the_simulation(nominal, tracks, measure, scattered, share, seed):
    """Within one point of the grid: 16 steps and two sources of 20 effective dimensions."""
    truth, active = truth_of(tracks)
    found = mismatch_share(nominal, truth, active, measure(scattered(nominal, truth, share, seed), seed))
    assert found.shape == (3,)
    at = SHARES.index(share)
    assert set(found.tolist()) <= set(SHARES[at - 1 : at + 2])


def test_each_tone_has_its_own(nominal, tracks, measure, scattered):
    truth, active = truth_of(tracks)
    response = torch.stack(
        [scattered(nominal, truth, share, 3)[..., i, :] for i, share in enumerate((0.3, 0.0, 0.04))], -2
    )
    found = mismatch_share(nominal, truth, active, measure(response, 3))
    assert found[0] >= 0.15
    assert found[1] <= 0.003
    assert 0.02 <= found[2] <= 0.08


def test_absent_sources_and_missing_sensors_are_left_out(nominal, tracks, measure, scattered):
    """A second source that is not there, at a place where its energy would be seen; dead sensors."""
    truth, active = truth_of(tracks)
    response = scattered(nominal, truth, 0.08, 4)
    active[:, 1] = False
    response[:, 1] = 0
    data = measure(response, 4)
    heard = torch.ones_like(data.present)
    heard[..., [3, 17]] = 0
    data = data._replace(present=heard, factor=data.factor * heard[..., None])
    found = mismatch_share(nominal, truth, active, data)
    assert set(found.tolist()) <= {0.04, 0.08, 0.15}
    alone = mismatch_share(nominal, truth[:, :1], active[:, :1], data)
    assert torch.equal(found, alone)


def test_without_any_source_there_is_no_share(nominal, tracks, measure):
    truth, active = truth_of(tracks)
    silent = measure(0 * nominal(truth), 5)
    assert mismatch_share(nominal, truth, active & False, silent).eq(0).all()


def test_is_the_grid_point_of_highest_likelihood(nominal, tracks, measure, scattered):
    """Every pair of share and noise variance by determinant and solve, powers from plain least squares."""
    truth, active = truth_of(tracks, 4)
    active[1, 1] = False
    for seed in range(2):
        z = measure(scattered(nominal, truth, 0.3, seed) * active[..., None, None], seed)
        snapshots, response, incoherent = z.factor.mT, nominal(truth), nominal.incoherent(truth)
        found = mismatch_share(nominal, truth, active, z)
        for i in range(3):
            level = float(z.energy[:, i].mean()) / 21
            noise = level * torch.logspace(-5, 0, 26, dtype=F64)[:, None, None] * torch.eye(21)
            scores = torch.zeros(len(SHARES), 26, dtype=F64)
            for s, n in enumerate(active):
                a, scatter = response[s, n, i], incoherent[s, n, i]
                amplitude = torch.linalg.lstsq(a.mT, snapshots[s, i].mT).solution
                power = amplitude.abs().square().mean(-1)[:, None, None]
                coherent = (power * a[:, :, None] * a[:, None, :].conj()).sum(0)
                for e, share in enumerate(SHARES):
                    covariance = (1 - share) * coherent + share * (power * scatter).sum(0) + noise
                    scores[e] += direct_log_likelihood(snapshots[s, i].expand(26, -1, -1), covariance)
            assert float(found[i]) == SHARES[int(scores.amax(1).argmax())], (seed, i)
