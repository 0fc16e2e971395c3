"""`variants` of `experiments/track.py`: settings of the model side by side."""

import dataclasses

import numpy as np
import pytest

from torchdt.data.npz import write_npz

pytestmark = pytest.mark.slow
VARIANTS = "variants=[{survival: 0.9},{survival: 0.99, birth_mean: 1e-2, driving_variance: [1e-2]}]"
LONG = ("scenario.num_steps=6", "runs=2", "seed=3")


@pytest.fixture(scope="module")
def run(launch):
    outcome = launch(VARIANTS, *LONG)
    assert outcome.status == 0, outcome.err
    return outcome


@pytest.fixture(scope="module")
def alone(launch):
    """The settings one by one."""
    settings = [
        ("model.survival=0.9",),
        ("model.survival=0.99", "model.birth.birth_mean=1e-2", "model.motion.driving_variance=[1e-2]"),
    ]
    return [launch(*values, *LONG) for values in settings]


def test_one_row_for_each_setting(run, alone):
    rows = run.rows("variants.csv")
    assert [row["variant"] for row in rows] == ["0", "1"]
    assert [row["survival"] for row in rows] == ["0.9", "0.99"]
    assert [row["birth_mean"] for row in rows] == ["0.0001", "0.01"]
    assert [row["driving_variance"] for row in rows] == ["", "[0.01]"]
    assert {row["noise_shape"] for row in rows} == {"100"}
    for row, outcome in zip(rows, alone, strict=True):
        metrics = outcome.json("metrics.json")
        assert float(row["log_likelihood"]) == pytest.approx(metrics["log_likelihood"], rel=1e-4)
        for column, name in (("gospa", "mean"), *((n, n) for n in ("localisation", "missed", "false"))):
            assert float(row[column]) == pytest.approx(metrics["gospa"][name], abs=1e-2)
    assert rows[0]["log_likelihood"] != rows[1]["log_likelihood"]


def test_runs_count_variant_by_variant(run, alone):
    assert run.json("metrics.json")["num_runs"] == 4
    assert run.values == [pytest.approx(np.mean(run.scores))]
    scores = np.reshape(run.scores, (2, -1))
    for v, outcome in enumerate(alone):
        np.testing.assert_allclose(scores[v], outcome.scores, atol=1e-2)
    assert {row["run"] for row in run.rows("tracks.csv")} == {"0", "1", "2", "3"}


def test_without_truth_the_score_is_empty(launch, recording, tmp_path):
    write_npz(tmp_path / "blind.npz", dataclasses.replace(recording, truth=None))
    outcome = launch(VARIANTS, "data=npz", f"data.path={tmp_path / 'blind.npz'}")
    assert outcome.status == 0, outcome.err
    for row in outcome.rows("variants.csv"):
        assert {row[name] for name in ("gospa", "localisation", "missed", "false")} == {""}
        assert float(row["log_likelihood"])


def test_no_table_without_variants(launch):
    assert not (launch().directory / "variants.csv").exists()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["variants=[{},{survival: 1.5}]"], "key 'variants[1].survival': found 1.5, expected a probability"),
        (["variants=[{colour: 1}]"], "key 'variants[0].colour': found an unknown number, expected one of"),
        (["variants=[]"], "key 'variants': found none, expected one setting or more"),
        (
            ["variants=[{}]", "tracker=mp_bp"],
            "key 'tracker': found TwoStepConfig, expected settings of direct",
        ),
        (
            ["variants=[{}]", "tracker=direct_paper"],
            "key 'tracker': found PaperConfig, expected settings of direct",
        ),
    ],
)
def test_what_makes_no_sense_is_named(launch, overrides, message):
    outcome = launch("scenario=line_array", *overrides, small=False)
    assert outcome.status == 1
    assert message in outcome.err
    assert not (outcome.directory / "metrics.json").exists()
