"""A place for what is no object: signals of free spatial signature, or none."""

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor
from torch.nn.functional import softplus

from torchdt.core.ranges import Checked, Count, Positive, Share
from torchdt.core.trees import take
from torchdt.filter.bp.rank_one import Whitener
from torchdt.filter.interference.echoes import echo_gain, leftover_gain, principal
from torchdt.filter.interference.interfered import Interfered
from torchdt.filter.interference.signatures import Interferers, fit, follow, free_gains, price
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.noise.base import Noise, NoiseCovariance

LOUDEST = 2.0
"""Energy of an echo over its mean, at most."""


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

    def rival(
        self,
        measurement: Measurement,
        covariance: Tensor,
        variance: Tensor,
        interferers: Interferers | None = None,
    ) -> Tensor:
        """Nats that other interferers are worth than there are, price paid, `(*batch,)`, from zero up.

        Args:
            measurement: statistics of the step.
            covariance: `(*batch, I, M, M)` of all that is there, interferers included.
            variance: eta, `(*batch, I)`.
            interferers: those that are there; None for none.
        """
        ...

    def echo(
        self, whitener: Whitener, index: Tensor, moment: Tensor, strength: Tensor, new: Tensor
    ) -> Tensor:
        """Nats that an echo of a stronger object is worth beside no object, `(*batch,)`, from zero up.

        Args:
            whitener: of all but one object.
            index: `(*batch,)` that object.
            moment: `(*batch, N, I, M, M)` complex `E[a a^H]` of all.
            strength: `(*batch, N, I)` of all, `r E[gamma]`.
            new: `(*batch,)` bool, whether the object was improbable before the step.
        """
        ...

    def leftover(self, measurement: Measurement, covariance: Tensor, moment: Tensor, power: Tensor) -> Tensor:
        """Nats that what the response of an object leaves is worth beside it, `(*batch,)`, from zero up.

        Args:
            measurement: statistics of the step.
            covariance: `(*batch, I, M, M)` of all but the object.
            moment: `(*batch, I, M, M)` complex, its `E[a a^H]`.
            power: `(*batch, I)` of the object.
        """
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
        return Interferers(before, torch.zeros_like(measurement.num_snapshots), before)

    def rival(
        self,
        measurement: Measurement,
        covariance: Tensor,
        variance: Tensor,
        interferers: Interferers | None = None,
    ) -> Tensor:
        """Nothing."""
        return torch.zeros_like(variance[..., 0])

    def echo(
        self, whitener: Whitener, index: Tensor, moment: Tensor, strength: Tensor, new: Tensor
    ) -> Tensor:
        """Nothing."""
        return torch.zeros_like(strength[..., 0, 0])

    def leftover(self, measurement: Measurement, covariance: Tensor, moment: Tensor, power: Tensor) -> Tensor:
        """Nothing."""
        return torch.zeros_like(power[..., 0])


NOTHING_ELSE = NoInterference()


@dataclass(frozen=True)
class FreeSignatures(Checked):
    """Signals of any spatial vector, each tone of its own, see `torchdt.filter.interference.signatures`.

    Attributes:
        signatures: K, number in a tone, at most.
        memory: steps of data that the signature of the last step counts as.
        echoes: mean energy of an echo over that of its object, and largest of what a response leaves where
            the existence of its object is in question; zero for none.
        leftovers: mean energy of what a response leaves over that of its object, where new signals are.
    """

    KEY: ClassVar[str] = "tracker.interference"

    signatures: Count = 3
    memory: Positive = 2.0
    echoes: Share = 0.1
    leftovers: Share = 0.01

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
            return Interferers(before, torch.zeros_like(measurement.num_snapshots), before)
        return follow(measurement, noise_model, noise, signal, before, self.memory, new, self.leftovers)

    @torch.no_grad()
    def rival(
        self,
        measurement: Measurement,
        covariance: Tensor,
        variance: Tensor,
        interferers: Interferers | None = None,
    ) -> Tensor:
        """`sum_ik log(1 + exp(gain_ik - price_i))` of more, or what all are worth that are fitted anew."""
        cost = price(measurement, variance)
        gain = free_gains(measurement, covariance, self.signatures)
        more = softplus(gain - cost[..., None]).sum((-2, -1))
        if interferers is None or not interferers.any:
            return more
        present = measurement.present
        bare = covariance - interferers.covariance * (present[..., :, None] * present[..., None, :])
        net = fit(measurement, bare, interferers.before, cost, self.memory, new=True)[1]
        before, after = (gaussian_log_likelihood(measurement, c) for c in (covariance, bare))
        anew = after + net - (before - interferers.cost)
        return torch.maximum(more, anew.sum(-1))

    @torch.no_grad()
    def echo(
        self, whitener: Whitener, index: Tensor, moment: Tensor, strength: Tensor, new: Tensor
    ) -> Tensor:
        """See `echo_gain`."""
        response = principal(moment)
        sent = strength * response.abs().square().sum(-1)  # (*batch, N, I)
        total, own = sent.sum(-1), take(sent, index).sum(-1, keepdim=True)
        stronger = total > own
        # As many as can be told apart, and none of what is too strong for an echo of them all.
        rank = torch.where(stronger, total, 0.0).argsort(-1, descending=True).argsort(-1)
        apart = whitener.num_snapshots.amax(-1, keepdim=True) - 1
        parents = stronger & (rank < apart)
        heard = torch.where(parents, total, 0.0).sum(-1, keepdim=True)
        parents = parents & (own < LOUDEST * self.echoes * heard)
        if not bool(parents.any()):
            return torch.zeros_like(own[..., 0])
        power = torch.where(parents[..., None], strength, 0.0)
        return echo_gain(whitener, take(response, index), response, power, self.echoes, new)

    @torch.no_grad()
    def leftover(self, measurement: Measurement, covariance: Tensor, moment: Tensor, power: Tensor) -> Tensor:
        """See `leftover_gain`."""
        if not self.echoes:
            return torch.zeros_like(power[..., 0])
        return leftover_gain(measurement, covariance, principal(moment), power, self.echoes)


def beside(noise: NoiseCovariance, interferers: Interferers | None) -> NoiseCovariance:
    """The noise with interferers, where there are any."""
    if interferers is None or not interferers.any:
        return noise
    return Interfered(noise, interferers.columns)
