import functools

import numpy as np
import pytest


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
    together = launch("runs=3", "seed=2", "scenario.num_steps=10")
    scores = np.reshape(together.scores, (3, -1))
    assert len({tuple(row) for row in scores}) == 3  # three different sequences
    for run in range(3):
        alone = launch(f"seed={2 + run}", "scenario.num_steps=10")
        np.testing.assert_allclose(scores[run], alone.scores, atol=1e-3)
        np.testing.assert_allclose(table(together, run)[:, 1:], table(alone)[:, 1:], rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_chunks_give_the_tracks_of_the_batch(launch):
    whole = launch("runs=3", "workers=1")
    chunked = launch("runs=3", "workers=2", "memory_gb=1e-6", "logging=default", terminal=True)
    assert chunked.status == 0, chunked.err
    assert "15/15" in chunked.err  # steps of all runs
    assert f"GOSPA {chunked.values[0]:.2f}" in chunked.err
    np.testing.assert_allclose(table(chunked), table(whole), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(chunked.scores, whole.scores, atol=1e-3)


def test_noise_alone_declares_nothing(launch):
    silent = launch("scenario.num_steps=30", "~scenario.sources.first", "~scenario.sources.second")
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
    """Tracks of so many steps, without any option."""
    return functools.cache(lambda steps: launch(f"scenario.num_steps={steps}").rows("tracks.csv"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "num_steps"),
    [
        ("dtype=float64", 5),
        ("tracker/schedule=flooding", 20),  # the same as sequential until the second source is born
        ("model.likelihood_power=0.5", 5),
        ("scenario.amplitudes=constant_modulus", 5),
        ("tracker.power_max=5", 5),
    ],
)
def test_options_run(launch, nominal, override, num_steps):
    outcome = launch(f"scenario.num_steps={num_steps}", override)
    assert outcome.status == 0, outcome.err
    assert outcome.values[0] < 5
    assert outcome.rows("tracks.csv") != nominal(num_steps)  # the option does something


WATERS = (
    "scenario.num_steps=2",
    "calibration=none",
    "tracker.particles=50",
    "tracker.births=2",
    "tracker.proposal.rounds=1",
)


@pytest.fixture(scope="module")
def matched(launch):
    return launch(*WATERS, small=False).json("metrics.json")


@pytest.mark.slow
@pytest.mark.parametrize("key", ["eof_scale=1", "tilt_deg=[0.5,1.0]", "water_depth_m=[1,1]"])
def test_mismatch_changes_the_data(launch, matched, key):
    outcome = launch(*WATERS, f"scenario.mismatch.{key}", small=False)
    assert outcome.status == 0, outcome.err
    assert outcome.json("metrics.json")["log_likelihood"] != matched["log_likelihood"]


@pytest.mark.slow
def test_multirun(launch):
    outcome = launch("-m", "seed=0,1", terminal=True)
    assert outcome.status == 0, outcome.err
    jobs = [outcome.directory / str(job) for job in range(2)]
    seeds = [(job / "metrics.json").read_text().partition('"seed": ')[2][0] for job in jobs]
    assert seeds == ["0", "1"]
    assert outcome.values == [launch(f"seed={seed}").values[0] for seed in range(2)]
    assert outcome.err == ""  # no progress bar
    assert "┃" not in outcome.out  # no table


def test_progress_bar_on_a_terminal(launch):
    outcome = launch("logging=default", "logging.figures=false", terminal=True)
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
