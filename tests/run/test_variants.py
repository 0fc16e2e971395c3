"""Settings in one batch against the same settings one by one."""

import pytest
import torch
from oracles.line_array import FREQS, POSITIONS, SMALL, make_region, make_tracker, simulate

from torchdt.core.errors import InputError
from torchdt.data.recording import validate
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.model import Model
from torchdt.model.noise.white import WhiteNoise
from torchdt.run.track import track
from torchdt.run.variants import variant_models, with_variants

VARIANTS = [
    {"survival": 0.7, "birth_mean": 1e-2},
    {"power_shape": 50.0, "noise_shape": 20},
    {},
    {"likelihood_power": 0.5, "driving_variance": [1e-2]},
]


@pytest.mark.parametrize("fields", ["shared", "own"])
def test_every_setting_gives_what_it_gives_alone(fields):
    """Every number of the model differs in one of the settings."""
    path = ((0.0, -40.0), (20.0, -25.0))
    recording = validate(
        step_s=1.0, snapshots=torch.stack([simulate(seed, path, steps=6)[0] for seed in (1, 2)])
    )
    field = make_tracker().field
    if fields == "own":
        field = StackedField([LineArrayField(FREQS, POSITIONS, c, dtype=torch.float64) for c in (1500, 1450)])
    tracker = DirectTracker(field, make_region(), 1.0, TrackerConfig(**SMALL))
    models = variant_models(Model(), VARIANTS)
    stacked = with_variants(tracker, models, 2)
    history = track(recording.repeat(4), stacked, [5, 6] * 4)
    evidence = history.log_evidence.reshape(4, 2, -1)
    for v, model in enumerate(models):
        alone = track(recording, DirectTracker(field, tracker.region, 1.0, tracker.config, model), [5, 6])
        found = type(history)(*(t[2 * v : 2 * v + 2] for t in history))
        assert torch.equal(found.declared, alone.declared)
        torch.testing.assert_close(found.existence, alone.existence, rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(found.log_evidence, alone.log_evidence, rtol=1e-6, atol=1e-6)
        there = alone.existence > 0
        torch.testing.assert_close(found.state[there], alone.state[there], rtol=1e-6, atol=1e-6)
    gaps = (evidence.unsqueeze(0) - evidence.unsqueeze(1)).abs().amax((-2, -1))
    assert (gaps + torch.eye(4) > 1e-3).all()  # the settings do differ


def test_what_a_variant_does_not_name_is_as_configured():
    model = Model(survival=0.8, noise=WhiteNoise(30.0))
    first, second = variant_models(model, [{"survival": 0.6}, {"driving_variance": None}])
    assert (first.survival, first.noise.noise_shape) == (0.6, 30.0)
    assert second == model


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"survival": 1.5}, r"'variants\[1\].survival': found 1.5, expected a probability"),
        ({"birth_mean": 0}, r"'variants\[1\].birth_mean': found 0, expected a positive number"),
        ({"noise_shape": "high"}, r"'variants\[1\].noise_shape': found high, expected a finite number"),
        ({"power_shape": True}, r"'variants\[1\].power_shape': found True, expected a finite number"),
        ({"power_shape": None}, r"'variants\[1\].power_shape': found None, expected a finite number"),
        ({"driving_variance": 1e-3}, r"'variants\[1\].driving_variance': found 0.001, expected a list"),
        (
            {"driving_variance": [0.0]},
            r"'variants\[1\].driving_variance': found 0.0, expected a positive number",
        ),
        ({"slots": 3}, r"'variants\[1\].slots': found an unknown number, expected one of \['birth_mean'"),
        ("survival", r"'variants\[1\]': found survival, expected values by name"),
    ],
)
def test_what_makes_no_sense_is_named(entry, message):
    with pytest.raises(InputError, match=message):
        variant_models(Model(), [{}, entry])


def test_no_variants_are_refused():
    with pytest.raises(InputError, match="key 'variants': found none, expected one setting or more"):
        variant_models(Model(), [])


def test_a_driving_variance_that_does_not_fit_the_region_is_named():
    configs = variant_models(Model(), [{}, {"driving_variance": [1e-3, 1e-3]}])
    message = r"'variants\[1\].driving_variance': found \[0.001, 0.001\], expected one number for each of 1"
    with pytest.raises(InputError, match=message):
        with_variants(make_tracker(), configs, 2)
