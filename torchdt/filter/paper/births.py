"""New objects in the cells that matching pursuit picks (Liang and Meyer, Sec. IV)."""

import math

import torch
from torch import Tensor

from torchdt.core.trees import put
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.state import Objects
from torchdt.model.existence import condition_inside
from torchdt.model.measurement import Measurement
from torchdt.model.model import Model
from torchdt.model.region import Region


@torch.no_grad()
def pick_cells(dictionary: Dictionary, measurement: Measurement, number: int) -> Tensor:
    """Cells picked by matching pursuit on the data (Mallat and Zhang, IEEE Trans. Signal Process. 41, 1993).

    A cell stands for one direction in each tone, with an amplitude of its own in every snapshot. Each pick
    is the cell that explains most energy of what is left over all tones and snapshots,
    `sum_i |a_i^H R_i|^2 / |a_i|^2`; its projection is taken off, `R_i <- R_i - a_i a_i^H R_i / |a_i|^2`.
    Known objects are not taken off first, and no cell is picked twice.

    Args:
        dictionary: responses at the centres of the cells.
        measurement: statistics of the step, batch `(*batch,)`.
        number: Q, cells to pick.

    Returns:
        `(*batch, Q)` int64, in order of picking; where Q exceeds the cells in which objects can be born,
        some that are none.
    """
    batch = measurement.num_snapshots.shape[:-1]
    own = dictionary.response.ndim > 3
    residual = measurement.factor.reshape(-1, *measurement.factor.shape[-3:])
    present = measurement.present.reshape(-1, *measurement.present.shape[-2:])
    response, energy = dictionary.response, dictionary.energy.expand(len(residual), -1, -1)
    taken = energy.sum(-2) <= 0  # no object can be born there
    if not bool(present.all()):
        square = response.abs().square()
        energy = torch.einsum("bicm,bim->bic" if own else "icm,bim->bic", square, present.to(square))
    inverse = torch.where(energy > 0, 1 / energy, 0.0)
    row, picks = torch.arange(len(residual), device=residual.device), []
    for _ in range(number):
        # |a^H R| is |a^T conj(R)|: the conjugate of the smaller factor.
        product = torch.einsum("bicm,bimr->bicr" if own else "icm,bimr->bicr", response, residual.conj())
        explained = (product.abs().square().sum(-1) * inverse).sum(-2).masked_fill(taken, -torch.inf)
        cell = explained.argmax(-1)
        atom = response[row, :, cell] if own else response[:, cell].transpose(0, 1)
        amplitude = product[row, :, cell].conj() * inverse[row, :, cell][..., None]
        residual = residual - (atom * present)[..., None] * amplitude[..., None, :]
        taken = put(taken, cell, torch.ones_like(cell, dtype=torch.bool))
        picks.append(cell)
    return torch.stack(picks, -1).reshape(*batch, number)


def newborn(
    points: Tensor,
    region: Region,
    model: Model,
    power_max: Tensor,
    along: Tensor,
    extra: Tensor,
    share: Tensor,
) -> Objects:
    """New objects of one cell each: `f(x, gamma) = f_B,n(x) f_B(gamma)`, all of them uniform.

    They exist with `p_B = mu / (mu + 1)`, `mu = mu_B / Q`, where births are uniform.

    Args:
        points: `(*batch, N, d)` centres of the cells.
        region: gives the size of the cells and their number Q.
        model: has the odds of a birth, and what states hold beside the position.
        power_max: `(*batch, I)` upper limit of the powers.
        along: `(*batch, N, P, d)` uniform draws, of positions.
        extra: `(*batch, N, P, num_extra)` standard normal draws, of what states hold beside them.
        share: `(*batch, N, I, G)` uniform draws, of the powers.
    """
    position = points.unsqueeze(-2) + (along - 0.5) * region.cell
    state = model.motion.newborn(region, position, extra)
    num_particles, num_powers = state.shape[-2], share.shape[-1]
    even = torch.full_like(state[..., 0], -math.log(num_particles))
    log_weight, _ = condition_inside(state, even, region)
    # Draws on [0, 1) may be zero: a power of nothing is no object.
    power = power_max[..., None, :, None] * (1 - share)
    log_odds = model.birth.log_odds(region, points)
    return Objects(
        state=state,
        log_weight=log_weight,
        power=power,
        log_power_weight=torch.full_like(power, -math.log(num_powers)),
        log_odds=torch.where(region.contains(state).any(-1), log_odds, -torch.inf),
        label=torch.zeros_like(log_odds, dtype=torch.int64),
        transmits=torch.ones_like(log_weight),
    )
