"""Driving noise of particles, and how particles depend on the parameters of the density they are drawn from.

`Reparameterised`: the particles move with the parameters. `Score`: they stand still, and the ratio
`p(x' | x; theta) / p(x' | x; theta_0)` at `theta = theta_0` enters their weights: its value is one, its
gradient the score of the transition. Either makes the score of a particle filter consistent, if the
weights also keep their gradient through resampling (Scibior and Wood, "Differentiable particle filtering
without modifying the forward pass", 2021). The sharper the likelihood, the more the moving particles make
the gradient vary; under a blunt one it is the other way round.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor


@runtime_checkable
class Gradient(Protocol):
    """How particles depend on the parameters of their density."""

    def attach(
        self,
        still: Tensor,
        moving: Tensor,
        log_density: Callable[[Tensor], Tensor],
        log_drawn: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Give drawn particles their gradient.

        Args:
            still: `(*batch, P, d)` the particles, without gradient.
            moving: the same as a function of the parameters.
            log_density: maps particles to `(*batch, P)`.
            log_drawn: `(*batch, P)` log-density that they were drawn with; None is that of the parameters as
                they are.

        Returns:
            Particles, and a log-ratio `(*batch, P)` for their log-weights: of the density as it is to that
            which they were drawn with, or zero where they move.
        """
        ...


@dataclass(frozen=True)
class Score:
    """Particles stay, weights move with the parameters."""

    def attach(
        self,
        still: Tensor,
        moving: Tensor,
        log_density: Callable[[Tensor], Tensor],
        log_drawn: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """See `Gradient.attach`."""
        log_now = log_density(still)
        return still, log_now - (log_now.detach() if log_drawn is None else log_drawn)


@dataclass(frozen=True)
class Reparameterised:
    """Particles move with the parameters."""

    def attach(
        self,
        still: Tensor,
        moving: Tensor,
        log_density: Callable[[Tensor], Tensor],
        log_drawn: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """See `Gradient.attach`."""
        return moving, torch.zeros_like(moving[..., 0])


def drive(draws: Tensor, variance: Tensor, gradient: Gradient) -> tuple[Tensor, Tensor]:
    """Driving noise `q ~ N(0, diag(variance))` of every particle.

    Args:
        draws: `(*batch, P, d)` standard normal.
        variance: `(*batch, d)` or broadcastable to it, positive; all particles share it.
        gradient: in the variance.

    Returns:
        q `(*batch, P, d)`, and the log transition ratio `(*batch, P)` to be added to the log-weights.
    """
    shared = variance.unsqueeze(-2)
    noise = draws * shared.sqrt()

    def log_density(noise: Tensor) -> Tensor:
        """Without the constant of the normal density: it cancels."""
        return -0.5 * (noise.square() / shared + shared.log()).sum(-1)

    return gradient.attach(noise.detach(), noise, log_density)
