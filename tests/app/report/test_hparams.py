import math

import pytest
import torch

from torchdt.app.report.files import metrics_summary
from torchdt.app.report.hparams import row_metrics, row_settings

CONFIG = {
    "scenario": {"name": "line_array", "snr_db": 10.0, "coordinates": [{"name": "bearing"}]},
    "tracker": {"particles": 300, "schedule": "flooding", "power_max": None, "driving_variance": [1.0]},
    "data": {"kind": "simulated", "path": None},
    "logging": {"figures": True},
    "seed": 7,
    "runs": 2,
    "dtype": "float64",
    "threads": 1,
}
PLAIN = {
    "scenario": "line_array",
    "tracker": "direct",
    "tracker.particles": 300,
    "tracker.schedule": "flooding",
    "seed": 7,
    "runs": 2,
    "dtype": "float64",
}


def test_scenario_tracker_and_seed():
    assert row_settings(CONFIG, "direct", []) == PLAIN


def test_what_the_command_line_set():
    given = [
        "scenario=line_array",
        "tracker.particles=300",
        "scenario.snr_db=10",
        "model.motion.driving_variance=[1.0]",
        "+data.path=null",
        "field=mine",
        "~scenario.sources.moving",
        "logging.figures=true",
        "hydra.job.name=x",
    ]
    found = row_settings(CONFIG, "direct", given)
    # Numbers as numbers; what is no scalar, as it was given.
    more = {
        "scenario.snr_db": 10.0,
        "model.motion.driving_variance": "[1.0]",
        "data.path": "null",
        "field": "mine",
    }
    assert found == PLAIN | more


def test_metrics(history, score):
    summary = metrics_summary("direct", history, score, seed=0, seconds=4.0)
    metrics = row_metrics(summary, declared=1.5)
    assert metrics == {
        "gospa": pytest.approx(score.total.mean().item()),
        "localisation": pytest.approx(1.0),
        "missed": pytest.approx(50.0),
        "false": pytest.approx(100 / 12),
        "declared": 1.5,
        "log_likelihood_per_step": pytest.approx(-2.0),
        "seconds": 4.0,
        "steps_per_second": 3.0,
    }


def test_metrics_of_what_is_not_known(history):
    unknown = history._replace(log_evidence=torch.full_like(history.log_evidence, math.nan))
    metrics = row_metrics(metrics_summary("mp_bp", unknown, None, seed=0, seconds=4.0), declared=1.0)
    assert [metrics[name] for name in ("gospa", "localisation", "missed", "false")] == [None] * 4
    assert math.isnan(metrics["log_likelihood_per_step"])
