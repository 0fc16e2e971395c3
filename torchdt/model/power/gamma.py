"""Powers as Gamma Markov chains, f(gamma | gamma') of Liang and Meyer, Sec. IV."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torchdt.model.gamma_chain import SHAPE, log_walk, predict_chain, uniform_prior, uniform_prior_around
from torchdt.model.part import Number, Part, append_dims, number
from torchdt.model.power.base import Switch


@dataclass(frozen=True)
class GammaPower(Part):
    """Each tone's power is uniform up to a limit when an object is born, and a Gamma chain from then on.

    Attributes:
        power_shape: c_gamma, shape of the Gamma transition, at least 1.
    """

    KEY: ClassVar[str] = "model.power"

    power_shape: Number = number(1e4, SHAPE)

    @property
    def switch(self) -> Switch | None:
        """Objects transmit in every step."""
        return None

    def initial(self, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The uniform prior, see `uniform_prior`."""
        return uniform_prior(maximum, num_points)

    def newborn(self, scale: Tensor, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The uniform prior where a likelihood lies, see `uniform_prior_around`."""
        return uniform_prior_around(scale, maximum, num_points)

    def predict(self, power: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
        """One Gamma transition, see `predict_chain`."""
        return predict_chain(
            power, log_weight, append_dims(self.power_shape, power.ndim - 1 - self.power_shape.ndim)
        )

    def level_transition(self, level: Tensor) -> Tensor:
        """A random walk of the logarithm with the variance of the chain's, see `log_walk`."""
        return log_walk(level, self.power_shape)
