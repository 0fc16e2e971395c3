"""Calibration from snapshots alone: detect, fit, keep the nominal environment unless it is wrong."""

from functools import partial

import pytest
import torch

from torchdt.calibration import environment
from torchdt.calibration.environment import Calibration, CalibrationConfig, calibrate
from torchdt.core.errors import InputError
from torchdt.model.measurement import Measurement
from torchdt.model.prior import data_priors
from torchdt.model.region import Coordinate, Region

pytestmark = pytest.mark.slow
F64 = torch.float64
REGION = Region(
    [
        Coordinate("range", "m", 2000.0, 3500.0, 25.0, -4.0, 4.0, 1e-2),
        Coordinate("depth", "m", 20.0, 80.0, 2.0, -1.0, 1.0, 1e-5),
    ],
    F64,
)


def fit(family, measurement: Measurement, seed: int = 0, **config) -> Calibration:
    settings = CalibrationConfig(**({"enabled": True, "steps": 4, "sources": 3} | config))
    stream = torch.Generator().manual_seed(seed)
    return calibrate(family, REGION, measurement, data_priors(measurement), settings, stream)


@pytest.fixture(scope="module")
def found(family, scene) -> Calibration:
    return fit(family, scene.measurement)


def test_finds_the_environment_the_data_were_made_in(found, scene):
    """Errors are 0.11 standard deviations of the EOFs, 0.005 degrees and 4 cm of water."""
    error = (found.theta - scene.theta).abs()
    assert (error[:2] < 0.3).all()
    assert error[2] < 0.1
    assert error[3] < 0.2
    assert found.theta.dtype == F64
    assert (found.share <= 0.003).all()


def test_a_true_nominal_environment_is_kept_exactly(family, nominal, scene, measure):
    kept = fit(family, measure(nominal(scene.truth), 4))
    assert torch.equal(kept.theta, torch.zeros(4, dtype=F64))
    assert (kept.share <= 0.003).all()


def test_noise_alone_says_nothing(family, nominal, scene, measure):
    kept = fit(family, measure(0 * nominal(scene.truth), 6))
    assert torch.equal(kept.theta, torch.zeros(4, dtype=F64))
    assert torch.equal(kept.share, torch.zeros(3, dtype=F64))


def test_share_is_estimated_on_demand_only(family, nominal, scene, measure, scattered, monkeypatch):
    """In whatever environment was found: ten iterations towards it do."""
    monkeypatch.setattr(environment, "focalise", partial(environment.focalise, iterations=10))
    data = measure(scattered(nominal, scene.truth, 0.3, seed=1), seed=1)
    assert (fit(family, data, passes=1).share > 0.05).all()
    assert fit(family, data, steps=1, passes=1, share=False).share.eq(0).all()


@pytest.mark.parametrize("first", [0, 1])
def test_steps_are_spread_over_the_recording(family, nominal, scene, measure, first):
    """Sources in every third step only: found where these are the steps looked at, not where others are."""
    loud, quiet = (measure(x * scene.field(scene.truth), 8) for x in (1, 0))
    steps = 10
    heard = {k: i for i, k in enumerate(range(first, steps, 3))}
    parts = [(loud, heard[k]) if k in heard else (quiet, k % 8) for k in range(steps)]
    sparse = Measurement(*(torch.stack([data[field][i] for data, i in parts]) for field in range(3)))
    theta = fit(family, sparse, passes=1).theta
    if first == 0:
        assert (theta - scene.theta).abs()[2] < 0.1
    else:
        assert theta.eq(0).all()


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        *((name, 0, "a positive integer") for name in ("steps", "sources", "passes")),
        *((name, 0.0, "a positive number") for name in ("eof_std", "tilt_std_deg", "water_depth_std_m")),
        ("tilt_std_deg", float("nan"), "a positive number"),
        ("false_alarm", 0.0, "a probability"),
        ("false_alarm", 1.0, "a probability"),
    ],
)
def test_settings_out_of_range(key, value, expected):
    with pytest.raises(InputError, match=f"key 'calibration.{key}': found {value}, expected {expected}"):
        CalibrationConfig(**{key: value})
