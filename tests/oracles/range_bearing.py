"""A sensor that measures distance and direction, as a likelihood of points."""

import math

import torch
from torch import Tensor
from torch.distributions import Normal

from torchdt.model.region import Region


class RangeBearing:
    """Distance and direction of an object from a sensor outside the region, below its middle.

    False points are uniform in distance from 0 to 1500 m and in direction over the half-circle.
    """

    def __init__(self, region: Region):
        self.region = region
        self.sensor = torch.tensor([500.0, -300.0], dtype=torch.float64)
        self.spread = torch.tensor([8.0, 0.01], dtype=torch.float64)  # m, rad

    def measure(self, state: Tensor) -> Tensor:
        offset = state[..., :2] - self.sensor
        return torch.stack([offset.norm(dim=-1), torch.atan2(offset[..., 1], offset[..., 0])], -1)

    def log_likelihood(self, point: Tensor, state: Tensor) -> Tensor:
        expected = self.measure(state).unsqueeze(-3)
        return Normal(expected, self.spread).log_prob(point[..., None, :, None, :]).sum(-1)

    def log_clutter(self, point: Tensor) -> Tensor:
        return torch.full_like(point[..., 0], -math.log(1500 * math.pi))

    def propose(self, point: Tensor, draws: Tensor) -> tuple[Tensor, Tensor]:
        distance, bearing = (point.unsqueeze(-2) + self.spread * draws[..., :2]).unbind(-1)
        direction = torch.stack([bearing.cos(), bearing.sin()], -1)
        position = self.sensor + distance.unsqueeze(-1) * direction
        region = self.region
        rate = torch.lerp(region.rate_low, region.rate_high, torch.special.ndtr(draws[..., 2:]))
        # f / q is the distance: a density in the plane is that in distance and direction over the distance.
        log_weight = distance.abs().log() - math.log(1000 * 500)
        return torch.cat([position, rate], -1), torch.where(region.contains(position), log_weight, -torch.inf)
