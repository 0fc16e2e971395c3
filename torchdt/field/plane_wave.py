"""Plane wave on a line array."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


class LineArrayField(nn.Module):
    """Response of a line array to a plane wave, `a_m = exp(-i 2 pi f / c x_m sin(bearing)) / sqrt(M)`.

    The state is bearing from broadside, degrees, then its rate, degrees/s; only the bearing is read.

    Args:
        freqs: `(I,)` tones, Hz.
        positions: `(M,)` sensor positions along the line, m.
        wave_speed: m/s.
        device: of the buffers, and so of the states.
        dtype: real type of the buffers, and so of the states.

    Raises:
        ValueError: if `freqs` or `positions` is empty, or a tone or the speed is not positive.
    """

    num_coordinates = 1
    _phase_per_sine: Tensor

    def __init__(
        self,
        freqs: Sequence[float],
        positions: Sequence[float],
        wave_speed: float = 1500.0,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        if len(positions) == 0:
            raise ValueError("positions is empty; expected one position or more")
        if len(freqs) == 0 or min(freqs) <= 0:
            raise ValueError(f"freqs is {tuple(freqs)}; expected one positive frequency or more")
        if wave_speed <= 0:
            raise ValueError(f"wave_speed is {wave_speed}; expected a positive number")
        self.num_tones = len(freqs)
        self.num_sensors = len(positions)
        tones, places = (
            torch.tensor(list(v), dtype=torch.float64, device=device) for v in (freqs, positions)
        )
        phase = (-2 * math.pi / wave_speed * tones)[:, None] * places
        dtype = dtype or torch.get_default_dtype()
        self.register_buffer("_phase_per_sine", phase.to(dtype), persistent=False)

    def forward(self, state: Tensor) -> Tensor:
        """Evaluate the response.

        Args:
            state: `(*batch, D)` real, `D >= 1`.

        Returns:
            `(*batch, I, M)` complex, of unit norm over the sensors.

        Raises:
            ValueError: if `state` has no last axis or another type than the buffers.
        """
        if state.ndim == 0 or state.dtype != self._phase_per_sine.dtype:
            raise ValueError(
                f"state has shape {tuple(state.shape)} and type {state.dtype}; "
                f"expected (*batch, 1 or more) of {self._phase_per_sine.dtype}"
            )
        sine = torch.sin(torch.deg2rad(state[..., 0]))
        phase = sine[..., None, None] * self._phase_per_sine
        return torch.complex(torch.cos(phase), torch.sin(phase)) / math.sqrt(self.num_sensors)
