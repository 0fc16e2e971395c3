import pytest

from torchdt.core.errors import InputError
from torchdt.tuning.config import TuningConfig


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"method": "newton"}, "method"),
        ({"method": "tpe"}, "budget_passes"),
        ({"method": "grid"}, "budget_passes"),
        ({"budget_passes": 0}, "budget_passes"),
        ({"steps": 0}, "steps"),
        ({"heldout_every": -1}, "heldout_every"),
        ({"patience": 0}, "patience"),
        ({"checkpoint_every": 0}, "checkpoint_every"),
        ({"gospa_every": 0}, "gospa_every"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"learning_rate": float("nan")}, "learning_rate"),
        ({"clip": float("inf")}, "clip"),
        ({"width": -1.0}, "width"),
        ({"block": 0}, "block"),
        ({"truncate": 0}, "truncate"),
        ({"slice_points": -1}, "slice_points"),
    ],
)
def test_bad_settings(changes, key):
    with pytest.raises(InputError, match=f"key 'tuning.{key}'"):
        TuningConfig(**changes)


def test_good_settings():
    assert TuningConfig(method="grid", budget_passes=10, block=4, truncate=8, slice_points=0).steps == 60
