"""TensorBoard events of a tracked sequence, one step at a time."""

import json
import math
import os
from collections.abc import Mapping

import numpy as np
from torch import Tensor

from torchdt.app.report.belief import Belief, belief_of
from torchdt.app.report.clouds import Frame, cloud_figure
from torchdt.app.report.events import EventReport
from torchdt.filter.history import StepEstimate
from torchdt.filter.shares import PARTS
from torchdt.metrics import Gospa

LAYOUT = {
    "Quality": {
        "GOSPA and its parts": ["gospa/.*"],
        "Objects, true and declared": ["count/.*"],
    },
    "Objects": {
        "Existence": ["existence/.*"],
        "Transmission": ["transmission/.*"],
        "Power (dB)": ["power_db/.*"],
        "Effective sample size": ["effective_sample_size/.*"],
    },
    "Data": {
        "Noise (dB)": ["noise_db/.*"],
        "Shares of the energy": ["energy/.*"],
        "Log evidence": ["log_evidence$"],
    },
}
EXISTENCE_EDGES = np.linspace(0.0, 1.0, 21)
NEGLIGIBLE = 1e-3
"""Weight of a support point below which it only widens a histogram."""


class TensorBoardReport(EventReport):
    """Writes one tracked sequence into event files, while it is tracked or afterwards.

    The tags of every step: `gospa/total`, `gospa/localisation`, `gospa/missed`, `gospa/false`,
    `count/declared`, `count/true`, `existence/label_03`, `transmission/label_03`,
    `effective_sample_size/label_03`, `power_db/label_03/tone_1`, `noise_db/tone_1`, `energy/objects`,
    `energy/interferers`, `energy/noise`, `energy/unexplained`, `log_evidence`.

    Those of every `interval`-th step: the histograms `belief/existence`, of all potential objects, and
    `belief/power_db/label_03`, of all tones, each of weight one, as uncertain as the tracker is; and the
    image `belief/particles`.

    Powers are in dB relative to one squared unit of the data. Beside the tags there are one row under HPARAMS
    (`add_hparams`), the figures and the configuration, and charts that put together what belongs together.

    Args:
        directory: folder of the event files, made if absent.
        first_step: first step that will be written; what an earlier process wrote from there on is hidden.
        interval: steps from one belief to the next; None shows none.
        frame: in which particles are drawn; None draws none.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        first_step: int = 0,
        interval: int | None = None,
        frame: Frame | None = None,
    ) -> None:
        super().__init__(directory, first_step, LAYOUT)
        self._interval, self._frame = interval, frame

    def add_step(
        self,
        step: int,
        time_s: float,
        state: object,
        estimate: StepEstimate,
        gospa: Gospa | None = None,
        truth: Tensor | None = None,
    ) -> None:
        """Write one step of one sequence; nothing has a batch dimension.

        An object appears under its label, from the step where it has one.

        Args:
            step: its number.
            time_s: its time, s, in the title of the particle clouds.
            state: of the tracker after this step, see `belief_of`.
            estimate: of this step, in units of the data.
            gospa: of this step, or None without truth.
            truth: `(L, d)` true positions, NaN = absent, for the particle clouds; None if unknown.
        """
        if gospa is not None:
            for part in ("total", "localisation", "missed", "false"):
                self.add_scalar(f"gospa/{part}", getattr(gospa, part).item(), step)
            self.add_scalar("count/true", gospa.num_truth.item(), step)
        self.add_scalar("count/declared", estimate.declared.sum().item(), step)
        self.add_scalar("log_evidence", estimate.log_evidence.item(), step)
        self._add_tones("noise_db", estimate.noise, step)
        if bool(estimate.shares.any()):
            for part, share in zip(PARTS, estimate.shares.mean(-2).tolist(), strict=True):
                self.add_scalar(f"energy/{part}", share, step)
        for slot, name in label_names(estimate).items():
            self.add_scalar(f"existence/{name}", estimate.existence[slot].item(), step)
            self.add_scalar(f"transmission/{name}", estimate.transmission[slot].item(), step)
            self.add_scalar(
                f"effective_sample_size/{name}", estimate.effective_sample_size[slot].item(), step
            )
            self._add_tones(f"power_db/{name}", estimate.power[slot], step)
        if self._interval is not None and step % self._interval == 0:
            self._add_belief(step, belief_of(state, estimate), estimate, truth, time_s)

    def add_config(self, config: Mapping[str, object]) -> None:
        """Write the resolved configuration as text under `config`."""
        text = json.dumps(config, indent=2, default=str)
        with self._writer() as writer:
            writer.add_text("config", f"```json\n{text}\n```")

    def _add_belief(
        self, step: int, belief: Belief | None, estimate: StepEstimate, truth: Tensor | None, time_s: float
    ) -> None:
        existence = estimate.existence[estimate.existence > 0].cpu().double().numpy()
        self._add_histogram("belief/existence", existence, np.ones_like(existence), EXISTENCE_EDGES, step)
        if belief is None:
            return
        for slot, name in label_names(estimate).items():
            levels, weight = decibels(belief.power[slot], belief.power_weight[slot])
            self._add_histogram(f"belief/power_db/{name}", levels, weight, whole_edges(levels), step)
        if self._frame is not None:
            figure = cloud_figure(belief, estimate, truth, time_s, self._frame)
            self.add_figure("belief/particles", figure, step)

    def _add_histogram(
        self, tag: str, values: np.ndarray, weight: np.ndarray, edges: np.ndarray, step: int
    ) -> None:
        if not values.size:
            return
        counts, edges = np.histogram(values, edges, weights=weight)
        with self._writer() as writer:
            writer.add_histogram_raw(
                tag,
                min=values.min(),
                max=values.max(),
                num=weight.sum(),
                sum=weight @ values,
                sum_squares=weight @ values**2,
                bucket_limits=edges[1:].tolist(),
                bucket_counts=counts.tolist(),
                global_step=step,
            )

    def _add_tones(self, tag: str, powers: Tensor, step: int) -> None:
        for tone, power in enumerate(powers.tolist(), start=1):
            self.add_scalar(f"{tag}/tone_{tone}", 10 * math.log10(power) if power > 0 else None, step)


def label_names(estimate: StepEstimate) -> dict[int, str]:
    """Names of the labelled objects by their slots.

    Args:
        estimate: of one step of one sequence.
    """
    labels = estimate.label.tolist()
    return {slot: f"label_{label:02d}" for slot, label in enumerate(labels) if label}


def whole_edges(values: np.ndarray) -> np.ndarray:
    """Edges of bins one wide, at whole numbers, that hold all values; none for no values."""
    return np.arange(math.floor(values.min()), math.floor(values.max()) + 2) if values.size else values


def decibels(power: Tensor, weight: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Levels in dB and weights of the support points that count.

    Args:
        power, weight: of one shape, flattened.
    """
    power, weight = power.double().flatten(), weight.double().flatten()
    counts = (weight > NEGLIGIBLE) & (power > 0) & power.isfinite()
    return (10 * power[counts].log10()).numpy(), weight[counts].numpy()
