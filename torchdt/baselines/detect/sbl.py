"""Sparse Bayesian learning as a detector: the peaks of its spectrum, refined between the cells."""

import torch
from torch import Tensor

from torchdt.baselines.detect.climb import climb
from torchdt.baselines.detect.config import SblConfig
from torchdt.baselines.detect.peaks import Grid, close, find_peaks
from torchdt.baselines.detect.points import Points
from torchdt.baselines.detect.spectrum import converge, flatten, spread
from torchdt.core.errors import require
from torchdt.core.trees import tree_map
from torchdt.field.base import Field
from torchdt.filter.bp.moments import weighted_moment
from torchdt.filter.bp.rank_one import peak_log_likelihood_ratio, statistics, whiten
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.proposal.moved import respond
from torchdt.model.measurement import Measurement, mask_covariance
from torchdt.model.region import Region


class SparseBayesianLearning:
    """Detector of the peaks of the SBL spectrum.

    Args:
        field: response of the array.
        region: limits and grid.
        dictionary: of the same field and region.
        config: settings.

    Raises:
        InputError: where there are not fewer sources than sensors.
    """

    def __init__(self, field: Field, region: Region, dictionary: Dictionary, config: SblConfig):
        key, sources = "tracker.detector.sources", config.sources
        require(sources < field.num_sensors, key, sources, f"fewer than the {field.num_sensors} sensors")
        self.field, self.region, self.dictionary, self.config = field, region, dictionary, config

    @torch.no_grad()
    def __call__(self, measurement: Measurement) -> Points:
        """Detect the points of every step.

        Args:
            measurement: batch `(*batch,)`, or `(B, *batch)` with a field per sequence.
        """
        batch, cfg = measurement.num_snapshots.shape[:-1], self.config
        flat, grid = flatten(measurement), self.dictionary.points
        active = converge(self.dictionary.response, flat, Grid.of(self.region), cfg)
        cell, present = find_peaks(
            spread(active, len(grid)), Grid.of(self.region), cfg.points, cfg.separation
        )
        # Each peak is judged, and moved off the grid, before all that is not part of it.
        apart = self.region.difference(grid[cell].unsqueeze(-2), grid[active.column].unsqueeze(-3))
        far = ~close(apart / self.region.cell, cfg.separation)
        signal = weighted_moment(active.response.unsqueeze(1), far * active.power.unsqueeze(-2))
        each = flat.unsqueeze()
        whitener = whiten(each, mask_covariance(signal, active.noise.unsqueeze(-2), each.present))

        def response(position: Tensor) -> Tensor:
            """Of positions `(S, Q, P, d)`, with tones before P."""
            found = respond(self.field, position.reshape(batch + position.shape[1:]))
            return found.reshape(-1, *found.shape[len(batch) :])

        def test(position: Tensor) -> tuple[Tensor, Tensor]:
            s, q = statistics(whitener, response(position))
            return peak_log_likelihood_ratio(whitener.num_snapshots[..., None], s, q)

        position = grid[cell]
        if cfg.refine:
            position = climb(lambda x: test(x)[0].sum(-2), position, self.region)
        gain, power = test(position.unsqueeze(-2))
        points = Points(position, gain[..., 0].sum(-1), power[..., 0], present, active.noise)
        points = points.strongest_first().above(cfg.threshold)
        return tree_map(lambda t: t.reshape(batch + t.shape[1:]), points)
