"""Fields of arrays whose sensors have gains and phases of their own."""

import math
from typing import Self

import torch
from torch import Tensor

from torchdt.field.base import BaseField, Field
from torchdt.field.wrapped import WrappedField


class UnevenArrayField(WrappedField):
    """A field whose sensors have gains and phases of their own, `g_m a_m(x)`.

    Args:
        field: of even sensors.
        gain: g, `(M,)` complex.
        normalize: scale each tone's response to the norm that it has without them.
    """

    def __init__(self, field: Field, gain: Tensor, *, normalize: bool = False):
        super().__init__(field)
        self.gain, self.normalize = gain, normalize

    def around(self, field: BaseField) -> Self:
        """The same gains of another field."""
        return type(self)(field, self.gain, normalize=self.normalize)

    def __call__(self, state: Tensor) -> Tensor:
        """Evaluate the response, `(*batch, D)` to `(*batch, I, M)`."""
        even = self.field(state)
        response = even * self.gain.to(even)
        if not self.normalize:
            return response
        before, after = (torch.linalg.vector_norm(t, dim=-1, keepdim=True) for t in (even, response))
        return response * (before / after.clamp_min(torch.finfo(after.dtype).tiny))

    def incoherent(self, state: Tensor) -> Tensor | None:
        """See `BaseField`; scaled like the response."""
        even = self.field.incoherent(state)
        if even is None:
            return None
        gain = self.gain.to(even)
        covariance = even * gain[:, None] * gain.conj()
        if not self.normalize:
            return covariance
        before, after = (t.diagonal(dim1=-2, dim2=-1).real.sum(-1) for t in (even, covariance))
        return covariance * (before / after.clamp_min(torch.finfo(after.dtype).tiny))[..., None, None]

    def diffuse(self, state: Tensor) -> Tensor | None:
        """See `BaseField`; through the same sensors."""
        even = self.field.diffuse(state)
        if even is None:
            return None
        gain = self.gain.to(even)
        return even * gain[:, None] * gain.conj()


def sensor_gains(gain_db: Tensor, phase_deg: Tensor) -> Tensor:
    """Complex gains `(M,)` of gains in dB and phases in degrees."""
    return torch.polar(torch.exp(gain_db * (math.log(10) / 20)), torch.deg2rad(phase_deg))
