"""Driving noise of particles, with either of two gradients in the transition's parameters.

`reparameterised`: the particles move with the parameters. `score`: they stand still, and the ratio
`p(x' | x; theta) / p(x' | x; theta_0)` at `theta = theta_0` enters their weights: its value is one, its
gradient the score of the transition. Either makes the score of a particle filter consistent, if the
weights also keep their gradient through resampling (Scibior and Wood, "Differentiable particle filtering
without modifying the forward pass", 2021). The sharper the likelihood, the more the moving particles make
the gradient vary; under a blunt one it is the other way round.
"""

import torch
from torch import Tensor

from torchdt.core.errors import require

GRADIENTS = ("score", "reparameterised")


def drive(draws: Tensor, variance: Tensor, gradient: str) -> tuple[Tensor, Tensor]:
    """Driving noise `q ~ N(0, diag(variance))` of every particle.

    Args:
        draws: `(*batch, P, d)` standard normal.
        variance: `(*batch, d)` or broadcastable to it, positive; all particles share it.
        gradient: one of `GRADIENTS`.

    Returns:
        q `(*batch, P, d)`, and the log transition ratio `(*batch, P)` to be added to the log-weights. The
        ratio is zero; for `score` it carries the gradient in the variance, which q then does not.

    Raises:
        InputError: where the gradient is not one of the two.
    """
    require(gradient in GRADIENTS, "gradient", gradient, " or ".join(GRADIENTS))
    shared = variance.unsqueeze(-2)
    noise = draws * shared.sqrt()
    if gradient == "reparameterised":
        return noise, torch.zeros_like(noise[..., 0])
    noise = noise.detach()
    # Without the constant of the normal density: it cancels.
    log_density = -0.5 * (noise.square() / shared + shared.log()).sum(-1)
    return noise, log_density - log_density.detach()
