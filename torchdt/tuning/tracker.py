"""The objective of the tracker: the evidence of sequences under trackers of given hyperparameters."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.data.prepare import Prepared
from torchdt.field.base import Field
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.likelihood import log_likelihood
from torchdt.model.model import Model
from torchdt.model.region import Region
from torchdt.run.track import derive_seed


@dataclass(frozen=True)
class TrackerFamily:
    """Trackers by hyperparameters.

    Attributes:
        field_of: field of given values.
        region, step_s, config, model: as for `DirectTracker`; the model has what the values do not name.
    """

    field_of: Callable[[Mapping[str, Tensor]], Field]
    region: Region
    step_s: float
    config: TrackerConfig
    model: Model

    def at(self, values: Mapping[str, Tensor]) -> DirectTracker:
        """The tracker of given values; gradients pass."""
        own = {name: value for name, value in values.items() if name in self.model.all_quantities()}
        model = self.model.on(self.region).with_numbers(own)
        return DirectTracker(self.field_of(values), self.region, self.step_s, self.config, model)


class TrackerObjective:
    """Evidence of a tracker, with common random numbers: every call draws the same.

    Args:
        family: trackers by values.
        prepared: B sequences of K steps.
        mask: `(B, K)` bool, the steps that count.
        seeds: one per sequence, as for `torchdt.run.track.track`.
        block, truncate: see `torchdt.filter.likelihood.log_likelihood`.
    """

    def __init__(
        self,
        family: TrackerFamily,
        prepared: Prepared,
        mask: Tensor,
        seeds: Sequence[int],
        *,
        block: int | None = None,
        truncate: int | None = None,
    ) -> None:
        self.num_steps = int(mask.sum())
        self._family, self._prepared = family, prepared
        self._mask = mask.to(family.region.low.device)
        self._seeds = [derive_seed(seed, "filter") for seed in seeds]
        self._block, self._truncate = block, truncate

    def __call__(self, values: Mapping[str, Tensor]) -> Tensor:
        """Log-likelihood of each sequence, `(B,)` float64.

        Raises:
            NumericalError: where the filter broke down.
        """
        low = self._family.region.low
        streams = RandomStreams.from_seeds(self._seeds, (len(self._seeds),), low.dtype, low.device)
        evidence = log_likelihood(
            self._family.at(values),
            self._prepared.measurement,
            self._prepared.priors,
            streams,
            block=self._block,
            truncate=self._truncate,
        )
        return torch.where(self._mask, evidence.double(), 0.0).sum(-1)
