"""Constant velocity, driven by white acceleration: the motion of Liang and Meyer, Sec. IV."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchdt.model.motion.base import BaseMotion


@dataclass(frozen=True)
class ConstantVelocity(BaseMotion):
    """`x' = F x + W q`: a state of d positions, then d rates.

    Per coordinate `F = [[1, T], [0, 1]]`, `W = [T^2 / 2, T]^T` and `q ~ N(0, driving_variance)`
    (Bar-Shalom, Kirubarajan and Li, Estimation with Applications to Tracking and Navigation, Ch. 6.3).
    """

    def move(self, state: Tensor, driving: Tensor, step_s: float) -> Tensor:
        """New states, see `predict_state`."""
        return predict_state(state, driving, step_s)

    def moments(self, mean: Tensor, covariance: Tensor, step_s: float) -> tuple[Tensor, Tensor]:
        """Exact moments after one step, see `predict_moments`."""
        return predict_moments(mean, covariance, step_s, self.driving_variance.unsqueeze(-2))


def predict_state(state: Tensor, driving: Tensor, step_s: float) -> Tensor:
    """Move particles by the constant-rate model `x' = F x + W q`.

    Per coordinate `F = [[1, T], [0, 1]]`, `W = [T^2 / 2, T]^T` and `q ~ N(0, driving_variance)`
    (Bar-Shalom, Kirubarajan and Li, Estimation with Applications to Tracking and Navigation, Ch. 6.3).

    Args:
        state: `(*batch, 2 d)` positions, then rates.
        driving: `(*batch, d)` driving noise q, unit / s^2.
        step_s: time step T in seconds.

    Returns:
        `(*batch, 2 d)`.
    """
    position, rate = state.chunk(2, dim=-1)
    return torch.cat([position + step_s * rate + 0.5 * step_s**2 * driving, rate + step_s * driving], dim=-1)


def predict_moments(
    mean: Tensor, covariance: Tensor, step_s: float, driving_variance: Tensor
) -> tuple[Tensor, Tensor]:
    """Mean and covariance after one step of the constant-rate model: `F m` and `F C F^T + W Q W^T`.

    Args:
        mean: `(*batch, 2 d)`.
        covariance: `(*batch, 2 d, 2 d)`.
        step_s: time step T in seconds.
        driving_variance: `(*batch, d)` diagonal of Q, (unit / s^2)^2.
    """
    d = mean.shape[-1] // 2
    eye = torch.eye(d, dtype=mean.dtype, device=mean.device)
    F = torch.cat([torch.cat([eye, step_s * eye], 1), torch.cat([torch.zeros_like(eye), eye], 1)], 0)
    W = torch.cat([0.5 * step_s**2 * eye, step_s * eye], 0)
    return mean @ F.mT, F @ covariance @ F.mT + (W * driving_variance[..., None, :]) @ W.mT
