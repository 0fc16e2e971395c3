"""Settings of hyperparameter tuning, checked once when they are made."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Count, OneOf, Positive, PositiveShare, Range, Seed, Steps

METHODS = ("gradient", "tpe", "grid")
Step = Annotated[float, Range("a positive number", low=0, open_low=True, least=1e-12, most=100)]
"""Of logarithms and log-odds, which are exponents."""


@dataclass
class TuningConfig(Checked):
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

    KEY: ClassVar[str] = "tuning"

    method: Annotated[str, OneOf(METHODS)] = "gradient"
    steps: Count = 60
    learning_rate: Step = 0.3
    decay: PositiveShare = 0.1
    clip: Positive = 1.0
    heldout_every: Count = 5
    patience: Count = 4
    budget_passes: Count | None = None
    width: Step = 2.0
    seed: Seed = 0
    block: Steps | None = 8
    truncate: Steps | None = None
    checkpoint_every: Count = 1
    gospa_every: Count = 20
    slice_points: Annotated[int, Range("a number of points from 0 up", low=0, most=1e4, whole=True)] = 9

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self.method == "gradient" or self.budget_passes is not None
        expected = f"a number of passes for {self.method}"
        require(given, f"{self.KEY}.budget_passes", self.budget_passes, expected)
