"""New objects of the paper's graph: the cells that matching pursuit picks, and the prior in a cell."""

import math

import numpy as np
import pytest
import torch
from oracles.line_array import BEARING, make_field, make_region, simulate

from torchdt.filter.paper.births import newborn, pick_cells
from torchdt.filter.proposal.dictionary import Dictionary, build_dictionary
from torchdt.model.birth import UniformBirth
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.model import Model
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
TWO = (((0.0, -41.0), (20.0, -41.0)), ((0.0, 31.0), (20.0, 31.0)))


@pytest.fixture(scope="module")
def dictionary() -> Dictionary:
    return build_dictionary(make_field(), make_region())


def plain_pursuit(response: np.ndarray, residual: np.ndarray, present: np.ndarray, number: int) -> list[int]:
    """Of responses (I, C, M), data (I, J, M) and the sensors (I, M) that are heard."""
    picks: list[int] = []
    residual, atoms = residual * present[:, None], response * present[:, None]
    for _ in range(number):
        best = None
        for cell in range(atoms.shape[1]):
            unit = atoms[:, cell] / np.linalg.norm(atoms[:, cell], axis=-1, keepdims=True)
            taken = np.stack([np.outer(residual[i] @ unit[i].conj(), unit[i]) for i in range(len(unit))])
            left = np.linalg.norm(residual - taken)
            if cell not in picks and (best is None or left < best[0]):
                best = left, cell, residual - taken
        assert best is not None
        picks.append(best[1])
        residual = best[2]
    return picks


@pytest.mark.parametrize("missing", [False, True])
def test_cells_are_those_of_a_plain_pursuit(dictionary, missing):
    data = torch.stack([simulate(seed, *TWO, steps=1)[0][0] for seed in range(2)])
    if missing:
        data[0, 1, :, :3] = torch.nan
    measurement = from_snapshots(data)
    # Responses of unlike norms: what counts is the energy that a cell explains.
    norm = torch.linspace(1, 3, dictionary.response.shape[1], dtype=F64)[:, None]
    response = norm * dictionary.response
    scaled = Dictionary(dictionary.points, response, response.abs().square().sum(-1))
    expected = [
        plain_pursuit(response.numpy(), z.nan_to_num().numpy(), present.numpy(), 6)
        for z, present in zip(data, measurement.present, strict=True)
    ]
    assert pick_cells(scaled, measurement, 6).tolist() == expected
    of_each = Dictionary(scaled.points, *(t.expand(2, *t.shape) for t in scaled[1:]))
    assert pick_cells(of_each, measurement, 6).tolist() == expected
    one = Measurement(*(t[0] for t in measurement))
    assert pick_cells(scaled, one, 6).tolist() == expected[0]


def test_cells_hold_the_sources(dictionary):
    cells = pick_cells(dictionary, from_snapshots(simulate(0, *TWO, steps=1, snr_db=30.0)[0][0]), 2)
    assert sorted(dictionary.points[cells].flatten().tolist()) == [-41.0, 31.0]


def test_no_cell_is_picked_where_no_object_can_be(dictionary):
    silent = torch.zeros_like(dictionary.response)
    silent[:, 20:24] = dictionary.response[:, 20:24]
    few = Dictionary(dictionary.points, silent, silent.abs().square().sum(-1))
    data = from_snapshots(simulate(0, *TWO, steps=1)[0][0])
    assert sorted(pick_cells(few, data, 4).tolist()) == [20, 21, 22, 23]
    assert sorted(pick_cells(few, data.silent(), 4).tolist()) == [20, 21, 22, 23]


def test_the_prior_of_a_cell():
    """Uniform draws at their ends reach the ends of cell, rates and powers; odds are `mu_B / Q`."""
    region = make_region()
    ends = torch.tensor([0.0, 1.0], dtype=F64)
    along = ends.repeat_interleave(2)[None, :, None]
    # Far out in a normal density: the ends of the rates.
    extra = torch.tensor([-40.0, 40.0], dtype=F64).repeat(2)[None, :, None]
    share = torch.tensor([[[0.0, 0.75], [0.5, 0.25]]], dtype=F64)
    points, maximum = torch.tensor([[31.0]], dtype=F64), torch.tensor([2.0, 4.0], dtype=F64)
    model = Model(birth=UniformBirth(birth_mean=0.07)).on(region)
    found = newborn(points, region, model, maximum, along, extra, share)
    corners = [[30.0, -1.0], [30.0, 1.0], [32.0, -1.0], [32.0, 1.0]]
    assert found.state[0].tolist() == corners
    assert found.power[0].tolist() == [[2.0, 0.5], [2.0, 3.0]]
    torch.testing.assert_close(found.log_weight.exp(), torch.full((1, 4), 0.25, dtype=F64))
    torch.testing.assert_close(found.log_power_weight.exp(), torch.full((1, 2, 2), 0.5, dtype=F64))
    assert found.log_odds.tolist() == pytest.approx([math.log(0.07 / 70)])
    assert found.label.tolist() == [0]


def test_a_cell_outside_the_region_brings_nothing():
    """And in one that is cut, the particles outside have no weight."""

    region = Region([Coordinate(**BEARING)], F64, inside=lambda state: state[..., 0] > 31.5)
    generator = torch.Generator().manual_seed(0)
    along = torch.rand(2, 50, 1, generator=generator, dtype=F64)
    share = torch.rand(2, 1, 3, generator=generator, dtype=F64)
    points = torch.tensor([[31.0], [11.0]], dtype=F64)
    found = newborn(points, region, Model().on(region), torch.ones(1, dtype=F64), along, along, share)
    assert found.log_odds.isfinite().tolist() == [True, False]
    outside = found.state[0, :, 0] <= 31.5
    assert outside.any()
    assert torch.equal(found.log_weight[0].isneginf(), outside)
    torch.testing.assert_close(found.log_weight[0].exp().sum(), torch.ones((), dtype=F64))
