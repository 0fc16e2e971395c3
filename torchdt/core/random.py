"""Random numbers from one explicit generator per sequence."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Generator, Tensor


class RandomStreams:
    """One `torch.Generator` per sequence of a batch.

    A sequence draws the same numbers alone and inside any batch, because every draw is made sequence
    by sequence. Draws therefore must not depend on the other sequences of the batch.

    Args:
        generators: one generator for each of the `prod(batch_shape)` sequences, in row-major order.
        batch_shape: leading dimensions of every draw.
        dtype: real type of the draws.

    Raises:
        ValueError: where the number of generators does not fit the batch shape.
    """

    def __init__(self, generators: Sequence[Generator], batch_shape: Sequence[int], dtype: torch.dtype):
        if len(generators) != math.prod(batch_shape):
            raise ValueError(
                f"generators: found {len(generators)}, expected {math.prod(batch_shape)}, one a sequence"
            )
        self.generators = list(generators)
        self.batch_shape = tuple(batch_shape)
        self.dtype = dtype

    @classmethod
    def from_seeds(
        cls,
        seeds: Sequence[int],
        batch_shape: Sequence[int],
        dtype: torch.dtype,
        device: torch.device | str = "cpu",
    ) -> "RandomStreams":
        """Start one generator per seed."""
        generators = [Generator(device=device).manual_seed(int(seed)) for seed in seeds]
        return cls(generators, batch_shape, dtype)

    def snapshot(self) -> list[Tensor]:
        """States of the generators, for `at`."""
        return [g.get_state() for g in self.generators]

    def at(self, snapshot: Sequence[Tensor]) -> "RandomStreams":
        """Streams of their own that go on from a snapshot of these."""
        generators = [Generator(device=g.device) for g in self.generators]
        for generator, state in zip(generators, snapshot, strict=True):
            generator.set_state(state)
        return RandomStreams(generators, self.batch_shape, self.dtype)

    def skip_to(self, snapshot: Sequence[Tensor]) -> None:
        """Go on from a snapshot of these streams or of a copy made by `at`."""
        for generator, state in zip(self.generators, snapshot, strict=True):
            generator.set_state(state)

    def normal(self, *shape: int) -> Tensor:
        """Standard normal draws, `(*batch, *shape)`."""
        return self._draw(torch.randn, shape)

    def uniform(self, *shape: int) -> Tensor:
        """Uniform draws on [0, 1), `(*batch, *shape)`."""
        return self._draw(torch.rand, shape)

    def gamma(self, concentration: Tensor, *shape: int) -> Tensor:
        """Gamma draws of unit scale, `(*batch, *shape)`.

        Args:
            concentration: the shape parameter, `()` or `(*batch,)`.
            shape: of the draws of each sequence.
        """
        each = concentration.to(self.dtype).expand(self.batch_shape).reshape(-1)
        draws = [
            torch._standard_gamma(c.to(g.device).expand(shape), generator=g)  # as torch.distributions does
            for c, g in zip(each, self.generators, strict=True)
        ]
        return torch.stack(draws).reshape(*self.batch_shape, *shape)

    def _draw(self, draw: Callable[..., Tensor], shape: Sequence[int]) -> Tensor:
        draws = [draw(shape, generator=g, dtype=self.dtype, device=g.device) for g in self.generators]
        return torch.stack(draws).reshape(*self.batch_shape, *shape)
