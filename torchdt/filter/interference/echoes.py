"""Leftovers and echoes: what looks like a weak object and sends what stronger ones send.

A response that is not quite right, or a second way to the array, leaves energy that a false object explains
well. But its amplitudes are those of its parents, `sum_p alpha_p s_pj` in every snapshot j, where an object
of its own has others. With the parents' amplitudes at their conditional mean, `s_pj = gamma_p a_p^H Sigma^-1
z_j`, and `alpha_p ~ CN(0, tau^2)` in each tone, echoes are worth, beside nothing,

    `y S^H (I / tau^2 + g S S^H)^-1 S y^H - log|I + tau^2 g S S^H|`,

    y_j = a^H Sigma^-1 z_j,    g = a^H Sigma^-1 a,    S = (s_pj)

nats, which is exact given the amplitudes. As many parents as snapshots explain anything.
"""

import torch
from torch import Tensor
from torch.nn.functional import softplus

from torchdt.core.linalg import cholesky
from torchdt.filter.bp.rank_one import Whitener
from torchdt.filter.interference.signatures import SURPRISE


@torch.no_grad()
def echo_gain(
    whitener: Whitener, response: Tensor, parents: Tensor, power: Tensor, share: float, new: Tensor
) -> Tensor:
    """Nats that echoes of other objects are worth beside no object, price paid, `(*batch,)`, from zero up.

    Args:
        whitener: of all but the object, batch `(*batch,)`.
        response: `(*batch, I, M)` complex, of the object.
        parents: `(*batch, N, I, M)` complex, of those that it could be an echo of.
        power: `(*batch, N, I)` of the parents; zero for none.
        share: tau^2, mean energy of an echo over that of its parent.
        new: `(*batch,)` bool, whether the echo would begin; what has been there may always have been one.

    Raises:
        NumericalError: where the amplitudes are not finite.
    """
    num_sensors, num = response.shape[-1], parents.shape[-3]
    root, spread = whitener.projection.to(torch.complex128).tensor_split([num_sensors], -1)
    own = response.to(root.dtype)[..., None]
    g = (root.mH @ own).abs().square().sum((-2, -1))[..., None, None]  # (*batch, I, 1, 1)
    received = spread.mH @ own  # (*batch, I, R, 1), conjugate of a^H Sigma^-1 B
    amplitude = power.mT[..., None] * (parents.movedim(-3, -2).conj().to(root.dtype) @ spread)
    eye = torch.eye(num, dtype=root.dtype, device=root.device)
    lower = cholesky(eye + share * g * (amplitude @ amplitude.mH), "amplitudes of echoes")
    along = torch.linalg.solve_triangular(lower, amplitude @ received, upper=False)
    log_det = 2 * lower.diagonal(dim1=-2, dim2=-1).real.log().sum(-1)
    gain = share * along.abs().square().sum((-2, -1)) - log_det
    # Nothing at all may be there too: as likely as echoes where there may always have been some.
    surprise = torch.where(new, SURPRISE, 0.0)
    total = torch.where((power > 0).any(-1).any(-1), gain.sum(-1), -torch.inf)
    mixed = torch.logaddexp(total - surprise, torch.zeros_like(total)) - softplus(-surprise)
    return mixed.clamp_min(0).to(power.dtype)
