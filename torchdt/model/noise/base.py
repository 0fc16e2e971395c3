"""Noise of the sensors: the belief about its level, what a model must offer, and a base for models."""

import abc
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.weights import normalise, weighted_mean
from torchdt.model.gamma_chain import SHAPE, predict_chain, predicted_uniform_prior
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.part import Number, Part, append_dims, number
from torchdt.model.prior import Priors, resolvable_noise
from torchdt.model.region import Region


class Noise(NamedTuple):
    """Belief about the noise level of each tone: the variance eta of a sensor, or what stands for it.

    Attributes:
        variance: `(*batch, I, E)` support points.
        log_weight: `(*batch, I, E)` normalised log-weights.
    """

    variance: Tensor
    log_weight: Tensor

    @property
    def mean(self) -> Tensor:
        """E[eta] of each tone, `(*batch, I)`."""
        return weighted_mean(self.variance, self.log_weight)

    def above(self, least: Tensor) -> "Noise":
        """The same belief with no support point below `(*batch, I)` values."""
        return self._replace(variance=torch.maximum(self.variance, least[..., None]))


class NoiseCovariance(Protocol):
    """What the noise of a step makes of the covariance of the data."""

    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """Covariance of the data, `(*batch, I, M, M)`, positive definite also where the signal is large.

        Missing sensors are correlated with nothing; what stands on their diagonal is not used.

        Args:
            signal: `(*batch, I, M, M)` complex covariance of what objects send.
            variance: eta, `(*batch, I)`.
            present: `(*batch, I, M)`, 1 for sensors that are there.
        """
        ...

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """Weight the support points by the data, given the covariance of the signal.

        Args:
            prior: predicted belief, batch `(*batch,)`.
            measurement: statistics of one step.
            signal: `(*batch, I, M, M)` complex, sum over the objects of `r E[gamma] E[a a^H]`.
        """
        ...

    def log_likelihood(self, measurement: Measurement, columns: Tensor, variance: Tensor) -> Tensor:
        """`gaussian_log_likelihood` of each tone, `(*batch, I)`, where the signal is `A A^H`.

        Args:
            measurement: statistics, batch `(*batch, I)`, in double precision.
            columns: A, `(*batch, I, M, N)` complex, of as many columns as there are objects.
            variance: eta, `(*batch, I)`.
        """
        ...

    def select(self, sequences: slice | list[int]) -> Self:
        """The same for some sequences of a batch."""
        ...


@runtime_checkable
class NoiseModel(NoiseCovariance, Protocol):
    """How noise begins, changes, and adds to the covariance of the data; see `BaseNoise`."""

    def check_array(self, num_tones: int, num_sensors: int) -> None:
        """Refuse an array that the model is not for.

        Raises:
            InputError: naming what does not fit.
        """
        ...

    def initial(self, maximum: Tensor, num_points: int) -> Noise:
        """Belief of the first step.

        Args:
            maximum: `(*batch, I)` largest level before it.
            num_points: E.
        """
        ...

    def predict(self, noise: Noise) -> Noise:
        """Belief one step later."""
        ...

    def resolvable(self, noise: Noise, measurement: Measurement, priors: Priors) -> Noise:
        """The belief with no level below what numbers of its precision can tell from rounding."""
        ...

    def on(self, region: Region) -> Self:
        """The model with numbers in the type and on the device of a region."""
        ...


@dataclass(frozen=True)
class BaseNoise(Part, abc.ABC):
    """A level uniform up to a limit before the first step, a Gamma chain from then on: f(eta | eta').

    Liang and Meyer, Sec. IV. A model of one's own says what a level makes of the covariance of the data
    (`covariance`). The rest follows from it, one factorisation for each support point; where the structure of
    the noise allows better, override it.

    Attributes:
        noise_shape: c_eta, shape of the Gamma transition, at least 1.
    """

    KEY: ClassVar[str] = "model.noise"

    noise_shape: Number = number(1e2, SHAPE)

    def check_array(self, num_tones: int, num_sensors: int) -> None:
        """Any array will do."""

    def initial(self, maximum: Tensor, num_points: int) -> Noise:
        """Belief of the first step, see `predicted_uniform_prior`."""
        return Noise(*predicted_uniform_prior(maximum, num_points, append_dims(self.noise_shape, 1)))

    def predict(self, noise: Noise) -> Noise:
        """One Gamma transition, see `predict_chain`."""
        return Noise(*predict_chain(noise.variance, noise.log_weight, append_dims(self.noise_shape, 1)))

    def resolvable(self, noise: Noise, measurement: Measurement, priors: Priors) -> Noise:
        """No level below that of `resolvable_noise`."""
        return noise.above(resolvable_noise(measurement, priors))

    @abc.abstractmethod
    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """See `NoiseModel.covariance`."""

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """Weight the support points by the data, see `NoiseModel.update`."""
        each, level = measurement.unsqueeze(), prior.variance.movedim(-1, -2)
        covariance = self.covariance(signal.unsqueeze(-4), level, each.present)
        log_likelihood = gaussian_log_likelihood(each, covariance).movedim(-2, -1)
        return prior._replace(log_weight=normalise(prior.log_weight + log_likelihood)[0])

    def log_likelihood(self, measurement: Measurement, columns: Tensor, variance: Tensor) -> Tensor:
        """Of few columns, see `NoiseModel.log_likelihood`."""
        covariance = self.covariance(columns @ columns.mH, variance, measurement.present)
        return gaussian_log_likelihood(measurement, covariance)
