"""The faint scenarios say how much evidence a step brings, and the small ones bring as much as the large."""

import math

import pytest
from oracles.scripts import track_settings

SENSORS = {"waveguide": "element_depths", "line_array": "sensor_positions"}


def nats(name, *overrides):
    """Mean evidence of a step for each source, at its known place and power in known noise (exact mean)."""
    chosen = track_settings(f"scenario={name}", *overrides, small=False)
    scenario, field = chosen.scenario, chosen.field
    sensors = len(field[SENSORS[field["_target_"].rpartition(".")[-1]]])
    found = {}
    for source, settings in scenario.sources.items():
        x = sensors * 10 ** ((scenario.snr_db + settings.power_db) / 10)
        found[source] = len(field["freqs"]) * scenario.num_snapshots * (x - math.log1p(x))
    return found


@pytest.mark.parametrize("name", ["faint", "faint_pair", "faint_beside"])
@pytest.mark.parametrize("prefix", ["", "line_"])
def test_five_nats_a_step(prefix, name):
    assert 4.6 < nats(prefix + name)["faint"] < 4.9


def test_the_stronger_source_of_the_pair():
    assert nats("line_faint_pair")["stronger"] == pytest.approx(nats("faint_pair")["stronger"], rel=0.02)


@pytest.mark.parametrize(("large", "small"), [(-17, -9.7), (-20, -12.9)])
def test_lower_levels_that_the_small_one_names(large, small):
    key = "scenario.sources.faint.power_db"
    expected = nats("faint", f"{key}={large}")["faint"]
    assert nats("line_faint", f"{key}={small}")["faint"] == pytest.approx(expected, rel=0.03)
