"""`torchdt doctor`: what it prints, and that its checks can fail."""

import math
import platform
from unittest import mock

import pytest
import torch
from oracles.scripts import call

from torchdt.app import doctor
from torchdt.run.track import track

pytestmark = pytest.mark.slow


@pytest.fixture
def diagnose(tmp_path, monkeypatch):
    """Exit status and lines of the command, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def diagnose():
        status, out, err = call(doctor)
        assert err == ""
        return int(status), [" ".join(line.split()) for line in out.splitlines()]

    return diagnose


def checks(lines):
    """The outcome of each check by its name."""
    found = [line.split(" ", 3) for line in lines if line.startswith(("ok ", "failed "))]
    assert all(float(seconds) >= 0 and unit == "s" for _, seconds, unit, _ in found)
    return {rest.partition(":")[0]: mark for mark, _, _, rest in found}


def test_all_is_well(diagnose, tmp_path):
    status, lines = diagnose()
    assert status == 0
    assert checks(lines) == {"files": "ok", "tracking on cpu": "ok", "gradient": "ok"}
    text = "\n".join(lines)
    for name, value in (
        ("python", platform.python_version()),
        ("torch", torch.__version__),
        ("threads", f"{torch.get_num_threads()} on"),
        ("extra test", "pytest"),
    ):
        assert f"{name} │ {value}" in text
    assert "GB free" in text
    assert list(tmp_path.iterdir()) == []  # it leaves nothing behind


def test_a_check_that_fails_is_an_exit_status(diagnose, tmp_path, monkeypatch):
    (tmp_path / "outputs").write_text("not a folder")
    for other in ("check_tracking", "check_gradient"):
        monkeypatch.setattr(doctor, other, lambda *_: "as expected")
    status, lines = diagnose()
    assert status == 1
    assert checks(lines) == {"files": "failed", "tracking on cpu": "ok", "gradient": "ok"}
    assert "NotADirectoryError" in "\n".join(lines)


def test_tracks_that_are_wrong(monkeypatch):
    """Nothing is reported."""

    def nothing(*of):
        history = track(*of)
        return history._replace(declared=torch.zeros_like(history.declared))

    monkeypatch.setattr(doctor, "track", nothing)
    with pytest.raises(RuntimeError, match=r"GOSPA is [5-9]\.\d\d degrees, expected less than 1$"):
        doctor.check_tracking(torch.device("cpu"))


def test_each_device_is_tried(monkeypatch, tmp_path):
    """One without numbers fails."""
    monkeypatch.setattr(doctor, "devices", lambda: [torch.device("meta")])
    monkeypatch.setattr(doctor, "check_gradient", lambda: "as expected")
    passed = {check.name: check.passed for check in doctor.run_checks(tmp_path)}
    assert passed == {"files": True, "tracking on meta": False, "gradient": True}


def test_every_accelerator_is_a_device(monkeypatch):
    monkeypatch.setattr(torch.accelerator, "current_accelerator", lambda: torch.device("cuda"))
    monkeypatch.setattr(torch.accelerator, "device_count", lambda: 2)
    assert [str(device) for device in doctor.devices()] == ["cpu", "cuda:0", "cuda:1"]


@pytest.mark.parametrize("factor", [1.001, math.nan])
def test_gradient_that_is_wrong(monkeypatch, factor):
    grad = torch.autograd.grad
    monkeypatch.setattr(torch.autograd, "grad", lambda *of: [factor * slope for slope in grad(*of)])
    with pytest.raises(RuntimeError, match="finite difference"):
        doctor.check_gradient()


def test_missing_packages_are_named():
    requirements = [
        "hydra-core>=1",
        'nowhere-to-be-found>=2; extra == "far"',
        'torchdt[far]; extra == "further"',
    ]
    with mock.patch.object(doctor, "requires", return_value=requirements):
        assert doctor.extras() == {"far": "nowhere-to-be-found missing"}
