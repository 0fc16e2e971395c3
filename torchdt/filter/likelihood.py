"""The marginal likelihood of whole sequences, differentiable in the tracker's parameters and field."""

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torchdt.core.errors import require
from torchdt.core.linalg import BREAKDOWN, NumericalError
from torchdt.core.random import RandomStreams
from torchdt.core.trees import tree_map
from torchdt.filter.direct import DirectTracker
from torchdt.filter.state import TrackerState
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors


def log_likelihood(
    tracker: DirectTracker,
    measurement: Measurement,
    priors: Priors,
    streams: RandomStreams,
    *,
    block: int | None = None,
    truncate: int | None = None,
) -> Tensor:
    """Evidence of every step, `log p(z_k | z_1..k-1)`; its sum over the steps is the log-likelihood.

    Gradients reach the numbers of `tracker.model` and what the field is made of. What they cost in memory is
    set by `block`: only the state between blocks is kept, and each block runs again when its gradient is
    taken (Chen et al., "Training deep nets with sublinear memory cost", 2016). About the square root of the
    number of steps needs least.

    Args:
        tracker: the tracker.
        measurement: statistics of batch `(*batch, K)`.
        priors: limits of the priors, batch `(*batch,)`.
        streams: random numbers of batch `(*batch,)`; the same ones make two evaluations comparable.
        block: steps per block; None keeps everything.
        truncate: steps after which the gradient through the state is cut (truncated back-propagation, biased:
            what a step owes to earlier segments is lost, the noise transition into it included); None never
            cuts. Blocks end at cuts too.

    Returns:
        `(*batch, K)` natural logarithm, in squared units of the data that `measurement` holds.

    Raises:
        InputError: where `block` or `truncate` is not a positive integer.
        NumericalError: where the filter broke down, naming the step and the place in the batch.
    """
    for name, value in (("block", block), ("truncate", truncate)):
        require(value is None or value >= 1, name, value, "a positive integer or None")
    num_steps = measurement.num_snapshots.shape[priors.noise_max.ndim - 1]
    keep = not torch.is_grad_enabled() or block is None
    state, parts, start = tracker.init(priors), [], 0
    while start < num_steps:
        end = min(start + (block or num_steps), num_steps)
        if truncate is not None:
            end = min(end, (start // truncate + 1) * truncate)
            state = _cut(state) if start and start % truncate == 0 else state
        segment = _Segment(tracker, measurement, priors, streams, range(start, end))
        if keep:
            state, evidence = segment(state)
        else:
            state, evidence = checkpoint(segment, state, use_reentrant=False, preserve_rng_state=False)
        streams.skip_to(segment.ended)
        parts.append(evidence)
        start = end
    return torch.cat(parts, -1)


class _Segment:
    """Some steps in a row, which may run more than once with the same random numbers."""

    def __init__(
        self,
        tracker: DirectTracker,
        measurement: Measurement,
        priors: Priors,
        streams: RandomStreams,
        steps: range,
    ):
        self.tracker, self.measurement, self.priors, self.steps = tracker, measurement, priors, steps
        self.streams, self.began = streams, streams.snapshot()
        self.ended = self.began

    def __call__(self, state: TrackerState) -> tuple[TrackerState, Tensor]:
        streams, parts = self.streams.at(self.began), []
        for k in self.steps:
            try:
                state, estimate = self.tracker.step(state, self.measurement.at(k), self.priors, streams)
            except BREAKDOWN as error:
                raise NumericalError(f"step {k}: {error}") from error
            parts.append(estimate.log_evidence)
        self.ended = streams.snapshot()
        return state, torch.stack(parts, -1)


def _cut(state: TrackerState) -> TrackerState:
    return tree_map(Tensor.detach, state)
