import math

import pytest
import torch
from hydra import compose
from omegaconf import OmegaConf
from oracles.histories import line_history
from oracles.scripts import configuration

from torchdt.app.build import simulate, simulate_each
from torchdt.app.compare import CompareSettings
from torchdt.app.suite import SuiteSettings, compose_track, confidence, score
from torchdt.core.errors import InputError
from torchdt.data.recording import validate
from torchdt.filter.history import TrackHistory
from torchdt.simulation.settings import PathSettings, ScenarioSettings, SourceSettings
from torchdt.simulation.simulate import source_track
from torchdt.simulation.visibility import hidden_steps

pytestmark = pytest.mark.slow

SUITE = (
    "matched_20",
    "matched_34",
    "mismatch",
    "births",
    "close_equal",
    "close_6db",
    "weak",
    "silence",
    "empty",
)


@pytest.mark.parametrize("name", SUITE)
def test_scenarios_of_the_suite(settings, name):
    scenario = settings(f"scenario={name}", small=False).scenario
    assert scenario.name == name
    assert (scenario.num_steps, scenario.step_s) == (292, 4.096)
    assert (scenario.gospa_cutoff, scenario.gospa_order) == (200, 1)
    truth = truth_of(scenario)
    here = truth[~truth.isnan().any(-1)]
    assert ((here >= torch.tensor([0, 0])) & (here <= torch.tensor([5000, 200]))).all()


def truth_of(scenario):
    tracks = [
        source_track(source, scenario.paths[source.path], scenario.num_steps, scenario.step_s)
        for source in scenario.sources.values()
    ]
    return torch.stack(tracks, 1) if tracks else torch.empty(scenario.num_steps, 0, 2)


def test_empty_is_the_paper_scenario_without_its_sources(settings):
    empty = settings("scenario=empty", small=False).scenario
    paper = settings("scenario=swellex96", small=False).scenario
    different = {key for key, value in vars(empty).items() if value != getattr(paper, key)}
    assert different == {"name", "sources"}
    assert not empty.sources


def test_close_sources_stay_close(settings):
    for name in ("close_equal", "close_6db"):
        truth = truth_of(settings(f"scenario={name}", small=False).scenario)
        distance = (truth[:, 0] - truth[:, 1]).norm(dim=-1)
        assert 50 < distance.min() < distance.max() < 75


def test_births_cross_in_range(settings):
    scenario = settings("scenario=births", small=False).scenario
    truth = truth_of(scenario)
    gap = truth[:, 0, 0] - truth[:, 1, 0]
    assert gap[40] > 0 > gap[199]
    assert not hidden_steps(scenario, truth, 30.0).all()
    ranges = truth[..., 0][~truth[..., 0].isnan()]
    assert 1200 <= ranges.min() <= ranges.max() <= 4500


def test_hidden_steps():
    silences = {
        "first": [[1, 2], [6, 9]],
        "second": [],
        "late": [[0, 3]],
    }  # the late one is not there before 3
    scenario = ScenarioSettings(
        num_steps=8,
        paths={"p": PathSettings()},
        sources={name: SourceSettings("p", silences=pairs) for name, pairs in silences.items()},
    )
    far = torch.tensor([[0.0, 0.0], [100.0, 0.0], [0.0, 50.0]]).expand(8, 3, 2).clone()
    far[:3, 2] = torch.nan
    far[4, 2] = torch.tensor([100.0, 29.0])
    far[5, 2] = torch.tensor([100.0, 30.0])
    expected = [False, True, True, True, True, False, True, True]
    assert hidden_steps(scenario, far, 30.0).tolist() == expected
    assert not hidden_steps(ScenarioSettings(num_steps=8), torch.zeros(8, 0, 2), 30.0).any()


def test_score(settings):
    """Two runs of three steps, the middle one hidden: the first misses nothing, the second all."""
    track_settings = settings(
        "scenario.num_steps=3", "scenario.sources.first.silences=[[1,1]]", "~scenario.sources.second"
    )
    truth = torch.tensor([[[[0.0]]] * 3] * 2).double()
    good = line_history([[1, 0], [2, 0], [2, 0]], [[1.0, 0]] * 3)
    bad = line_history([[0, 0], [0, 0], [3, 4]], [[30.0, 40]] * 3)
    history = TrackHistory(*(torch.stack(pair) for pair in zip(good, bad, strict=True)))
    recording = validate(step_s=1.0, snapshots=torch.zeros(2, 3, 1, 1, 1, dtype=torch.complex64), truth=truth)
    row = score("x", history, recording, track_settings, SuiteSettings(suite=["x"], separation=1.0))
    assert (row.runs, row.hidden) == (2, 1)
    assert row.gospa_by_run == pytest.approx([1, 10])  # cutoff 10: missed costs 5, missed and two false 15
    assert row.gospa == pytest.approx(5.5)
    assert row.gospa_ci == pytest.approx(12.7062 * 9 / 2, rel=1e-4)
    assert (row.localisation, row.missed, row.false) == pytest.approx((0.5, 2.5, 2.5))
    assert row.gospa_all == pytest.approx((1 * 3 + 5 + 5 + 15) / 6)
    assert row.gospa_hidden == pytest.approx(3)
    assert row.count_error == pytest.approx((1 + 1) / 4)
    assert row.switches == pytest.approx(0.5)  # label 1 to 2 in the first run
    assert row.false_per_100 == pytest.approx(50)
    assert row.birth_delay == pytest.approx(1.5)  # 0 and, never found, 3


def test_default_suite():
    with configuration():
        config = compose("compare")
    assert isinstance(OmegaConf.to_object(config), CompareSettings)
    assert config.suite == list(SUITE)


def test_a_sequence_for_each_seed(settings):
    """The same as with a call for each of them."""
    found = simulate_each(settings(), [0, 1, 5])
    for b, seed in enumerate((0, 1, 5)):
        alone = simulate(settings(f"seed={seed}"))
        assert torch.equal(found.data[b], alone.data[0])
        torch.testing.assert_close(found.truth[b], alone.truth[0], equal_nan=True, rtol=0, atol=0)


def test_one_run_has_no_confidence_interval():
    assert math.isnan(confidence(torch.ones(1)))


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"suite": []}, "suite"),
        ({"suite": ["a", "a"]}, "suite"),
        ({"surface_step": -1}, "surface_step"),
        ({"separation": -1.0}, "separation"),
        ({"separation": math.inf}, "separation"),
        ({"switch_cost": 0.0}, "switch_cost"),
    ],
)
def test_bad_settings(changes, key):
    with pytest.raises(InputError, match=f"key '{key}'"):
        SuiteSettings(**({"suite": ["a"]} | changes))


def test_variants_have_no_row_in_a_suite():
    with configuration():
        assert compose_track("line_array", [], 4, 1).seed == 4
        with pytest.raises(InputError, match=r"key 'variants': found \[{}\], expected null in a suite"):
            compose_track("line_array", ["variants=[{}]"], 0, 1)
