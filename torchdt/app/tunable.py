"""What a tuning job works on: sequences, what can be tuned on them, and trackers of given values."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.app.build import (
    build_recording,
    build_region,
    build_tracking_field,
    recorded_target,
    simulate_each,
)
from torchdt.app.environment import waveguide_family
from torchdt.app.settings import TrackSettings
from torchdt.core.errors import require
from torchdt.core.support import Quantity
from torchdt.data.npz import read_npz
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField, of_each
from torchdt.field.build import EnvironmentDraw, as_draw
from torchdt.field.mismatch import MISMATCH_SHARE
from torchdt.field.waveguide.family import ENVIRONMENT
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.model.hyperparameters import Hyperparameters, HyperparameterSettings
from torchdt.tuning.fields import FieldOf, environment_fields, share_fields
from torchdt.tuning.sequences import stack_recordings
from torchdt.tuning.tracker import TrackerFamily

# Where the share starts if the configuration has none; zero lies on the edge of its support.
SHARE_START = 0.01


class SequenceSet(NamedTuple):
    """Sequences tuned or held out together.

    Attributes:
        recording: B sequences of K steps.
        mask: `(B, K)` bool, steps that are not padding.
        seeds: of the filter, one per sequence.
    """

    recording: Recording
    mask: Tensor
    seeds: list[int]


def gather(settings: TrackSettings, seeds: Sequence[int], paths: Sequence[str], pad: bool) -> SequenceSet:
    """Read the files or, without any, simulate the scenario once for each seed.

    Raises:
        InputError: where a file does not make sense or the recordings do not fit together.
    """
    if paths:
        recordings = [_read(settings, path) for path in paths]
        number = sum(r.batch_size for r in recordings)
        seeds = range(settings.seed, settings.seed + number)
    else:
        recordings = [simulate_each(settings, seeds)]
    return SequenceSet(*stack_recordings(recordings, pad), list(seeds))


def _read(settings: TrackSettings, path: str) -> Recording:
    if settings.data.kind == "simulated":
        return read_npz(Path(path))
    return build_recording(replace(settings, data=replace(settings.data, path=path)))


class Problem(NamedTuple):
    """What is tuned, and the trackers of its values for each set.

    Attributes:
        hyperparameters: at their start.
        families: of trackers, in the order of the sets.
    """

    hyperparameters: Hyperparameters
    families: list[TrackerFamily]


def build_problem(
    settings: TrackSettings, chosen: dict[str, HyperparameterSettings], sets: Sequence[SequenceSet]
) -> Problem:
    """Hyperparameters of the configured model, and trackers in their field.

    Raises:
        InputError: where a hyperparameter is unknown or none of this field, starts outside its range, or
            belongs to an environment that the calibration is to fit; or where a set does not fit the field.
    """
    of_field = [name for name in chosen if name in (*ENVIRONMENT, "mismatch_share")]
    for name in of_field:
        expected = "calibration=none: it would fit the same"
        require(not settings.calibration.enabled, f"hyperparameters.{name}", "calibration.enabled", expected)
    tuned = "mismatch_share" in chosen
    config = replace(settings.direct, mismatch_share=None) if tuned else settings.direct
    fields = [build_tracking_field(settings, s.recording) for s in sets]
    region, model = build_region(settings, settings.torch_dtype), settings.statistical_model
    target = recorded_target(settings, sets[0].recording)
    quantities = _quantities(settings, target, fields[0], sets[0].recording.num_snapshots)
    hyperparameters = Hyperparameters(chosen, quantities)
    varied = None
    if any(name in ENVIRONMENT for name in chosen):
        start = {name: torch.as_tensor(quantities[name].value, dtype=torch.float64) for name in ENVIRONMENT}
        with torch.no_grad():
            family = waveguide_family(settings, target, settings.torch_dtype)
            varied = environment_fields(family, {**start, **hyperparameters()})
    families = []
    for field, part in zip(fields, sets, strict=True):
        field_of = varied or _constant(field)
        if tuned:
            field_of = share_fields(field_of, region.low)
        families.append(TrackerFamily(field_of, region, part.recording.step_s, config, model))
    return Problem(hyperparameters, families)


def _constant(field: BaseField) -> FieldOf:
    return lambda values: field


def _quantities(
    settings: TrackSettings, target: dict, field: BaseField, num_snapshots: float | None
) -> dict[str, Quantity]:
    """All that can be tuned, with the values of the configuration, in float64.

    Args:
        settings, target, field: of the tracker.
        num_snapshots: nominal number behind each covariance; None for snapshots, which are not up for tuning.
    """
    known = settings.statistical_model.on(build_region(settings, torch.float64)).all_quantities()
    count = known["effective_count"]
    if num_snapshots is None or count.value is None:
        known["effective_count"] = count._replace(value=num_snapshots)
    own = build_region(settings, settings.torch_dtype)
    if field.incoherent(of_each(field, own.complete(own.cell_centres()[:1]))) is not None:
        share = settings.direct.mismatch_share or [SHARE_START] * field.num_tones
        known["mismatch_share"] = MISMATCH_SHARE._replace(value=torch.tensor(share, dtype=torch.float64))
    eofs = target.get("eofs")
    if isinstance(field, NormalModeField) and eofs is not None:
        draw = as_draw(target.get("draw")) or EnvironmentDraw()
        coefficients = torch.zeros(len(eofs["functions"][0]), dtype=torch.float64)
        coefficients[: len(draw.eof_coefficients)] = torch.tensor(draw.eof_coefficients)
        values: tuple[Tensor | float, ...] = (coefficients, draw.tilt_deg, draw.water_depth_m)
        for (name, quantity), value in zip(ENVIRONMENT.items(), values, strict=True):
            known[name] = quantity._replace(value=value)
    return known
