"""An intensity over some steps, against a chain with dense matrices."""

import math

import pytest
import torch
from oracles.line_array import make_tracker, simulate
from oracles.undetected import F64, Levels, log_ratios, run_chain

from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.context import StepContext
from torchdt.filter.intensity.intensity import tone_powers, update_intensity
from torchdt.filter.intensity.settings import Intensity
from torchdt.filter.intensity.undetected import log_ratio
from torchdt.filter.proposal.cells import Unexplained, cell_statistics
from torchdt.model.measurement import from_snapshots

NOISE, STEPS = 1 / 8, 12
NUMBERS = {"birth_mean": 0.01, "survival": 0.9, "power_shape": 5.0, "driving_variance": [0.02]}


def three_points(mean: float, variance: float) -> list[tuple[int, float]]:
    """Cells and weights of the given moments; of the least variance where cells have no less."""
    whole = round(mean)
    rest = mean - whole
    square = max(variance, abs(rest) * (1 - abs(rest))) + rest**2
    return [(whole - 1, (square - rest) / 2), (whole, 1 - square), (whole + 1, (square + rest) / 2)]


def dense(grid, cells: int, width: float, driving: float, levels: torch.Tensor) -> torch.Tensor:
    """From node, level and cell to node, level and cell, one time step of a second."""
    nodes, number = len(grid.node), len(levels)
    edge, matrix = grid.edge.item(), torch.zeros(nodes, number, cells, nodes, number, cells, dtype=F64)
    for v in range(nodes):
        rate = grid.node[v].item()
        within = edge**2 / 12
        for c in range(cells):
            for by, first in three_points(rate / width, (within + driving / 4) / width**2):
                for turn, second in three_points(0.0, driving / edge**2):
                    if 0 <= c + by < cells:
                        to = min(max(v + turn, 0), nodes - 1)
                        matrix[v, :, c, to, :, c + by] += first * second * levels
    return matrix.reshape(nodes * number * cells, -1)


def steps_of(tracker, snapshots, likelihood_power=1.0):
    """Intensities `(K, V, L, C)` and evidence `(K,)` with the noise known and nothing else there."""
    undetected, model, power = tracker.undetected, tracker.model, torch.tensor(likelihood_power, dtype=F64)
    model = model.with_numbers({"likelihood_power": power})
    intensity, found, evidence = undetected.init(torch.Size()), [], []
    for data in snapshots:
        measurement = from_snapshots(data)
        noise = torch.full((2,), NOISE, dtype=F64)
        background = NOISE * torch.eye(8, dtype=torch.complex128).expand(2, 8, 8)
        tempered = measurement.tempered(power)
        residual = Unexplained(
            cell_statistics(tracker.dictionary, whiten(tempered, background)), noise, torch.zeros_like(noise)
        )
        context = StepContext(tracker.field, tracker.region, model, model.noise, measurement)
        at = tone_powers(context, noise, undetected.moment, undetected.settings)
        ratio = log_ratio(context, residual, *at)
        predicted = undetected.predict(intensity, model)
        intensity, log_evidence = update_intensity(predicted, ratio, power, undetected.settings.step_nats)
        found.append(intensity)
        evidence.append(log_evidence)
    return torch.stack(found), torch.stack(evidence)


@pytest.fixture(scope="module")
def tracker():
    settings = Intensity(levels=3, hypotheses=70 * 3 * 2)
    return make_tracker(undetected=settings, **NUMBERS)


@pytest.fixture(scope="module")
def snapshots():
    return simulate(1, ((0.0, -20.0), (12.0, -12.0)), steps=STEPS, snr_db=0.0, powers_db=(-12.0,))[0]


def test_intensity_and_evidence_are_those_of_a_dense_chain(tracker, snapshots):
    grid = tracker.undetected.grid
    assert grid.axes == (2,)
    away = torch.special.polygamma(1, torch.tensor(5.0, dtype=F64))
    level = torch.tensor([0.1, 1.0, 10.0], dtype=F64)
    near = float(away) / math.log(10) ** 2 / 2
    walk = torch.tensor([[1 - near, near, 0], [near, 1 - 2 * near, near], [0, near, 1 - near]], dtype=F64)
    power = NOISE * torch.tensor([0.01, 0.1, 1.0, 10.0, 100.0], dtype=F64)
    share = torch.zeros(3, 6, dtype=F64)
    for n in range(3):
        share[n, [0, n + 1, n + 2, n + 3]] = torch.tensor([0.15, 0.25, 0.45, 0.15], dtype=F64)
    levels = Levels(power, share, walk)
    response = tracker.field(tracker.region.cell_centres())
    ratio = torch.stack([log_ratios(response, data, NOISE, levels).mT for data in snapshots]).exp()
    number = 2 * 3 * 70
    birth = torch.full((number,), 0.01 / number, dtype=F64)
    each = ratio[:, None].expand(-1, 2, -1, -1).reshape(STEPS, number)
    transition = dense(grid, 70, 2.0, 0.02, walk)
    odds, expected = run_chain(transition, birth, 0.9, each)
    found, evidence = steps_of(tracker, snapshots)
    torch.testing.assert_close(level, grid.level)
    torch.testing.assert_close(found.flatten(1), odds, rtol=1e-9, atol=0)
    torch.testing.assert_close(evidence, expected, rtol=1e-9, atol=1e-12)
    assert odds[-1].sum() > 4 * odds[0].sum()


def test_one_step_adds_so_much_to_the_intensity_and_all_it_says_to_the_evidence():
    predicted = torch.full((1, 1, 2, 3), 1e-12, dtype=F64)
    log_ratio = torch.tensor([[[0.0, -1.0, 25.0], [0.0, 5.0, 12.0]]], dtype=F64)
    power = torch.tensor(1.0, dtype=F64)
    updated, log_evidence = update_intensity(predicted, log_ratio, power, 10.0)
    torch.testing.assert_close(updated, predicted * log_ratio.clamp_max(10.0).exp())
    expected = (1 + 1e-12 * log_ratio.exp().sum()).log() - 6e-12
    torch.testing.assert_close(log_evidence[0], expected, rtol=1e-9, atol=1e-12)
    tempered, same = update_intensity(predicted, log_ratio, power / 2, 10.0)
    torch.testing.assert_close(tempered, predicted * (log_ratio / 2).clamp_max(10.0).exp())
    torch.testing.assert_close(same, log_evidence)
