import numpy as np
import pytest
import torch

from torchdt.app.build import simulate

BAR = ("logging=default", "logging.figures=false", "logging.tensorboard=false")
"""A progress bar alone."""


def table(outcome, run=None):
    rows = [[float(value) for value in row.values()] for row in outcome.rows("tracks.csv")]
    rows = np.array(rows).reshape(len(rows), -1)
    return rows if run is None else rows[rows[:, 0] == run]


def test_same_seed_same_tracks(launch):
    first, second = launch("seed=5"), launch("seed=5")
    np.testing.assert_array_equal(table(first), table(second))
    assert first.values == second.values


@pytest.mark.slow
def test_batch_equals_single_runs(launch):
    """Run b has seed `seed + b`."""
    together, alone = launch("runs=2", "seed=2"), launch("seed=3")
    first, second = np.reshape(together.scores, (2, -1))
    assert (first != second).any()
    np.testing.assert_allclose(second, alone.scores, atol=1e-3)
    np.testing.assert_allclose(table(together, 1)[:, 1:], table(alone)[:, 1:], rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_chunks_give_the_tracks_of_the_batch(launch):
    whole = launch("runs=3", "workers=1")
    chunked = launch("runs=3", "workers=2", "memory_gb=1e-6", *BAR, terminal=True)
    assert chunked.status == 0, chunked.err
    assert "15/15" in chunked.err  # steps of all runs
    assert f"GOSPA {chunked.values[0]:.2f}" in chunked.err
    np.testing.assert_allclose(table(chunked), table(whole), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(chunked.scores, whole.scores, atol=1e-3)


def test_noise_alone_declares_nothing(launch):
    silent = launch("~scenario.sources.first", "~scenario.sources.second")
    assert silent.status == 0, silent.err
    assert silent.values == [0.0]
    assert silent.rows("tracks.csv") == []


def test_sources_are_found(launch):
    outcome = launch("scenario.num_steps=20", "runs=2")
    assert outcome.values[0] < 2  # degrees; 7.5 with nothing declared, at a cutoff of 10
    counts = {(row["num_truth"], row["num_estimated"]) for row in outcome.rows("gospa.csv")[-4:]}
    assert counts == {("2", "2")}


@pytest.fixture(scope="module")
def nominal(launch):
    """Tracks without any option."""
    return launch().rows("tracks.csv")


@pytest.mark.slow
@pytest.mark.parametrize(
    "override",
    [
        "dtype=float64",
        "model.likelihood_power=0.5",
        "scenario.amplitudes=constant_modulus",
        "tracker.power_max=5",
    ],
)
def test_options_run(launch, nominal, override):
    outcome = launch(override)
    assert outcome.status == 0, outcome.err
    assert outcome.values[0] < 5
    assert outcome.rows("tracks.csv") != nominal  # the option does something


@pytest.fixture(scope="module")
def water(settings):
    """Snapshots in the waveguide of the paper at its lowest tone."""

    def water(*overrides):
        size = ("scenario.num_steps=2", "field.freqs=[49]", "calibration=none")
        return simulate(settings(*size, *overrides, small=False)).snapshots

    return water


@pytest.mark.slow
@pytest.mark.parametrize("key", ["eof_scale=1", "tilt_deg=[0.5,1.0]", "water_depth_m=[1,1]"])
def test_mismatch_changes_the_data(water, key):
    assert not torch.equal(water(f"scenario.mismatch.{key}"), water())


@pytest.mark.slow
def test_multirun(launch):
    outcome = launch("-m", "seed=0,1", terminal=True)
    assert outcome.status == 0, outcome.err
    jobs = [outcome.directory / str(job) for job in range(2)]
    seeds = [(job / "metrics.json").read_text().partition('"seed": ')[2][0] for job in jobs]
    assert seeds == ["0", "1"]
    assert outcome.values[1:] == launch("seed=1").values
    assert outcome.err == ""  # no progress bar
    assert "┃" not in outcome.out  # no table


def test_progress_bar_on_a_terminal(launch):
    outcome = launch(*BAR, terminal=True)
    assert "5/5" in outcome.err
    assert "declared 1" in outcome.err
    assert f"GOSPA {outcome.values[0]:.2f}" in outcome.err


@pytest.mark.parametrize(
    ("override", "terminal"), [("logging.progress=true", False), ("logging.progress=false", True)]
)
def test_no_progress_bar(launch, override, terminal):
    outcome = launch(override, terminal=terminal)
    assert outcome.status == 0
    assert outcome.err == ""
