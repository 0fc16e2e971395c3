"""A place for what is no object: signals of free spatial signature, or none."""

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor
from torch.nn.functional import softplus

from torchdt.core.ranges import Checked, Count, Positive
from torchdt.filter.interference.interfered import Interfered
from torchdt.filter.interference.signatures import Interferers, follow, free_gains, price
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseCovariance


@runtime_checkable
class Interference(Protocol):
    """What else than objects and noise may be heard.

    Attributes:
        signatures: K, number of signals in a tone, at most; zero where there is no such thing.
    """

    @property
    def signatures(self) -> int:
        """See the class."""
        ...

    def follow(
        self,
        measurement: Measurement,
        noise_model: NoiseCovariance,
        noise: Noise,
        signal: Tensor,
        before: Tensor,
        *,
        new: bool,
    ) -> Interferers:
        """The interferers of a step.

        Args:
            measurement: statistics of the step.
            noise_model: what the noise makes of the covariance of the data, without interferers.
            noise: belief about its level before the data.
            signal: `(*batch, I, M, M)` covariance of what objects send.
            before: `(*batch, I, M, K)` columns of those of the last step.
            new: whether new ones may begin.
        """
        ...

    def rival(self, measurement: Measurement, covariance: Tensor, variance: Tensor) -> Tensor:
        """Nats that more interferers are worth beside a covariance, price paid, `(*batch,)`, from zero up."""
        ...


@dataclass(frozen=True)
class NoInterference:
    """Nothing: all that is heard is objects and noise, as in Liang and Meyer."""

    signatures: ClassVar[int] = 0

    def follow(
        self,
        measurement: Measurement,
        noise_model: NoiseCovariance,
        noise: Noise,
        signal: Tensor,
        before: Tensor,
        *,
        new: bool,
    ) -> Interferers:
        """None."""
        return Interferers(before, torch.zeros_like(measurement.num_snapshots))

    def rival(self, measurement: Measurement, covariance: Tensor, variance: Tensor) -> Tensor:
        """Nothing."""
        return torch.zeros_like(variance[..., 0])


@dataclass(frozen=True)
class FreeSignatures(Checked):
    """Signals of any spatial vector, each tone of its own, see `torchdt.filter.interference.signatures`.

    Attributes:
        signatures: K, number in a tone, at most.
        memory: steps of data that the signature of the last step counts as.
    """

    KEY: ClassVar[str] = "tracker.interference"

    signatures: Count = 3
    memory: Positive = 2.0

    @torch.no_grad()
    def follow(
        self,
        measurement: Measurement,
        noise_model: NoiseCovariance,
        noise: Noise,
        signal: Tensor,
        before: Tensor,
        *,
        new: bool,
    ) -> Interferers:
        """See `torchdt.filter.interference.signatures.follow`."""
        if not new and not bool((before != 0).any()):
            return Interferers(before, torch.zeros_like(measurement.num_snapshots))
        return follow(measurement, noise_model, noise, signal, before, self.memory, new)

    @torch.no_grad()
    def rival(self, measurement: Measurement, covariance: Tensor, variance: Tensor) -> Tensor:
        """`sum_ik log(1 + exp(gain_ik - price_i))`, see `free_gains` and `price`."""
        gain = free_gains(measurement, covariance, self.signatures)
        return softplus(gain - price(measurement, variance)[..., None]).sum((-2, -1))


def beside(noise: NoiseCovariance, interferers: Interferers | None) -> NoiseCovariance:
    """The noise with interferers, where there are any."""
    if interferers is None or not interferers.any:
        return noise
    return Interfered(noise, interferers.columns)
