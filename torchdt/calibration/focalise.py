"""Environment and source positions together, by maximum likelihood ("focalization").

Each step and tone is explained as well as the responses of its sources allow, amplitudes free. With the
noise variance profiled out the log-likelihood of J snapshots on M sensors with N sources is
`-J (M - N) log rho`, where rho is the share of the energy that is left over. What is no source, as a ship
outside the region, must not bend the environment: one signal of free spatial signature may take its part of
what is left over, at its price (`torchdt.filter.interference.signatures`). Sources share one environment
over all steps and tones; that is what tells a wrong environment from a wrong position (Collins and Kuperman,
J. Acoust. Soc. Am. 90, 1991).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.field.base import Field
from torchdt.filter.interference.signatures import price
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
        log_posterior: scalar, the better `explanations` summed over steps and tones, plus log prior of theta.
        leftover: `(S, I)` share rho of the energy left unexplained.
    """

    theta: Tensor
    position: Tensor
    log_posterior: Tensor
    leftover: Tensor


def leftover(response: Tensor, active: Tensor, measurement: Measurement) -> tuple[Tensor, Tensor]:
    """Share of the energy outside the span of the responses, without and with one more signal of any kind.

    Args:
        response: `(S, N, I, M)` complex.
        active: `(S, N)` bool; other responses are left out.
        measurement: statistics of batch `(S,)`.

    Returns:
        Two `(S, I)` real in (0, 1]; 1 for tones without data.
    """
    columns = (response * active[..., None, None] * measurement.present.unsqueeze(-3)).permute(0, 2, 3, 1)
    ridge = 1e-6 * torch.eye(columns.shape[-1], dtype=columns.dtype, device=columns.device)
    lower = cholesky(columns.mH @ columns + ridge, "Gram matrix of the source responses")
    explained = torch.linalg.solve_triangular(lower, columns.mH @ measurement.factor, upper=False)
    total = measurement.factor.mH @ measurement.factor
    energy = total.diagonal(dim1=-2, dim2=-1).real.sum(-1).clamp_min(torch.finfo(columns.real.dtype).tiny)
    level = torch.linalg.eigvalsh((total - explained.mH @ explained) / energy[..., None, None])
    heard = measurement.num_snapshots > 0
    beside = torch.where(heard, level[..., :-1].sum(-1), 1.0)
    share = torch.where(heard, level.sum(-1), 1.0)
    return share.clamp_min(1e-9), beside.clamp_min(1e-9)


def explanations(
    share: Tensor, beside: Tensor, active: Tensor, measurement: Measurement, floor: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Log-likelihoods of steps and tones without and with a signal of free signature, its price paid.

    Args:
        share, beside: see `leftover`.
        active: `(S, N)` bool, sources.
        measurement: statistics of batch `(S,)`.
        floor: added to the shares.

    Returns:
        Two `(S, I)` nats, up to a constant.
    """
    J, sensors = measurement.num_snapshots, measurement.present.sum(-1)
    # Every source's free amplitude takes one dimension from the residual.
    residual = (sensors - active.sum(-1, keepdim=True)).clamp_min(1.0)
    plain = -J * residual * torch.log(share + floor)
    variance = measurement.energy * (beside + floor) / sensors.clamp_min(1.0)
    free = -J * (residual - 1).clamp_min(1.0) * torch.log(beside + floor) - price(measurement, variance)
    return plain, torch.where(J > 0, free, plain)


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
    """Fit environment and positions by L-BFGS from a start, and end no worse than there.

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
    start = theta[free] / prior_std[free]
    scale = (measurement.num_snapshots * measurement.present.sum(-1)).sum().clamp_min(1.0)

    def evaluate(own: Tensor, shift: Tensor, floor: float) -> tuple[Tensor, Focus]:
        value = theta.masked_scatter(free, own * prior_std[free]) if len(own) else theta
        place = position + shift * position_scale
        share, beside = leftover(fields(value)(place), active, measurement)
        of_data = torch.maximum(*explanations(share, beside, active, measurement, floor)).sum()
        log_posterior = of_data - 0.5 * (value / prior_std).square().sum()
        return log_posterior, Focus(value, place, log_posterior, share)

    def descend(floors: Sequence[float]) -> Focus:
        own, shift = start.clone().requires_grad_(), torch.zeros_like(position).requires_grad_()
        variables = [own, shift] if len(own) else [shift]
        for floor in floors:
            solver = torch.optim.LBFGS(
                variables,
                max_iter=iterations,
                history_size=30,
                line_search_fn="strong_wolfe",
                tolerance_change=TOLERANCE,
            )

            def objective(floor: float = floor, solver: torch.optim.Optimizer = solver) -> Tensor:
                solver.zero_grad()
                loss = -evaluate(own, shift, floor)[0] * (len(position) / scale)
                torch.autograd.backward(loss, inputs=variables)
                return loss.detach()

            solver.step(objective)
        with torch.no_grad():
            return evaluate(own, shift, 0.0)[1]

    with torch.no_grad():
        before, _ = evaluate(start, torch.zeros_like(position), 0.0)
    found = descend(FLOORS)
    # What is explained coarsely may lie farther off than the start.
    return found if found.log_posterior >= before else descend(FLOORS[-1:])
