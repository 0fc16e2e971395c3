"""Coloured noise: of known correlations between the sensors and unknown level."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.core.linalg import cholesky
from torchdt.model.measurement import ROUNDING, Measurement, low_rank_log_likelihood
from torchdt.model.noise.base import BaseNoise, Noise
from torchdt.model.noise.white import update_noise
from torchdt.model.prior import Priors, resolvable_noise
from torchdt.model.region import Region

HERMITIAN = 1e-5
"""Largest departure from a Hermitian matrix, over the largest entry: what single precision leaves."""

DEFINITE = 1e-10
"""Least eigenvalue over the largest: below, whitening in double precision means nothing."""


@dataclass(frozen=True)
class ColouredNoise(BaseNoise):
    """`signal + eta N_i`, with N_i known for each tone i and eta unknown.

    With `N = L L^H` it is white noise on whitened data, `L^-1 z` and responses `L^-1 a`, whose density has
    the Jacobian `|N|^J`. Of sensors that are missing, N lacks rows and columns.

    Attributes:
        matrix: N, `(I, M, M)` or one `(M, M)` for all tones, Hermitian and positive definite: a tensor or
            array, nested lists (complex numbers as strings, `0.3+0.1j`), or the path of an `.npy` file or of
            an `.npz` file of one array. Only its shape counts: each is scaled to a mean of one on the
            diagonal, so that eta is the mean noise variance of the sensors.
        least: smallest eigenvalue of each, `(I,)` or `()`.

    Raises:
        InputError: where the matrix cannot be read, or is not such a matrix.
    """

    matrix: Any = None
    least: Tensor = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Read and check the matrix.

        Raises:
            InputError: see the class.
        """
        super().__post_init__()
        key = f"{self.KEY}.matrix"
        matrix = self.matrix if isinstance(self.matrix, Tensor) else _read(key, self.matrix)
        matrix = matrix.to(torch.complex128)
        square = matrix.ndim in (2, 3) and matrix.shape[-1] == matrix.shape[-2]
        require(
            square, key, f"shape {tuple(matrix.shape)}", "(tones, sensors, sensors) or (sensors, sensors)"
        )
        if not matrix.is_meta:  # no numbers to check
            _check(key, matrix.detach())
        scale = matrix.diagonal(dim1=-2, dim2=-1).real.mean(-1)
        matrix = (matrix + matrix.mH) / (2 * scale[..., None, None])
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "least", torch.linalg.eigvalsh(matrix.detach())[..., 0])

    def check_array(self, num_tones: int, num_sensors: int) -> None:
        """Refuse an array of other tones or sensors.

        Raises:
            InputError: naming their numbers.
        """
        expected = [(num_tones, num_sensors, num_sensors), (num_sensors, num_sensors)]
        found = tuple(self.matrix.shape)
        words = f"{expected[0]} or {expected[1]}, as the field has tones and sensors"
        require(found in expected, f"{self.KEY}.matrix", f"shape {found}", words)

    def on(self, region: Region) -> Self:
        """The model on the device of a region; the matrix stays in double precision."""
        moved = replace(self, matrix=self.matrix.to(region.low.device))
        return super(ColouredNoise, moved).on(region)

    def resolvable(self, noise: Noise, measurement: Measurement, priors: Priors) -> Noise:
        """No level whose quietest direction is below `resolvable_noise`."""
        return noise.above(resolvable_noise(measurement, priors) / self.least.to(noise.variance))

    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """`signal + eta N`, and eta on the diagonal of missing sensors; rounding as in `mask_covariance`."""
        masked = signal * (present[..., :, None] * present[..., None, :])
        trace = masked.detach().diagonal(dim1=-2, dim2=-1).real.sum(-1)
        rounding = ROUNDING * torch.finfo(variance.dtype).eps * trace / self.least.to(trace)
        level = torch.maximum(variance, rounding)
        return masked + level[..., None, None] * self._among(present).to(masked.dtype)

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """Weight the support points by the whitened data, see `update_noise`."""
        whitening, _ = self._whitening(measurement.present)
        factor = whitening @ measurement.factor.to(whitening.dtype)
        white = whitening @ signal.to(whitening.dtype) @ whitening.mH
        return update_noise(prior, measurement._replace(factor=factor), white)

    def log_likelihood(self, measurement: Measurement, columns: Tensor, variance: Tensor) -> Tensor:
        """Of few columns, whitened as the data are, see `low_rank_log_likelihood`; less `J log|N|`."""
        whitening, log_det = self._whitening(measurement.present)
        white = measurement._replace(factor=whitening @ measurement.factor)
        value = low_rank_log_likelihood(white, whitening @ columns, variance)
        return value - measurement.num_snapshots * log_det

    def _among(self, present: Tensor) -> Tensor:
        """N of the sensors that are there, and ones for the others, `(*batch, I, M, M)`."""
        both = present[..., :, None] * present[..., None, :]
        return self.matrix * both + torch.diag_embed(1 - present)

    def _whitening(self, present: Tensor) -> tuple[Tensor, Tensor]:
        """`L^-1`, `(*batch, I, M, M)`, and log|N|, `(*batch, I)`, of the sensors that are there."""
        lower = cholesky(self._among(present), "noise covariance")
        eye = torch.eye(lower.shape[-1], dtype=lower.dtype, device=lower.device)
        log_det = 2 * lower.diagonal(dim1=-2, dim2=-1).real.log().sum(-1)
        return torch.linalg.solve_triangular(lower, eye, upper=False), log_det


def _read(key: str, source: Any) -> Tensor:
    """A matrix from a file, lists or an array."""
    require(source is not None, key, "nothing", "a matrix for each tone, or the path of a file")
    if isinstance(source, str | Path):
        try:
            loaded = np.load(source)
            if not isinstance(loaded, np.ndarray):
                arrays = list(loaded.values())
                require(len(arrays) == 1, key, f"{len(arrays)} arrays in '{source}'", "one array")
                (loaded,) = arrays
        except (OSError, ValueError, EOFError) as error:
            if isinstance(error, InputError):
                raise
            found = f"'{source}', which cannot be read ({error})"
            raise InputError.of_key(key, found, "a file of NumPy's, .npy or .npz") from error
        source = loaded
    try:
        return torch.as_tensor(np.asarray(source).astype(np.complex128))
    except (TypeError, ValueError) as error:
        raise InputError.of_key(key, repr(source), "a matrix of numbers for each tone") from error


def _check(key: str, matrix: Tensor) -> None:
    """Refuse what is no covariance."""
    require(bool(matrix.isfinite().all()), key, "entries that are not finite", "finite numbers")
    asymmetry = (matrix - matrix.mH).abs().amax((-2, -1)) / matrix.abs().amax((-2, -1))
    worst = asymmetry.max().item()
    found = f"entries that differ from those across the diagonal by {worst:.3g} of the largest"
    require(worst <= HERMITIAN, key, found, "Hermitian matrices")
    level = torch.linalg.eigvalsh(matrix)
    least = (level[..., 0] / level[..., -1]).min().item()
    positive = least > DEFINITE and bool((level[..., -1] > 0).all())
    require(
        positive, key, f"a least eigenvalue of {least:.3g} times the largest", "positive definite matrices"
    )
