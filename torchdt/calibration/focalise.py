"""Environment and source positions together, by maximum likelihood ("focalization").

Each step and tone is explained as well as the responses of its sources allow, amplitudes free. With the
noise variance profiled out the log-likelihood of J snapshots on M sensors with N sources is
`-J (M - N) log rho`, where rho is the share of the energy that is left over. Sources share one environment
over all steps and tones; that is what tells a wrong environment from a wrong position (Collins and Kuperman,
J. Acoust. Soc. Am. 90, 1991).
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.field.base import Field
from torchdt.model.measurement import Measurement

FLOORS = (0.3, 0.1, 0.03, 0.0)
"""Added to the leftover share in turn: first what can be explained coarsely, then every detail."""


TOLERANCE = 1e-5
"""Change of the objective, nats over effective values and times steps, at which a fit ends."""


class Focus(NamedTuple):
    """Result of a fit.

    Attributes:
        theta: `(T,)` float64 environment.
        position: `(S, N, d)` float64 source positions.
        log_posterior: scalar, `-J (M - N) log rho` summed over steps and tones, plus the log prior of theta.
        leftover: `(S, I)` share rho of the energy left unexplained.
    """

    theta: Tensor
    position: Tensor
    log_posterior: Tensor
    leftover: Tensor


def leftover_share(response: Tensor, active: Tensor, measurement: Measurement) -> Tensor:
    """Share of the energy outside the span of the responses.

    Args:
        response: `(S, N, I, M)` complex.
        active: `(S, N)` bool; other responses are left out.
        measurement: statistics of batch `(S,)`.

    Returns:
        `(S, I)` real in (0, 1]; 1 for tones without data.
    """
    columns = (response * active[..., None, None] * measurement.present.unsqueeze(-3)).permute(0, 2, 3, 1)
    ridge = 1e-6 * torch.eye(columns.shape[-1], dtype=columns.dtype, device=columns.device)
    lower = cholesky(columns.mH @ columns + ridge, "Gram matrix of the source responses")
    explained = torch.linalg.solve_triangular(lower, columns.mH @ measurement.factor, upper=False)
    energy = measurement.factor.abs().square().sum((-2, -1))
    share = explained.abs().square().sum((-2, -1)) / energy.clamp_min(torch.finfo(energy.dtype).tiny)
    return (1 - share).clamp_min(1e-9)


def focalise(
    fields: Callable[[Tensor], Field],
    prior_std: Tensor,
    theta: Tensor,
    position: Tensor,
    active: Tensor,
    measurement: Measurement,
    position_scale: Tensor,
    free: Tensor,
    *,
    iterations: int = 60,
) -> Focus:
    """Fit environment and positions by L-BFGS from a start.

    Args:
        fields: from theta to a field in float64.
        prior_std: `(T,)` of theta, whose prior is normal with mean zero.
        theta: `(T,)` start.
        position: `(S, N, d)` start, in S steps.
        active: `(S, N)` bool, which sources there are.
        measurement: statistics of batch `(S,)`, complex128.
        position_scale: `(d,)` typical size of position errors.
        free: `(T,)` bool, which of theta to fit beside the positions.
        iterations: at most, for each floor.
    """
    # Every source's free amplitude takes one dimension from the residual.
    residual = (measurement.present.sum(-1) - active.sum(-1, keepdim=True)).clamp_min(1.0)
    weight = measurement.num_snapshots * residual
    own = (theta[free] / prior_std[free]).clone().requires_grad_()
    shift = torch.zeros_like(position).requires_grad_()
    variables = [own, shift] if bool(free.any()) else [shift]

    def evaluate(floor: float) -> tuple[Tensor, Tensor, Tensor]:
        value = theta.masked_scatter(free, own * prior_std[free]) if len(variables) > 1 else theta
        response = fields(value)(position + shift * position_scale)
        share = leftover_share(response, active, measurement)
        log_likelihood = -(weight * torch.log(share + floor)).sum()
        return log_likelihood - 0.5 * (value / prior_std).square().sum(), share, value

    scale = weight.sum().clamp_min(1.0)
    for floor in FLOORS:
        solver = torch.optim.LBFGS(
            variables,
            max_iter=iterations,
            history_size=30,
            line_search_fn="strong_wolfe",
            tolerance_change=TOLERANCE,
        )

        def objective(floor: float = floor, solver: torch.optim.Optimizer = solver) -> Tensor:
            solver.zero_grad()
            loss = -evaluate(floor)[0] * (len(position) / scale)
            torch.autograd.backward(loss, inputs=variables)
            return loss.detach()

        solver.step(objective)
    with torch.no_grad():
        log_posterior, share, value = evaluate(0.0)
        return Focus(value, position + shift.detach() * position_scale, log_posterior, share)
