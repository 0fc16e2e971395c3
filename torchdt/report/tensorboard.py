"""What a run shows in TensorBoard."""

import json
import math
import os
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from matplotlib.figure import Figure
from torch.utils.tensorboard import SummaryWriter

from torchdt.history import TrackHistory
from torchdt.metrics import Gospa


class TensorBoardReport:
    """Writes one run into event files; use it as a context manager, or call `close`.

    The tags: `gospa/total`, `gospa/localisation`, `gospa/missed`, `gospa/false`, `count/declared`,
    `count/true`, `existence/label_03`, `effective_sample_size/label_03`, `power_db/label_03/tone_1`,
    `noise_db/tone_1`, `log_evidence`. Powers are in dB relative to one squared unit of the data. Numbers that
    are not finite are left out, as they would hide the scale of the rest.

    Args:
        directory: folder of the event files, made if absent.
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self._writer = SummaryWriter(os.fspath(directory))

    def add_history(self, history: TrackHistory, gospa: Gospa | None = None, first_step: int = 0) -> None:
        """Write the steps of one run: of a batch, `history.select(0)`.

        A slot appears under its label, from the step where it has one. Call once with all steps, or with a
        few at a time to follow a run.

        Args:
            history: no batch dimension; fields are `(K, ...)`.
            gospa: `(K,)`, or None without truth.
            first_step: number of the first of these steps.
        """
        for k in range(history.existence.shape[0]):
            step = first_step + k
            if gospa is not None:
                for part in ("total", "localisation", "missed", "false"):
                    self._add(f"gospa/{part}", getattr(gospa, part)[k].item(), step)
                self._add("count/true", gospa.num_truth[k].item(), step)
            self._add("count/declared", history.declared[k].sum().item(), step)
            self._add("log_evidence", history.log_evidence[k].item(), step)
            self._add_tones("noise_db", history.noise[k].tolist(), step)
            for slot in history.label[k].nonzero().flatten().tolist():
                label = f"label_{history.label[k, slot].item():02d}"
                self._add(f"existence/{label}", history.existence[k, slot].item(), step)
                size = history.effective_sample_size[k, slot].item()
                self._add(f"effective_sample_size/{label}", size, step)
                self._add_tones(f"power_db/{label}", history.power[k, slot].tolist(), step)

    def add_figure(self, tag: str, figure: Figure, step: int = 0) -> None:
        """Write a figure as an image under `tag`."""
        self._writer.add_figure(tag, figure, step, close=False)

    def add_config(self, config: Mapping[str, object]) -> None:
        """Write the resolved configuration as text under `config`."""
        text = json.dumps(config, indent=2, default=str)
        self._writer.add_text("config", f"```json\n{text}\n```")

    def close(self) -> None:
        """Write what is pending and close the files; more than once does no harm."""
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add(self, tag: str, value: float, step: int) -> None:
        if math.isfinite(value):
            self._writer.add_scalar(tag, value, step)

    def _add_tones(self, tag: str, powers: list[float], step: int) -> None:
        for tone, power in enumerate(powers, start=1):
            self._add(f"{tag}/tone_{tone}", 10 * math.log10(power) if power > 0 else -math.inf, step)
