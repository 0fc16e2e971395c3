"""Evidence of one time step."""

from torch import Tensor

from torchdt.bp.schedule import Beliefs, background
from torchdt.model.measurement import Measurement, gaussian_log_likelihood


def gaussian_evidence(beliefs: Beliefs, measurement: Measurement) -> Tensor:
    """`log CN(z; 0, sum_n r_n E[gamma] E[a a^H] + E[eta] I)` under predicted beliefs, `(*batch,)`.

    Cheap and crude: the predicted mixture is replaced by one Gaussian.
    """
    return gaussian_log_likelihood(measurement, background(beliefs, beliefs.strength, measurement)).sum(-1)
