"""Recordings of raw signals as settings describe them."""

import math
from pathlib import Path

import torch
from torch import Tensor

from torchdt.app.data_settings import SignalSettings
from torchdt.app.settings import TrackSettings
from torchdt.app.targets import build_field
from torchdt.core.errors import InputError, require
from torchdt.data.recording import Recording, step_times, validate
from torchdt.data.signals.readers import open_npy, open_wav
from torchdt.data.signals.signal import Signal
from torchdt.data.signals.sio import open_sio
from torchdt.data.signals.spectra import samples_of_step, tone_snapshots
from torchdt.data.signals.static_copy import add_static_copy
from torchdt.data.signals.truth import read_truth
from torchdt.simulation.settings import ScenarioSettings
from torchdt.simulation.simulate import position_along

READERS = {"wav": open_wav, "npy": open_npy, "sio": open_sio}


def read_signals(data: SignalSettings, settings: TrackSettings) -> Recording:
    """Snapshots of the field's tones from one file of signals, and the truth from another.

    Raises:
        InputError: where files or settings do not make sense, or the file does not fit the field.
    """
    path = Path(data.one_path)
    signal = READERS[data.kind](path)
    sample_rate = _sample_rate(signal, data)
    sensors = build_field(settings.field, torch.float64, "cpu").num_sensors
    channels = signal.num_channels
    expected = f"{sensors}, one for each sensor of the field"
    require(channels == sensors, "data.path", f"'{path}': {channels} channels", expected)
    require("freqs" in settings.field, "field.freqs", "nothing", "the tones to look for, Hz")
    start, stop = _segment(signal, data, sample_rate)
    sizes = data.window_length, data.hop, data.snapshots_per_step
    snapshots = tone_snapshots(
        signal.blocks(start, stop),
        sample_rate,
        settings.field["freqs"],
        window_length=data.window_length,
        hop=data.hop,
        snapshots_per_step=data.snapshots_per_step,
        search_hz=data.search_hz,
    )
    step_s, start_s = data.snapshots_per_step * data.hop / sample_rate, start / sample_rate
    span_s = samples_of_step(*sizes) / sample_rate
    times = step_times(len(snapshots), step_s, start_s, span_s)
    truth = _truth(settings.scenario, data, times, start_s)
    if data.static_copy.step is not None:
        copied = data.static_copy.step, data.static_copy.gain_db
        snapshots, truth = add_static_copy(snapshots, truth, *copied)
    return validate(
        snapshots=snapshots, truth=truth, step_s=step_s, start_s=start_s, span_s=span_s, name=path.stem
    )


def _truth(scenario: ScenarioSettings, data: SignalSettings, times: Tensor, start_s: float) -> Tensor | None:
    """True positions `(K, L, d)` at times `(K,)` s of the file, if they are known.

    A path of the scenario begins where the segment does, at `start_s`.
    """
    if data.truth is not None:
        names = [coordinate.name for coordinate in scenario.coordinates]
        return read_truth(Path(data.truth), names, times, data.truth_depth_m)
    if data.truth_path is None:
        return None
    known = sorted(scenario.paths)
    require(data.truth_path in known, "data.truth_path", data.truth_path, f"a path of the scenario: {known}")
    return position_along(scenario.paths[data.truth_path], times - start_s)[:, None]


def _sample_rate(signal: Signal, data: SignalSettings) -> float:
    """That of the file, which the settings must not contradict, or else that of the settings."""
    known, given = signal.sample_rate, data.sample_rate
    sample_rate = given if known is None else known
    if sample_rate is None:
        raise InputError.of_key("data.sample_rate", None, f"Hz, which .{data.kind} files do not say")
    agrees = given is None or math.isclose(given, sample_rate)
    require(agrees, "data.sample_rate", f"{given} Hz", f"{known} Hz, as in the file, or null")
    return sample_rate


def _segment(signal: Signal, data: SignalSettings, sample_rate: float) -> tuple[int, int]:
    """First sample, and the one after the last."""
    length = signal.num_samples / sample_rate
    start = round(data.start_s * sample_rate)
    require(start < signal.num_samples, "data.start_s", data.start_s, f"less than the file's {length:g} s")
    if data.duration_s is None:
        return start, signal.num_samples
    stop = start + round(data.duration_s * sample_rate)
    left = (signal.num_samples - start) / sample_rate
    require(stop <= signal.num_samples, "data.duration_s", data.duration_s, f"at most {left:g} s, or null")
    return start, stop
