"""The setting `device` reaches whatever computes; and a run on an accelerator is that on the CPU."""

import pytest
import torch
from oracles.devices import assert_kind, tensors
from torch import Tensor

from torchdt.app.build import build_recording, build_tracker
from torchdt.app.environment import waveguide_family
from torchdt.app.settings import TrackSettings
from torchdt.core.random import RandomStreams
from torchdt.filter.history import TrackHistory
from torchdt.run.track import derive_seed

pytestmark = pytest.mark.slow
TRACKERS = pytest.mark.parametrize("tracker", ["direct", "direct_paper", "mp_bp", "sbl_bp"])
WATER = ("scenario.num_steps=2", "field.freqs=[49,148]", "calibration=none")
SHARE = "tracker.mismatch_share=[0.1,0.2]"
ON_AN_ACCELERATOR = pytest.mark.skipif(not torch.accelerator.is_available(), reason="no accelerator")


@TRACKERS
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_everything_a_tracker_holds_is_on_the_device(settings, tracker, dtype):
    """Recordings are simulated on the CPU."""
    line = "scenario=line_array", "scenario.num_steps=2"
    chosen = settings(*line, f"tracker={tracker}", "device=meta", f"dtype={dtype}", small=False)
    recording = build_recording(chosen)
    assert recording.data.device.type == "cpu"
    built = build_tracker(chosen, recording)
    names = [name for name, _ in tensors(built)]
    for part in (".field.", ".region.low"):
        assert any(name.startswith(part) for name in names), names
    assert all(value.is_meta for _, value in tensors(built))
    # Places and wavenumbers stay in double precision, for the phases.
    held = [(name, value) for name, value in tensors((built, built.dictionary)) if ".field." not in name]
    assert_kind([value for name, value in held if "_field" not in name], chosen.torch_dtype, "meta")


def test_shares_and_families_are_on_the_device(settings):
    chosen = settings(*WATER, SHARE, "device=meta", small=False)
    field = build_tracker(chosen, build_recording(chosen)).field
    assert field.share.is_meta
    assert field(torch.empty(3, 4, device="meta")).is_meta
    family = waveguide_family(chosen, chosen.field, torch.float64)
    assert family.prior_std.is_meta


class HostStreams(RandomStreams):
    """Numbers drawn on the CPU and moved, so that they are the same on every device."""

    target = torch.device("cpu")

    def normal(self, *shape: int) -> Tensor:
        return super().normal(*shape).to(self.target)

    def uniform(self, *shape: int) -> Tensor:
        return super().uniform(*shape).to(self.target)


def run_on(settings: TrackSettings) -> tuple[TrackHistory, Tensor]:
    """History on the CPU, and the cells positions are measured by."""
    recording = build_recording(settings)
    tracker = build_tracker(settings, recording)
    prepared = tracker.prepare(recording)
    streams = HostStreams.from_seeds([derive_seed(0, "filter")], (1,), settings.torch_dtype)
    streams.target = tracker.region.low.device
    with torch.inference_mode():
        history = tracker.run(prepared.measurement, prepared.priors, streams)
    assert_kind(history, settings.torch_dtype, tracker.region.low.device.type)
    return TrackHistory(*(t.cpu() for t in history)), tracker.region.cell.cpu()


@ON_AN_ACCELERATOR
@pytest.mark.parametrize(("dtype", "cells"), [("float64", 1e-6), ("float32", 1e-2)])
def test_a_run_on_an_accelerator_equals_that_on_the_cpu(settings, dtype, cells):
    """Ten steps of the default run, environment fitted, with the same random numbers."""
    name = torch.accelerator.current_accelerator().type
    size = "scenario.num_steps=10", f"dtype={dtype}"
    expected, cell = run_on(settings(*size, small=False))
    found, _ = run_on(settings(*size, f"device={name}", small=False))
    assert torch.equal(found.declared, expected.declared)
    assert expected.declared.any()
    assert torch.equal(found.label[found.declared], expected.label[expected.declared])
    away = (found.position - expected.position)[expected.declared] / cell
    assert away.abs().max() < cells


@ON_AN_ACCELERATOR
@TRACKERS
def test_the_command_runs_on_an_accelerator(launch, tracker):
    """Tables, figures and event files included."""
    name = torch.accelerator.current_accelerator().type
    choice = f"tracker={tracker}", f"device={name}", "logging=default", "logging.progress=false"
    outcome = launch("scenario=line_array", "scenario.num_steps=10", *choice, small=False)
    assert outcome.status == 0, outcome.err
    assert outcome.values[0] < 5  # degrees; 10 with nothing declared, at a cutoff of 10
