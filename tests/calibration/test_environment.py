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


def departed(family, **values) -> torch.Tensor:
    theta = torch.zeros_like(family.prior_std)
    for name, value in values.items():
        theta[family.parts[name]] = torch.as_tensor(value, dtype=F64)
    return theta


def test_finds_bow_gains_and_phases_of_the_sensors(whole, scene, measure):
    """Common factors and what looks like a tilt cannot be told; the rest is found to some per cent."""
    rng = torch.Generator().manual_seed(2)
    gain, phase = torch.randn(2, 21, generator=rng, dtype=F64) * torch.tensor([[1.5], [12.0]], dtype=F64)
    theta = departed(whole, bow_m=2.5, gain_db=gain, phase_deg=phase)
    found = fit(whole, measure(whole.solve(theta)(scene.truth), 4), steps=8).theta
    assert float(whole.part(found, "bow_m")) == pytest.approx(2.5, abs=0.1)
    assert whole.part(found, "slope_m_per_km") == 0
    for name, truth, error in (("gain_db", gain, 0.3), ("phase_deg", phase, 3.0)):
        assert (whole.part(found, name) - truth).std() < error


def test_finds_a_slope_and_nothing_else(whole, scene, measure):
    theta = departed(whole, slope_m_per_km=4.0)
    found = fit(whole, measure(whole.solve(theta)(scene.truth), 4), steps=8).theta
    assert float(whole.part(found, "slope_m_per_km")) == pytest.approx(4.0, abs=0.15)
    assert found.count_nonzero() == 1


def test_a_loud_signal_from_outside_bends_nothing(whole, scene, measure):
    """A ship 10 dB louder than the sources, far outside the region."""
    field = whole.solve(departed(whole))
    ship = torch.tensor([6500.0, 5.0], dtype=F64).expand(8, 1, 2)
    response = torch.cat([field(scene.truth), 10**0.5 * field(ship)], 1)
    found = fit(whole, measure(response, 4), steps=8)
    assert not found.theta.any()
    assert (found.share <= 0.003).all()


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
        *(
            (n, -1.0, "a number from 0 up")
            for n in ("bow_std_m", "slope_std_m_per_km", "gain_std_db", "phase_std_deg")
        ),
        ("false_alarm", 0.0, "a probability"),
        ("false_alarm", 1.0, "a probability"),
    ],
)
def test_settings_out_of_range(key, value, expected):
    with pytest.raises(InputError, match=f"key 'calibration.{key}': found {value}, expected {expected}"):
        CalibrationConfig(**{key: value})
