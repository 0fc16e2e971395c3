"""Evidence of one time step."""

from torch import Tensor

from torchdt.bp.moments import signal_covariance
from torchdt.bp.schedule import Beliefs
from torchdt.model.measurement import Measurement, gaussian_log_likelihood, mask_covariance


def gaussian_evidence(beliefs: Beliefs, measurement: Measurement) -> Tensor:
    """`log CN(z; 0, sum_n r_n E[gamma] E[a a^H] + E[eta] I)` under predicted beliefs, `(*batch,)`.

    Cheap and crude: the predicted mixture is replaced by one Gaussian.
    """
    signal = signal_covariance(beliefs.strength, beliefs.moment)
    covariance = mask_covariance(signal, beliefs.noise.mean, measurement.present)
    return gaussian_log_likelihood(measurement, covariance).sum(-1)
