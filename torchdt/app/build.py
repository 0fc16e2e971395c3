"""Objects from settings: fields, recordings, trackers."""

import functools
import itertools
import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.app.data_settings import DataSettings, SignalSettings
from torchdt.app.environment import calibrated_field
from torchdt.app.settings import TrackSettings
from torchdt.app.signals import read_signals
from torchdt.app.targets import build_field
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import InputError, require
from torchdt.core.memory import require_memory
from torchdt.data.npz import read_npz
from torchdt.data.recording import Recording, validate
from torchdt.field.base import BaseField
from torchdt.filter.direct import DirectTracker
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.tracker import PaperTracker
from torchdt.filter.tracker import Tracker
from torchdt.model.region import Coordinate, Region
from torchdt.run.track import generator
from torchdt.simulation.disturbances import disturb
from torchdt.simulation.generate import generate_snapshots
from torchdt.simulation.mismatch import draw_environment, with_array_errors
from torchdt.simulation.simulate import noise_variance, simulate_interference, simulate_snapshots
from torchdt.tuning.sequences import stack_recordings

log = logging.getLogger(__name__)
ARRAY_KEYS = ("freqs", "element_depths", "sensor_positions")


def build_recording(settings: TrackSettings) -> Recording:
    """Read or simulate the data.

    Raises:
        InputError: where a file or the scenario does not make sense.
    """
    recording = reported(read_data(settings.data, settings), settings)
    size = recording.batch_size, recording.num_steps, recording.num_tones, recording.num_sensors
    log.info("%s: sequences %d, steps %d, tones %d, sensors %d", recording.name or "recording", *size)
    summary = recording.missing_summary()
    if summary.num_missing:
        log.warning(
            "%d of %d values are missing (NaN) and left out; dead channels of each sequence: %s",
            summary.num_missing,
            summary.num_entries,
            [dead.nonzero().flatten().tolist() for dead in summary.dead_channels],
        )
    return recording


def reported(recording: Recording, settings: TrackSettings) -> Recording:
    """The recording with the truth of what is reported, see `Coordinate.report_low`; the rest is absent."""
    region, truth = build_region(settings, torch.float64), recording.truth
    if region.reports_all or truth is None or truth.shape[-1] != region.num_coordinates:
        return recording
    scored = region.reports(truth.to(region.low.device)).to(truth.device)
    return replace(recording, truth=torch.where(scored[..., None], truth, torch.nan))


@functools.singledispatch
def read_data(data: DataSettings, settings: TrackSettings) -> Recording:
    """Read or simulate data of one type of settings; `read_data.register` adds the reader of another."""
    return simulate(settings) if data.kind == "simulated" else read_recordings(data.paths)


read_data.register(SignalSettings, read_signals)


def read_recordings(paths: Sequence[str]) -> Recording:
    """Read files as one batch, in their order.

    Raises:
        InputError: where a file does not make sense, or naming the one that differs from the first in kind or
            shape of the data, time step, array, or in having truth.
    """
    recordings = [read_npz(Path(path)) for path in paths]
    first = recordings[0]
    for path, other in zip(paths, recordings, strict=True):
        try:
            require(other.num_steps == first.num_steps, "steps", other.num_steps, first.num_steps)
            found, expected = (_truth_kind(recording) for recording in (other, first))
            require(found == expected, "truth", found, expected)
            # What is left to compare does not differ between the sequences of a file.
            stack_recordings([recording.select(slice(0, 1)) for recording in (first, other)])
        except InputError as error:
            raise InputError(f"path '{path}': {error}, to fit '{paths[0]}'") from error
    return stack_recordings(recordings)[0]


def _truth_kind(recording: Recording) -> str:
    return "nothing" if recording.truth is None else f"positions of {recording.truth.shape[-1]} coordinates"


