"""Objects from settings: fields, recordings, trackers."""

import logging
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from torch import Generator, Tensor
from torch.nn.functional import pad

from torchdt.calibration.environment import calibrate
from torchdt.errors import InputError, require
from torchdt.experiment.settings import TrackSettings
from torchdt.field.base import Field
from torchdt.field.build import EnvironmentDraw
from torchdt.field.family import WaveguideFamily, draw_of
from torchdt.field.mismatch import MismatchedField
from torchdt.field.stacked import StackedDiffuseField, StackedField
from torchdt.field.waveguide import NormalModeField
from torchdt.model.birth import birth_log_odds
from torchdt.model.measurement import Measurement
from torchdt.model.parameters import default_parameters
from torchdt.model.prior import Priors
from torchdt.model.region import Coordinate, Region
from torchdt.scenario.generate import generate_snapshots
from torchdt.scenario.npz import read_npz
from torchdt.scenario.recording import Recording, validate
from torchdt.scenario.settings import MismatchSettings
from torchdt.scenario.simulate import simulate_snapshots
from torchdt.tracker import DirectTracker
from torchdt.tracking import generator, prepare

log = logging.getLogger(__name__)
ARRAY_KEYS = ("freqs", "element_depths", "sensor_positions")


def build_field(target: dict[str, Any], dtype: torch.dtype, device: str, **overrides: object) -> Field:
    """Instantiate a field from its configuration group.

    Raises:
        InputError: where the target does not exist or does not take these arguments.
    """
    try:
        field = instantiate({**target, **overrides}, dtype=dtype, device=device, _convert_="all")
    except InputError:
        raise
    except Exception as error:
        # Hydra wraps what a target raises; the cause says what is wrong with the input.
        cause = error.__cause__
        raise cause if isinstance(cause, InputError) else InputError(f"key 'field': {error}") from error
    if not isinstance(field, Field):
        raise InputError.of_key(
            "field._target_", type(field).__name__, "an object that follows torchdt.field.Field"
        )
    return field


def build_recording(settings: TrackSettings) -> Recording:
    """Read or simulate the data.

    Raises:
        InputError: where a file or the scenario does not make sense.
    """
    if settings.data.kind == "npz":
        recording = read_npz(Path(settings.data.path or ""))
        summary = recording.missing_summary()
        if summary.num_missing:
            log.warning(
                "%d of %d values are missing (NaN) and left out; dead channels of each sequence: %s",
                summary.num_missing,
                summary.num_entries,
                [dead.nonzero().flatten().tolist() for dead in summary.dead_channels],
            )
        return recording
    return simulate(settings)


def simulate(settings: TrackSettings) -> Recording:
    """Simulate `runs` sequences; sequence b depends on `seed + b` alone.

    Sequences of fewer sources than others have their truth filled up with absent ones.
    """
    scenario, target = settings.scenario, settings.field
    num_coordinates = build_field(target, torch.float64, "cpu").num_coordinates
    check_coordinates(settings, num_coordinates)
    region = Region(build_region(settings, torch.float64).coordinates, torch.float64)
    snapshots, truth = [], []
    nominal = None if not scenario.mismatch.matched else build_field(target, torch.float64, "cpu")
    for seed in range(settings.seed, settings.seed + settings.runs):
        stream = generator(seed, "simulation")
        field = nominal or build_field(
            target, torch.float64, "cpu", draw=draw_environment(scenario.mismatch, target, stream)
        )
        if scenario.population is None:
            z, position = simulate_snapshots(field, scenario, stream)
        else:
            z, position = generate_snapshots(field, region, scenario, scenario.population, stream)
        snapshots.append(z)
        truth.append(position)
    most = max(position.shape[1] for position in truth)
    padded = [pad(position, (0, 0, 0, most - position.shape[1]), value=torch.nan) for position in truth]
    return validate(
        snapshots=torch.stack(snapshots),
        truth=torch.stack(padded),
        step_s=scenario.step_s,
        name=scenario.name,
    )


def check_coordinates(settings: TrackSettings, num_coordinates: int) -> None:
    """Refuse a scenario whose states are not those of the field."""
    found = len(settings.scenario.coordinates)
    expected = f"{num_coordinates}, as the field"
    require(found == num_coordinates, "scenario.coordinates", f"{found} coordinates", expected)


