import math

import pytest
import torch

from benchmarks import update

pytestmark = pytest.mark.slow
SIZES = {"slots": 3, "particles": 20, "tones": 2, "sensors": 6, "snapshots": 3}
SIZES |= {"power_points": 4, "noise_points": 5, "sweeps": 2, "batch": 2}


@pytest.fixture(scope="module")
def rows():
    """Rows by quantity."""
    return {row.quantity: row for row in update.measure_update("cpu", 2, **SIZES)}


def test_rows_and_their_units(rows):
    assert {name: row.unit for name, row in rows.items()} == {
        "torchdt": "ms/step",
        "torchdt, batch of 2": "ms/step",
        "matrix products, batch": "GFLOP/s",
        "matrix products / machine": "ratio",
        "NumPy": "ms/step",
        "one Cholesky per particle": "ms/step",
        "NumPy / torchdt": "ratio",
        "NumPy / torchdt, batch of 2": "ratio",
        "one Cholesky per particle / torchdt": "ratio",
        "difference of existence": "probability",
        "difference of existence x power": "of the largest",
    }
    assert {row.part for row in rows.values()} == {"update"}


def test_every_number_is_finite_and_times_are_positive(rows):
    for name, row in rows.items():
        assert math.isfinite(row.value)
        assert row.value > 0 or name.startswith("difference")


def test_single_precision_agrees(rows):
    assert rows["difference of existence"].value < 1e-3
    assert rows["difference of existence x power"].value < 1e-3


def test_what_is_extrapolated_says_so(rows):
    said = [name for name, row in rows.items() if "EXTRAPOLATED" in row.note]
    assert said == ["one Cholesky per particle", "one Cholesky per particle / torchdt"]
    assert "x 12 visits" in rows[said[0]].note  # 3 objects, 2 tones, 2 sweeps


def test_the_problem_is_told(rows):
    assert rows["torchdt"].note == (
        "float32; 3 objects, 20 particles, 2 tones, 6 sensors, 3 snapshots, "
        "4 power and 5 noise points, 2 sweeps"
    )


def test_ratios_are_those_of_the_same_round():
    seconds = {"one": [1.0, 2.0, 4.0], "many": [0.5, 1.0, 4.0], "plain": [3.0, 8.0, 8.0]}
    seconds["cholesky"] = [30.0, 40.0, 48.0]
    found = {row[0]: row for row in update.plain_rows(seconds, 16, 10)}
    assert found["NumPy"][1] == 8e3
    assert found["one Cholesky per particle"][1] == 4e4
    assert "4e+03 ms of a visit" in found["one Cholesky per particle"][3]
    assert found["NumPy / torchdt"][1] == 3
    assert found["NumPy / torchdt, batch of 16"][1] == 6
    assert found["one Cholesky per particle / torchdt"][1] == 20


def test_operations_are_those_of_the_matrix_products():
    # (10 x 4)(4 x (4 + 3)) and (4 x 10)(10 x 4), 8 real operations each.
    assert update.count_operations(10, 4, 3) == 8 * (10 * 4 * 7 + 4 * 10 * 4)
    rate, share = update.product_rows(2 * 1024**3, [2.0, 1.0, 4.0], [1.0, 1.0, 1.0])
    assert rate[1] == pytest.approx(1.0737, rel=1e-4)
    assert share[1] == pytest.approx(0.5)


def test_disagreement_is_seen():
    problem = update.quieten(*update.random_problem((), 3, 20, 2, 6, 3, 4, 5, torch.float32, "cpu", 0))
    expected = update.ORACLE.update(update.plain_problem(*problem))
    one_sweep = update.update(*problem, sweeps=1)
    assert all(row[1] > 1e-4 for row in update.agreement_rows(one_sweep, expected))
