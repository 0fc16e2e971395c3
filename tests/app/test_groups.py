"""Every option of every group becomes what it describes; a new file is tested by being there."""

import json
from dataclasses import replace

import pytest
import torch
from hydra import compose
from hydra.plugins.launcher import Launcher
from hydra.utils import instantiate
from omegaconf import OmegaConf
from oracles.scripts import CONF, SMALL, configuration, configured
from oracles.waveguide import ENV_FILE

from torchdt.app import targets
from torchdt.app.build import build_region, build_tracker, simulate
from torchdt.app.claims import DirectoryClaims
from torchdt.app.settings import settings_of
from torchdt.app.sweep import SweepReport
from torchdt.app.tunable import build_problem, gather
from torchdt.calibration.environment import CalibrationConfig
from torchdt.run.track import track

pytestmark = pytest.mark.slow
SHORT = ("scenario.num_steps=2", "logging=quiet")
GIVEN = {
    ("field", "env_file"): (f"field.env_file={ENV_FILE}",),
    ("model/noise", "coloured"): (f"model.noise.matrix={torch.eye(8).tolist()}",),
    ("model/birth", "areas"): ("model.birth.areas=[{low: [-70], high: [0]}]",),
}
"""What has no default; that of parts of the model is for the line array."""
PLANE = {("model/motion", "constant_turn")}
"""Parts for two coordinates."""


def parts(group):
    """Groups of the parts of another, and the options of each."""
    files = sorted(file for c in CONF for file in c.glob(f"{group}/*/*.yaml"))
    return [(f"{group}/{file.parent.name}", file.stem) for file in files]


def options(group):
    found = sorted(configured(f"{group}/*.yaml"))
    assert found
    return found


def composed(job, *overrides, **keys):
    with configuration():
        return compose(job, overrides=list(overrides), **keys)


def settings(*overrides, job="track"):
    return settings_of(composed(job, *overrides))


@pytest.fixture(scope="module")
def build():
    """Fields, each built once: scenarios share them, and modes take a while."""
    known = {}

    def build(target):
        key = json.dumps(target)
        if key not in known:
            known[key] = targets.build_field(target, torch.float64, "cpu")
        return known[key]

    return build


@pytest.fixture(scope="module")
def line():
    return simulate(settings("scenario=line_array", *SHORT))


def test_no_group_is_forgotten():
    groups = {path.parent.relative_to(c).as_posix() for c in CONF for path in c.glob("*/**/*.yaml")}
    here = {name.removeprefix("test_").replace("hydra_", "hydra/") for name in globals()}
    own = {"experiment", "hydra/help"}  # these two have files of their own
    in_parts = {name for group in ("model", "tracker") for name, _ in parts(group)}
    assert groups - own <= here | in_parts


@pytest.mark.parametrize("name", options("field"))
def test_field(build, name):
    field = build(settings(f"field={name}", *GIVEN.get(("field", name), ())).field)
    state = torch.full((3, field.num_coordinates), 0.3, dtype=torch.float64)
    response = field(state)
    assert response.shape == (3, field.num_tones, field.num_sensors)
    assert response.isfinite().all()


@pytest.mark.parametrize("name", options("scenario"))
def test_scenario(build, monkeypatch, name):
    """It is simulated, in the field without mismatch."""
    chosen = settings(f"scenario={name}", *SHORT)
    field, region = build(chosen.field), build_region(chosen, torch.float64)
    assert region.num_coordinates == field.num_coordinates
    monkeypatch.setattr("torchdt.app.build.build_field", lambda target, *_, **__: build(target))
    recording = simulate(chosen)
    assert recording.snapshots.shape[:2] == (1, 2)
    assert recording.snapshots.shape[-1] == field.num_sensors


@pytest.mark.parametrize("name", options("tracker"))
def test_tracker(line, name):
    tracker = build_tracker(settings("scenario=line_array", f"tracker={name}", *SHORT), line)
    assert tracker.select(slice(0, 1)).region.num_coordinates == 1


