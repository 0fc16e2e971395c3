"""Recordings whose truth is in direction cosines: `data=directions` of all jobs started here."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import torch
from hydra.core.config_store import ConfigStore
from torch import Tensor

from torchdt.app.build import read_data, read_recordings
from torchdt.app.data_settings import DataSettings
from torchdt.app.settings import TrackSettings
from torchdt.core.errors import require
from torchdt.core.ranges import OneOf, StepIndex, Steps
from torchdt.data.recording import Recording
from torchdt.field.directions import DIRECTIONS, from_direction_cosines


@dataclass
class DirectionSettings(DataSettings):
    """An `.npz` file as of `data=npz`, whose truth is direction cosines to the east and north.

    Attributes:
        kind: `directions`.
        path: of a file, or several; the same file five times is tracked with five seeds.
        first_step: that is tracked, from zero.
        num_steps: from there on; None is all.
    """

    kind: Annotated[str, OneOf(("directions",))] = "directions"
    first_step: StepIndex = 0
    num_steps: Steps | None = None


ConfigStore.instance().store(name="directions_schema", node=DirectionSettings)


@read_data.register
def read_directions(data: DirectionSettings, settings: TrackSettings) -> Recording:
    """Files as one batch, some of their steps, with the truth in the coordinates of the field.

    Raises:
        InputError: where a file does not make sense, its truth is no directions or those are none of the
            field's, or there are fewer steps.
    """
    given = bool(data.paths) and all(isinstance(path, str) and path for path in data.paths)
    require(given, "data.path", data.path, "the path of a file or a list of paths")
    recording = read_recordings(data.paths)
    last = recording.num_steps if data.num_steps is None else data.first_step + data.num_steps
    expected = f"steps within the {recording.num_steps} of the recording"
    holds = data.first_step < last <= recording.num_steps
    require(holds, "data.num_steps", f"steps from {data.first_step} to {last}", expected)
    part = slice(data.first_step, last)
    snapshots, covariance, truth = (
        None if values is None else values[:, part]
        for values in (recording.snapshots, recording.covariance, recording.truth)
    )
    return dataclasses.replace(
        recording,
        start_s=recording.start_s + data.first_step * recording.step_s,
        snapshots=snapshots,
        covariance=covariance,
        truth=None if truth is None else in_coordinates(truth, settings.field.get("coordinates")),
    )


def in_coordinates(truth: Tensor, coordinates: object) -> Tensor:
    """Direction cosines `(*batch, 2)` as positions `(*batch, d)` of a field of directions; NaN stays.

    Raises:
        InputError: where these are no direction cosines, or the field has no directions.
    """
    found = f"{truth.shape[-1]} coordinates"
    require(truth.shape[-1] == 2, "truth", found, "direction cosines to the east and north")
    known = [name for name in DIRECTIONS if name == coordinates]
    require(bool(known), "field.coordinates", coordinates, f"one of {list(DIRECTIONS)}")
    position = DIRECTIONS[known[0]].positions(from_direction_cosines(truth))[0]
    return torch.where(truth.isnan().any(-1, keepdim=True), torch.nan, position)
