import csv
import math

import pytest
from oracles.scripts import call, load

pytestmark = pytest.mark.slow

SMALL = ("train_seeds=[3]", "scenario.num_steps=4", "tracker.particles=60", "model.birth.birth_mean=0.1")


def run(tmp_path, *arguments):
    overrides = ",".join(f'"{o}"' for o in SMALL)
    return call(
        load("gradients"),
        f"hydra.run.dir={tmp_path}",
        "hydra/job_logging=none",
        f"overrides=[{overrides}]",
        "repeats=2",
        *arguments,
    )


def test_every_estimator_has_its_rows(tmp_path):
    status, out, _ = run(tmp_path, "truncations=[1,null]")
    assert status == 0
    assert "Derivatives of the log-likelihood" in out
    with (tmp_path / "gradients.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    keys = [(r["gradient"], r["truncate"], r["hyperparameter"]) for r in rows]
    names = ("power_shape", "noise_shape", "survival", "birth_mean")
    estimators = [(g, t) for g in ("score", "reparameterised") for t in ("1", "")]
    assert keys == [(*estimator, name) for estimator in estimators for name in names]
    found = {
        key: (float(r["mean"]), float(r["std"]), float(r["standard_error"]))
        for key, r in zip(keys, rows, strict=True)
    }
    for mean, std, error in found.values():
        assert math.isfinite(mean)
        assert error == pytest.approx(std / math.sqrt(2))
    # Noise that is carried from step to step: of its derivative, little is left where that is cut off.
    cut, whole = (found["score", truncate, "noise_shape"][0] for truncate in ("1", ""))
    assert abs(cut - whole) > 0.1 * abs(whole)


def test_an_unknown_estimator_is_refused(tmp_path):
    status, _, err = run(tmp_path, "gradients=[straight]")
    assert status != 0
    assert "gradients" in err
    assert "straight" in err
    assert not (tmp_path / "gradients.csv").exists()
