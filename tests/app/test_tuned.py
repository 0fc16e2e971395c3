"""`tuned.yaml` is a configuration that cannot run code."""

import pytest
from oracles.scripts import call, load

from torchdt.app.report.tuning import write_tuned
from torchdt.app.tuned import check_tuned
from torchdt.core.errors import InputError
from torchdt.model.model import Model

pytestmark = pytest.mark.slow
VALUES = {"survival": 0.9, "driving_variance": [1e-05, 2.0], "tilt_deg": 0.5, "eof_coefficients": [0.1, -2.0]}


@pytest.fixture
def tuned(tmp_path):
    path = tmp_path / "tuned.yaml"
    write_tuned(path, VALUES, Model())
    return path


def test_what_tuning_writes(tuned):
    check_tuned(tuned)


def test_settings_of_a_two_step_tracker(tmp_path):
    path = tmp_path / "tuned.yaml"
    path.write_text("tracker:\n  birth_mean: 0.01\n  spread: {range: 0.4}\n  detector: {threshold: 20}\n")
    check_tuned(path)


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ("field: {_target_: torch.load, f: evil.pt}", "field._target_"),
        ("field: {draw: {tilt_deg: {_target_: evil.run}}}", "field.draw.tilt_deg._target_"),
        ("model: {motion: {driving_variance: [1.0, '${oc.env:HOME}']}}", "model.motion.driving_variance"),
        ("hydra: {callbacks: {evil: {_target_: evil.Callback}}}", "hydra"),
        ("defaults: [track, evil, _self_]", "defaults"),
        ("model: {survival: high}", "model.survival"),
    ],
)
def test_anything_but_numbers_is_refused_before_hydra_starts(tmp_path, line, key):
    (tmp_path / "tuned.yaml").write_text(f"{line}\n")
    arguments = (f"--config-dir={tmp_path}", "--config-name=tuned", f"hydra.run.dir={tmp_path / 'run'}")
    status, _, err = call(load("track"), *arguments)
    assert status == 1
    assert err.startswith(f"path '{tmp_path / 'tuned.yaml'}': key '{key}': found ")
    assert err.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("content", ["[1, 2]", "a: [", "3"])
def test_no_such_configuration(tmp_path, content):
    (tmp_path / "tuned.yaml").write_text(content)
    with pytest.raises(InputError, match="path '"):
        check_tuned(tmp_path / "tuned.yaml")