def simulate(settings: TrackSettings) -> Recording:
    """Simulate `runs` sequences; sequence b depends on `seed + b` alone.

    Sequences of fewer sources than others have their truth filled up with absent ones.
    """
    # A departure from the nominal environment is the tracker's; scenarios make their own.
    scenario, target = settings.scenario, {k: v for k, v in settings.field.items() if k != "draw"}
    array = build_field(target, torch.float64, "cpu")
    check_coordinates(settings, array.num_coordinates)
    shape = settings.runs, scenario.num_steps, array.num_tones, scenario.num_snapshots, array.num_sensors
    size = 3 * math.prod(shape) * torch.complex128.itemsize  # one sequence's parts beside all that are done
    found = "{} runs of {} steps, {} tones, {} snapshots and {} sensors".format(*shape)
    require_memory(size, torch.device("cpu"), "scenario.num_steps", found)
    region = Region(build_region(settings, torch.float64).coordinates, torch.float64)
    snapshots, truth = [], []
    mismatch, target = scenario.mismatch, scenario.mismatch.shaped(target)
    nominal = build_field(target, torch.float64, "cpu") if mismatch.matched else None
    for seed in range(settings.seed, settings.seed + settings.runs):
        stream = generator(seed, "simulation")
        around = stream if mismatch.seed is None else generator(mismatch.seed, "environment")
        field = nominal or build_field(
            target, torch.float64, "cpu", draw=draw_environment(mismatch, target, around)
        )
        field = with_array_errors(field, mismatch, around)
        if scenario.population is None:
            z, position = simulate_snapshots(field, scenario, stream)
        else:
            z, position = generate_snapshots(
                field, region.within(field), scenario, scenario.population, stream
            )
        # Drawn after all else, which stays the same without them.
        z = z + simulate_interference(field, scenario, stream)
        variance, glitches = noise_variance(field, scenario), generator(seed, "disturbances")
        snapshots.append(disturb(z, scenario.disturbances, field, variance, glitches))
        truth.append(region.wrap(position))
    most = max(position.shape[1] for position in truth)
    padded = [pad(position, (0, 0, 0, most - position.shape[1]), value=torch.nan) for position in truth]
    return validate(
        snapshots=torch.stack(snapshots),
        truth=torch.stack(padded),
        step_s=scenario.step_s,
        name=scenario.name,
    )


def simulate_each(settings: TrackSettings, seeds: Sequence[int]) -> Recording:
    """Simulate one sequence for each seed; consecutive seeds share a call of `simulate`."""
    groups = itertools.groupby(enumerate(seeds), key=lambda pair: pair[1] - pair[0])
    runs = [[seed for _, seed in group] for _, group in groups]
    each = [simulate(replace(settings, seed=run[0], runs=len(run))) for run in runs]
    return reported(stack_recordings(each)[0], settings)


def check_coordinates(settings: TrackSettings, num_coordinates: int) -> None:
    """Refuse a scenario whose states are not those of the field."""
    found = len(settings.scenario.coordinates)
    expected = f"{num_coordinates}, as the field"
    require(found == num_coordinates, "scenario.coordinates", f"{found} coordinates", expected)


def build_tracker(
    settings: TrackSettings, recording: Recording, field: BaseField | None = None
) -> Tracker[Any]:
    """Tracker for a recording.

    Args:
        settings: of the tracker, and of the field where that is not given.
        recording: B sequences.
        field: that of `build_tracking_field`, for several trackers on one recording.

    Raises:
        InputError: where truth or array do not fit the scenario.
    """
    if field is None:
        field = build_tracking_field(settings, recording)
    region, model = build_region(settings, settings.torch_dtype), settings.statistical_model
    config = settings.built_tracker
    if isinstance(config, TwoStepConfig):
        return TwoStepTracker(field, region, recording.step_s, config, model.motion)
    if isinstance(config, PaperConfig):
        return PaperTracker(field, region, recording.step_s, config, model)
    config, expected = settings.direct, "null, or calibration=none: that estimates the share"
    share = config.mismatch_share
    require(share is None or not settings.calibration.enabled, "tracker.mismatch_share", share, expected)
    return DirectTracker(field, region, recording.step_s, config, model)


def build_tracking_field(settings: TrackSettings, recording: Recording) -> BaseField:
    """The field in which a recording is tracked, calibrated where that is asked for.

    What the recording says of its array replaces the field's configuration.

    Raises:
        InputError: where truth or array do not fit the scenario.
    """
    target = recorded_target(settings, recording)
    field = build_field(target, settings.torch_dtype, settings.device)
    region = build_region(settings, settings.torch_dtype)
    check_coordinates(settings, field.num_coordinates)
    if recording.truth is not None and recording.truth.shape[-1] != region.num_coordinates:
        found = f"{recording.truth.shape[-1]} coordinates"
        raise InputError.of_key("truth", found, f"{region.num_coordinates}, as the scenario")
    if settings.calibration.enabled:
        field = calibrated_field(settings, recording, target, field, region)
    return field


def recorded_target(settings: TrackSettings, recording: Recording) -> dict[str, Any]:
    """The field's configuration, with what a recording says of its array in place of it."""
    known = {key: getattr(recording, key) for key in ARRAY_KEYS if key in settings.field}
    return {**settings.field, **{key: v.tolist() for key, v in known.items() if isinstance(v, Tensor)}}


def build_region(settings: TrackSettings, dtype: torch.dtype) -> Region:
    """The scenario's region of interest.

    Raises:
        InputError: where a coordinate does not make sense.
    """
    coordinates = [Coordinate(**vars(c)) for c in settings.scenario.coordinates]
    return Region(coordinates, dtype, settings.device)