@pytest.mark.parametrize("part", parts("model"))
def test_model(line, part):
    """Each part of the model tracks a step in the place of the default one."""
    group, name = part
    scenario = "near_field" if part in PLANE else "line_array"
    chosen = settings(f"scenario={scenario}", f"{group}={name}", *GIVEN.get(part, ()), *SHORT)
    recording = simulate(chosen) if part in PLANE else line
    tracker = build_tracker(chosen, recording)
    history = track(recording, tracker, [0])
    assert history.log_evidence.isfinite().all()
    assert set(chosen.statistical_model.known()) <= set(tracker.model.known())


@pytest.mark.parametrize("part", parts("tracker"))
def test_tracker_parts(part):
    """Each is made, with the numbers that the file says, which are those of its class."""
    chosen = settings("=".join(part))
    name = part[0].removeprefix("tracker/")
    built = getattr(chosen.built_tracker, name)
    said = {key: value for key, value in getattr(chosen.tracker, name).items() if key != "_target_"}
    assert said == {key: getattr(built, key) for key in said}
    assert built == type(built)()


@pytest.mark.parametrize("name", options("calibration"))
def test_calibration(name):
    chosen = settings(f"calibration={name}").calibration
    assert isinstance(chosen, CalibrationConfig)
    assert chosen.enabled == (name != "none")


@pytest.mark.parametrize("name", options("data"))
def test_data(name):
    chosen = settings(f"data={name}", *(() if name == "simulated" else ("data.path=recording",))).data
    assert name.startswith(chosen.kind)
    assert chosen.paths == [None if name == "simulated" else "recording"]


@pytest.mark.parametrize("name", options("logging"))
def test_logging(name):
    assert settings(f"logging={name}").logging.tensorboard == (name != "quiet")


@pytest.mark.parametrize("name", options("tuning"))
def test_tuning(name):
    assert settings(f"tuning={name}", job="tune").tuning.method == name


@pytest.mark.parametrize("name", options("hyperparameters"))
def test_hyperparameters(name):
    """All can be tuned in a waveguide without calibration, on covariances."""
    scenario = (
        "scenario=matched_20",
        "field.freqs=[49,79]",
        "scenario.num_steps=1",
        "scenario.num_snapshots=40",
        "calibration=none",
    )
    chosen = settings(f"hyperparameters={name}", *SMALL, *scenario, "train_seeds=[0]", job="tune")
    sequences = gather(chosen, chosen.train_seeds, [], pad=False)
    z = sequences.recording.snapshots
    covariances = replace(
        sequences.recording, snapshots=None, covariance=z.mT @ z.conj() / 40, num_snapshots=40.0
    )
    sequences = sequences._replace(recording=covariances)
    hyperparameters, families = build_problem(chosen, chosen.hyperparameters, [sequences])
    values = hyperparameters()
    assert set(values) == set(chosen.hyperparameters)
    assert all(torch.as_tensor(value).isfinite().all() for value in values.values())
    assert hyperparameters.log_prior().isfinite()
    assert len(families) == 1


@pytest.mark.parametrize("name", options("hydra/launcher"))
def test_hydra_launcher(name):
    if name == "ray_pool":
        pytest.importorskip("ray", reason="Ray is an extra of its own")
    config = composed("track", f"hydra/launcher={name}", return_hydra_config=True)
    OmegaConf.set_struct(config, False)
    assert isinstance(instantiate(config.hydra.launcher), Launcher)


@pytest.mark.parametrize("name", options("hydra/callbacks"))
def test_hydra_callbacks(name):
    config = composed("track", f"hydra/callbacks={name}", return_hydra_config=True)
    claims, report = (instantiate(callback) for callback in config.hydra.callbacks.values())
    assert isinstance(claims, DirectoryClaims)  # before any other: what is refused says nothing
    assert isinstance(report, SweepReport)
