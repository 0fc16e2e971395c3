"""Settings of hyperparameter tuning, checked once when they are made."""

import math
from dataclasses import dataclass

from torchdt.errors import require

METHODS = ("gradient", "tpe", "grid")


@dataclass
class TuningConfig:
    """How the likelihood is climbed.

    A pass is one run of the filter over all sequences of a set; a gradient costs three (its backward pass
    counts two), a value one.

    Attributes:
        method: `gradient` (Adam), `tpe` (tree-structured Parzen estimator) or `grid`.
        steps: gradient steps, at most.
        learning_rate: of Adam at the first step, in unconstrained units.
        decay: learning rate at the last step over that at the first; it falls geometrically.
        clip: largest norm of the gradient of the log-likelihood per step.
        heldout_every: gradient steps from one held-out evaluation to the next.
        patience: held-out evaluations in a row without improvement after which the ascent ends.
        budget_passes: no step is begun that could take more passes than this; None leaves the end to `steps`
            and `patience`. `tpe` and `grid` need it.
        width: half the side of the box that `tpe` and `grid` search, around the start, and of the likelihood
            slices, around the best values; unconstrained units.
        seed: of the proposals of `tpe`.
        block: time steps per block of gradient checkpointing; None keeps all of them in memory.
        truncate: time steps after which the gradient through the state is cut; None never cuts it.
        checkpoint_every: steps from one checkpoint to the next.
        gospa_every: steps from one tracking of the held-out set with the best values to the next.
        slice_points: points of each likelihood slice; 0 draws none.
    """

    method: str = "gradient"
    steps: int = 60
    learning_rate: float = 0.3
    decay: float = 0.1
    clip: float = 1.0
    heldout_every: int = 5
    patience: int = 4
    budget_passes: int | None = None
    width: float = 2.0
    seed: int = 0
    block: int | None = None
    truncate: int | None = None
    checkpoint_every: int = 1
    gospa_every: int = 20
    slice_points: int = 9

    def __post_init__(self) -> None:
        self._require("method", self.method in METHODS, " or ".join(METHODS))
        for name in ("steps", "heldout_every", "patience", "checkpoint_every", "gospa_every"):
            self._require(name, getattr(self, name) >= 1, "a positive integer")
        for name in ("budget_passes", "block", "truncate"):
            value = getattr(self, name)
            self._require(name, value is None or value >= 1, "a positive integer or null")
        for name in ("learning_rate", "clip", "width"):
            self._require(name, 0 < getattr(self, name) < math.inf, "a positive number")
        self._require("decay", 0 < self.decay <= 1, "a number above 0, up to 1")
        self._require("slice_points", self.slice_points >= 0, "a number of points from 0 up")
        given = self.method == "gradient" or self.budget_passes is not None
        self._require("budget_passes", given, f"a number of passes for {self.method}")

    def _require(self, name: str, holds: bool, expected: str) -> None:
        require(holds, f"tuning.{name}", getattr(self, name), expected)
