import math

import pytest
import torch
from oracles.line_array import make_field, make_region, simulate

from benchmarks import sbl
from torchdt.baselines.detect.config import SblConfig
from torchdt.baselines.detect.peaks import Grid
from torchdt.baselines.detect.sbl import SparseBayesianLearning
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.measurement import from_snapshots

pytestmark = pytest.mark.slow
PATHS = (((0.0, -20.0), (20.0, -20.0)), ((0.0, 30.0), (20.0, 30.0)))


@pytest.fixture(scope="module")
def problem():
    """Detector, and two steps of two sources."""
    field, region = make_field(torch.float32), make_region(torch.float32)
    config = SblConfig(tolerance=1e-3)
    detector = SparseBayesianLearning(field, region, build_dictionary(field, region), config)
    snapshots, _ = simulate(0, *PATHS, steps=2)
    return detector, [from_snapshots(z) for z in snapshots.to(torch.complex64)]


@pytest.fixture(scope="module")
def rows(problem):
    """Rows by quantity."""
    return {row.quantity: row for row in sbl.measure_sbl(*problem, repeats=2)}


def test_detection_finds_the_peaks_of_the_plain_formulation(rows):
    assert rows["steps with identical peaks"].value == 2
    common = rows["peaks in common"]
    assert common.unit == f"of {common.value}"
    assert common.value >= 4
    own, plain = (rows[f"iterations of {name}"].value for name in ("torchdt", "matrix products"))
    assert own == pytest.approx(plain, rel=0.1)


def test_every_number_is_positive_and_finite(rows):
    assert all(math.isfinite(row.value) and row.value > 0 for row in rows.values())


def test_the_outer_products_are_said_to_be_extrapolated(rows):
    said = [quantity for quantity, row in rows.items() if "EXTRAPOLATED" in row.note]
    assert said == ["NumPy, outer products", "outer products / torchdt"]
    assert "median of 2 iterations" in rows[said[0]].note


def test_the_problem_is_told(rows):
    assert rows["torchdt"].note == "float32, grid (70,), prune 1e-06, at most 300 iterations"


def test_memory_is_that_of_a_process_of_its_own(rows):
    detection, process = (rows[f"peak memory of {name}"].value for name in ("detection", "torchdt"))
    assert detection < process < 4096


def test_only_high_local_maxima_are_compared():
    power = torch.tensor([0.0, 5.0, 1.0, 0.1, 0.2, 0.1, 1e-3, 4e-3, 0.0, 6e-3])
    assert sbl.high_peaks(power, Grid((10,), (False,))) == {1, 4, 9}  # of 4e-3 at cell 7: below 1e-3 of 5
    assert sbl.high_peaks(power.double(), Grid((10,), (False,))) == {1, 4, 9}
