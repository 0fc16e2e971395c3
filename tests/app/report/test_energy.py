"""Where the energy of a recording went, and what is said of it."""

import torch

from torchdt.app.report.energy import energy_line, energy_rows, hints, mean_shares
from torchdt.filter.history import history_like


def history(shares: list[list[float]]):
    """Two runs of three steps and two tones, the last step without data."""
    sizes = history_like(2, 3, 1, 1, 2, 2, torch.float64)
    values = torch.tensor(shares, dtype=torch.float64)[:, None, None].repeat(1, 3, 2, 1)
    values[:, -1] = 0
    return sizes._replace(shares=values)


def test_the_mean_is_over_what_was_heard():
    found = mean_shares(history([[0.8, 0.0, 0.2, 0.0], [0.4, 0.4, 0.2, 0.0]]))
    assert {name: round(share, 9) for name, share in found.items()} == {
        "objects": 0.6,
        "interferers": 0.2,
        "noise": 0.2,
        "unexplained": 0.0,
    }
    assert energy_line(found) == "energy: objects 60.0 %, interferers 20.0 %, noise 20.0 %, unexplained 0.0 %"


def test_only_the_run_that_is_not_explained_is_doubted():
    (hint,) = hints(history([[0.8, 0.1, 0.1, 0.0], [0.4, 0.3, 0.2, 0.1]]))
    assert hint.startswith("run 1: 40 % of the energy")
    assert all(word in hint for word in ("region", "channels", "field.sign", "sensors"))


def test_a_tracker_that_does_not_know_says_nothing():
    silent = history([[0.0] * 4, [0.0] * 4])
    assert mean_shares(silent) is None
    assert hints(silent) == []


def test_rows_hold_the_level_beside_the_shares():
    shares = torch.tensor([[[[0.5, 0.1, 0.4, 0.0], [0.2, 0.2, 0.6, 0.0]]]])
    rows = energy_rows(shares.double(), torch.tensor([[[2.0, 3.0]]]), [["0.5"]])
    assert [row[:5] for row in rows] == [(0, 0, "0.5", 1, 2.0), (0, 0, "0.5", 2, 3.0)]
    assert rows[0][5:] == tuple(shares[0, 0, 0].double().tolist())
