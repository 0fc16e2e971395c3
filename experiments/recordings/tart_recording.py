"""Recordings of a TART radio array as settings describe them: `data=tart` of all jobs started here."""

import dataclasses
import logging
from dataclasses import dataclass
from typing import Annotated

import torch
from hydra.core.config_store import ConfigStore

from recordings.tart_count import effective_count
from recordings.tart_file import read_tart
from recordings.tart_standing import standing_covariance, without_standing
from torchdt.app.build import read_data
from torchdt.app.data_settings import DataSettings
from torchdt.app.settings import TrackSettings
from torchdt.app.targets import build_field
from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.detect.pursuit import MatchingPursuit
from torchdt.core.ranges import Count, OneOf, Range
from torchdt.data.recording import Recording
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.region import Coordinate, Region

log = logging.getLogger(__name__)

POINTS = PursuitConfig(points=12, threshold=0.0, pick_threshold=0.0)
"""A fixed number, so that they do not depend on the count that is looked for."""

COUNTED = 42
"""Steps from which the count is taken, at most, evenly spread."""


@dataclass
class TartSettings(DataSettings):
    """Visibilities of a TART radio array, see `recordings.tart_file`.

    Attributes:
        kind: `tart`.
        path: of one file.
        average: consecutive covariances that make one step.
        standing: take out what stands still and is no sky, see `recordings.tart_standing`.
        effective_count: snapshots that a covariance counts as; None takes it from the misfit of point
            sources, see `recordings.tart_count`.
    """

    kind: Annotated[str, OneOf(("tart",))] = "tart"
    average: Count = 10
    standing: bool = True
    effective_count: Annotated[float, Range("a number from one up", low=1)] | None = None


ConfigStore.instance().store(name="tart_schema", node=TartSettings)


@read_data.register
def read_sky(data: TartSettings, settings: TrackSettings) -> Recording:
    """One file, less its standing part where that is asked for, with its effective number of snapshots.

    Raises:
        InputError: where the file does not make sense.
    """
    recording = read_tart(data.one_path, data.average)
    assert recording.freqs is not None
    assert recording.sensor_positions is not None
    array = {"freqs": recording.freqs.tolist(), "sensor_positions": recording.sensor_positions.tolist()}
    field = build_field({**settings.field, **array}, torch.float64, "cpu")
    coordinates = [Coordinate(**vars(c)) for c in settings.scenario.coordinates]
    covariance = recording.data[0, :, 0]
    if data.standing:
        # Sources between the cells must not be taken for something else: half of them in each coordinate.
        fine = [dataclasses.replace(c, cell=c.cell / 2) for c in coordinates]
        sky = Region(fine, torch.float64).within(field)
        standing = standing_covariance(covariance, field, sky)
        log.info("standing part: %.2g of a sensor's power in a pair, rms", _rms(standing))
        covariance = without_standing(covariance, standing)
    count = data.effective_count
    if count is None:
        region = Region(coordinates, torch.float64).within(field)
        detector = MatchingPursuit(field, region, build_dictionary(field, region), POINTS)
        count = effective_count(covariance[:: -(-len(covariance) // COUNTED)], field, detector)
        log.info("each covariance counts as %.0f snapshots", count)
    return dataclasses.replace(recording, covariance=covariance[None, :, None], num_snapshots=count)


def _rms(standing: torch.Tensor) -> float:
    size = standing.shape[-1]
    return (standing.abs().square().sum() / (size * (size - 1))).sqrt().item()
