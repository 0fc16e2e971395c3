import numpy as np
import pytest
import torch

from torchdt.app.build import simulate
from torchdt.app.targets import build_field
from torchdt.run.track import generator
from torchdt.simulation.disturbances import DisturbanceSettings
from torchdt.simulation.settings import InterfererSettings
from torchdt.simulation.simulate import simulate_interference, simulate_snapshots, source_track


def read_table(path):
    return np.genfromtxt(path, delimiter=",", skip_header=1)


def test_scenario_brings_its_field(settings):
    assert settings("scenario=line_array", small=False).field["wave_speed"] == 1500
    assert len(settings("scenario=swellex96", small=False).field["element_depths"]) == 21


def test_scenario_and_field_chosen_apart(settings):
    chosen = settings("scenario=line_array", "field=swellex96", small=False)
    assert len(chosen.field["element_depths"]) == 21


def test_default_configuration_is_the_paper_scenario(settings):
    s = settings(small=False)
    assert s.field["freqs"] == [49, 79, 112, 148, 201, 283, 388]
    assert (s.scenario.num_steps, s.scenario.step_s, s.scenario.num_snapshots) == (292, 3 * 2048 / 1500, 3)
    tracker = s.tracker
    assert (tracker.declare, tracker.prune, tracker.births) == (0.5, 1e-2, 10)
    numbers = {"birth_mean": 1e-4, "power_shape": 1e4, "noise_shape": 1e2, "likelihood_power": 1.0}
    switched = {"survival": 0.9994, "falls_silent": 0.008, "resumes": 0.28}
    assert s.statistical_model.known() == numbers | switched
    plain = settings("model=default", small=False).statistical_model
    assert plain.known() == numbers | {"survival": 0.95}
    assert (s.scenario.gospa_cutoff, s.scenario.gospa_order) == (200, 1)


def test_default_truth(settings):
    """One source stands where the other is at step 50; both are there throughout."""
    scenario = settings("scenario.num_steps=60", small=False).scenario
    static, moving = (
        source_track(source, scenario.paths[source.path], 60, scenario.step_s)
        for source in scenario.sources.values()
    )
    assert torch.equal(static, moving[50].expand(60, 2))
    assert not moving.isnan().any()
    assert scenario.sources["moving"].power_db - scenario.sources["static"].power_db == -3


def test_simulated_power(settings):
    """Of a source of 0 dB over the noise, per array element."""
    s = settings("scenario.num_steps=300", "~scenario.sources.second", "scenario.snr_db=7", "seed=1")
    both = simulate(s).snapshots.abs().square().mean()
    del s.scenario.sources["first"]
    noise = simulate(s).snapshots.abs().square().mean()
    assert float(noise) == pytest.approx(10**-0.7 / 8, rel=0.02)
    assert float(10 * ((both - noise) / noise).log10()) == pytest.approx(7, abs=0.3)


def test_what_is_beside_the_sources_changes_none_of_their_numbers(settings):
    """Without interferers and disturbances it is the signal model alone, with them it has these on top."""
    s = settings("seed=3")
    stream, field = generator(3, "simulation"), build_field(s.field, torch.float64, "cpu")
    alone, truth = simulate_snapshots(field, s.scenario, stream)
    recording = simulate(s)
    assert torch.equal(recording.snapshots[0], alone)
    assert torch.equal(recording.truth[0].nan_to_num(), truth.nan_to_num())
    s.scenario.interferers = {"ship": InterfererSettings("first", 10.0)}
    s.scenario.disturbances = DisturbanceSettings(sensor_factors={2: 2.0})
    heard = alone + simulate_interference(field, s.scenario, stream)
    heard[..., 2] *= 2
    recording = simulate(s)
    torch.testing.assert_close(recording.snapshots[0], heard)
    assert recording.truth[0].shape == truth.shape


def test_configured_profile_follows_the_measured_one(settings, measured):
    depth, speed = read_table(measured / "ssp_optimized_env.csv").T
    knots = np.array(settings(small=False).field["profile"])
    np.testing.assert_allclose(np.interp(depth, *knots.T), speed, atol=0.2)
    assert (knots[0, 0], knots[-1, 0]) == (0, 216.5)  # surface and seafloor


def test_configured_elements_are_the_published_ones(settings, measured):
    published = np.loadtxt(measured / "vla_depths_21.csv")
    np.testing.assert_array_equal(settings(small=False).field["element_depths"], published)


def test_configured_track_is_the_published_one(settings, measured):
    table = read_table(measured / "range_S5.csv")
    published = table[(table[:, 0] >= 30) & (table[:, 0] <= 50)]
    tow = settings(small=False).scenario.paths["tow"]
    np.testing.assert_allclose(tow.times_s, 60 * (published[:, 0] - 30))
    np.testing.assert_allclose([position[0] for position in tow.positions], 1000 * published[:, 1])


def test_sound_speed_statistics_are_those_of_the_casts(settings, casts):
    """The variance that the four functions hold, against the casts that reach 160 m."""
    depth, speed = casts
    eofs = settings(small=False).field["eofs"]
    variance = speed[np.searchsorted(depth, eofs["depths"])].var(1, ddof=1)
    held = (np.array(eofs["functions"]) ** 2).sum(1)
    assert speed.shape[1] == 24
    assert held.sum() < variance.sum()
    assert held.sum() == pytest.approx(0.85 * variance.sum(), rel=0.15)


def test_field_follows_the_tracker_type(settings):
    field = build_field(settings().field, torch.float32, "cpu")
    assert field(torch.zeros(1)).dtype == torch.complex64
