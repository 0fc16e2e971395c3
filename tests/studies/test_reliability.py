import io

import pytest
import torch
from oracles.scripts import call, load, track_settings
from rich.console import Console

from studies.reliability import model_of, potential_objects, print_tenths, tenths
from torchdt.filter.history import history_like
from torchdt.model.distance import EUCLIDEAN

NAN = float("nan")


def draws(power: float, number: int = 20_000):
    """Probabilities in all tenths, and the truth, which is drawn from their power."""
    stream = torch.Generator().manual_seed(5)
    existence, drawn = torch.rand(2, number, generator=stream, dtype=torch.float64)
    return existence, drawn < existence**power


def test_existence_that_is_right_holds():
    """False alarm 1e-4 at most: ten limits at 1e-5."""
    rows = tenths(*draws(1.0))
    assert sum(row.number for row in rows) == 20_000
    assert all(row.holds for row in rows)
    assert [row.expected for row in rows] == pytest.approx([0.05 + 0.1 * t for t in range(10)], abs=0.01)


@pytest.mark.parametrize("power", [0.7, 1.4])
def test_existence_that_is_wrong_does_not(power):
    """Too low or too high by a twelfth in the middle: eight standard deviations there."""
    assert [row.holds for row in tenths(*draws(power))[3:7]] == [False] * 4


def test_certainty_and_nothing():
    rows = tenths(torch.tensor([1.0, 1.0, 0.0]), torch.tensor([True, True, False]))
    assert [row.number for row in rows] == [1, *[0] * 8, 2]
    assert (rows[9].limits, rows[9].exist, rows[9].holds) == ((2, 2), 2, True)
    console = Console(file=io.StringIO(), width=100)
    print_tenths(console, [*rows[:9], rows[9]._replace(exist=1)])
    lines = [line for line in console.file.getvalue().splitlines() if " - " in line]
    assert len(lines) == 10
    assert [line.count("outside") for line in lines] == [*[0] * 9, 1]


def test_every_true_object_is_one_potential_object():
    """Two near the same true object are one that exists and one that does not; an empty slot is none."""
    existence = torch.tensor([[[0.0, 0.9, 0.0], [0.3, 0.8, 0.6]]])
    position = torch.tensor([[[0.0, 1.0, 0.0], [1.0, 2.0, 50.0]]])[..., None]
    like = history_like(1, 2, 3, 1, 2, 1, torch.float32)
    history = like._replace(existence=existence, position=position)
    truth = torch.tensor([[[1.5], [NAN]], [[1.2], [50.5]]], dtype=torch.float64)[None]
    found, exists = potential_objects(history, truth, [1], 5.0, EUCLIDEAN)
    assert found.tolist() == pytest.approx([0.8, 0.6, 0.3])
    assert exists.tolist() == [True, True, False]
    found, exists = potential_objects(history, truth, range(2), 0.1, EUCLIDEAN)
    assert exists.tolist() == [False] * 4
    found, exists = potential_objects(history, truth[:, :, :0], [0], 5.0, EUCLIDEAN)
    assert exists.tolist() == [False]


def test_the_tracker_assumes_what_is_drawn():
    population = track_settings("scenario=line_faint_model", small=False).scenario.population
    chosen = track_settings("scenario=line_faint_model", *model_of(population), small=False)
    known = chosen.statistical_model.known()
    for name in ("birth_mean", "survival", "power_shape", "noise_shape"):
        assert float(known[name]) == getattr(population, name)
    assert chosen.tracker.power_max == pytest.approx(10**-0.4)


@pytest.mark.slow
def test_script():
    small = ("scenario.num_steps=4", "scenario.population.birth_mean=1", "tracker.particles=50")
    status, out, err = call(load("reliability"), "--runs=2", "--every=2", *small)
    assert status == 0, err
    rows = [line for line in out.splitlines() if " - " in line]
    assert len(rows) == 10
    assert sum(int(row.split("│")[2]) for row in rows) > 0
