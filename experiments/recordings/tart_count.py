"""How many snapshots a sample covariance is worth, from how well a model of point sources fits it."""

import torch
from torch import Tensor

from torchdt.baselines.detect.points import Detector
from torchdt.field.base import Field
from torchdt.model.measurement import from_covariance


def effective_count(covariance: Tensor, field: Field, detector: Detector) -> float:
    """The count J at which sampling alone would explain the misfit.

    With `W = L^-1 R L^-H` the sample covariance R of J snapshots whitened by the true one, `C = L L^H`,

        `E |W - I|_F^2 = M^2 / J`

    (complex Wishart: each entry of `W - I` has variance 1 / J; N. R. Goodman, Ann. Math. Statist. 34, 1963).
    C is that of the points of the detector and white noise. Where R averages so many samples that J is known
    to be larger, the misfit is the model's: a likelihood of J snapshots weighs data and model alike.

    Args:
        covariance: `(K, M, M)` complex sample covariances.
        field: of one tone.
        detector: whose points do not depend on the number of snapshots.

    Returns:
        J, that of the mean misfit over the K steps.

    Raises:
        NumericalError: where a response is not finite.
    """
    size = covariance.shape[-1]
    points = detector(from_covariance(covariance[:, None], 1.0))
    power = torch.where(points.present, points.power[..., 0], 0.0)
    columns = field(points.position)[..., 0, :].mT * power.sqrt()[:, None]
    eye = torch.eye(size, dtype=covariance.dtype, device=covariance.device)
    lower = torch.linalg.cholesky(columns @ columns.mH + points.noise[..., None] * eye)
    half = torch.linalg.solve_triangular(lower, covariance, upper=False)
    whitened = torch.linalg.solve_triangular(lower, half.mH, upper=False)
    return size**2 / (whitened - eye).abs().square().sum((-2, -1)).mean().item()