def draw_environment(
    mismatch: MismatchSettings, target: dict[str, Any], stream: Generator
) -> EnvironmentDraw:
    """One departure from the nominal environment."""

    def magnitude(limits: list[float]) -> float:
        size, sign = torch.rand(2, generator=stream, dtype=torch.float64).tolist()
        return (limits[0] + (limits[1] - limits[0]) * size) * (1 if sign < 0.5 else -1)

    eofs = target.get("eofs")
    if eofs is None:
        raise InputError.of_key(
            "scenario.mismatch", "a mismatch", "none: this field has no environment to vary"
        )
    num = len(eofs["functions"][0])
    coefficients = mismatch.eof_scale * torch.randn(num, generator=stream, dtype=torch.float64)
    return EnvironmentDraw(
        tuple(coefficients.tolist()), magnitude(mismatch.tilt_deg), magnitude(mismatch.water_depth_m)
    )


def build_tracker(settings: TrackSettings, recording: Recording) -> DirectTracker:
    """Tracker for a recording; what the recording says of its array replaces the field's configuration.

    Raises:
        InputError: where truth or array do not fit the scenario.
    """
    known = {key: getattr(recording, key) for key in ARRAY_KEYS}
    overrides = {
        key: value.tolist()
        for key, value in known.items()
        if isinstance(value, Tensor) and key in settings.field
    }
    target = {**settings.field, **overrides}
    field = build_field(target, settings.torch_dtype, settings.device)
    region = build_region(settings, settings.torch_dtype)
    check_coordinates(settings, field.num_coordinates)
    if recording.truth is not None and recording.truth.shape[-1] != region.num_coordinates:
        found = f"{recording.truth.shape[-1]} coordinates"
        raise InputError.of_key("truth", found, f"{region.num_coordinates}, as the scenario")
    if settings.calibration.enabled:
        field = calibrated_field(settings, recording, target, field)
    return DirectTracker(field, region, recording.step_s, settings.tracker)


def build_region(settings: TrackSettings, dtype: torch.dtype) -> Region:
    """The scenario's region of interest.

    Raises:
        InputError: where a coordinate does not make sense.
    """
    try:
        coordinates = [Coordinate(**vars(c)) for c in settings.scenario.coordinates]
    except ValueError as error:
        raise InputError(f"key 'scenario.coordinates': {error}") from error
    return Region(coordinates, dtype, settings.device)


def calibrated_field(
    settings: TrackSettings, recording: Recording, target: dict[str, Any], nominal: Field
) -> Field:
    """Fit the environment of each sequence; one field per sequence.

    Raises:
        InputError: where the field is no waveguide with EOFs.
    """
    config = settings.calibration
    eofs = target.get("eofs")
    if not isinstance(nominal, NormalModeField) or eofs is None:
        raise InputError.of_key("calibration.enabled", True, "false: this field has no environment to fit")

    def solve(draw: EnvironmentDraw, dtype: torch.dtype = torch.float64) -> NormalModeField:
        field = build_field(target, dtype, settings.device, draw=draw)
        assert isinstance(field, NormalModeField)
        return field

    num_eofs = len(eofs["functions"][0])
    family = WaveguideFamily(
        solve, [config.eof_std] * num_eofs, config.tilt_std_deg, config.water_depth_std_m, settings.device
    )
    region = build_region(settings, torch.float64)
    prepared = prepare(recording, nominal, region, settings.tracker)
    birth_mean = default_parameters(settings.tracker, region).birth_mean
    threshold = settings.tracker.pick_threshold(birth_log_odds(birth_mean, region.num_cells))
    names = [f"EOF {i + 1}" for i in range(num_eofs)] + ["tilt (deg)", "water depth (m)"]
    fields = []
    for run in range(recording.batch_size):
        theta, share = calibrate(
            family,
            region,
            Measurement(*(t[run] for t in prepared.measurement)),
            Priors(*(t[run] for t in prepared.priors)),
            config,
            threshold,
            generator(settings.seed + run, "calibration"),
        )
        found = ", ".join(f"{name} {value:+.2f}" for name, value in zip(names, theta.tolist(), strict=True))
        log.info(
            "sequence %d: environment departs from nominal by %s", run, found if theta.any() else "nothing"
        )
        log.info("sequence %d: unexplained share of each tone %s", run, share.tolist())
        field = solve(draw_of(theta), settings.torch_dtype) if theta.any() else nominal
        fields.append(MismatchedField(field, share.to(settings.torch_dtype)))
    if any(field.share.any() for field in fields):
        return StackedDiffuseField(fields)
    return StackedField([field.field for field in fields])
