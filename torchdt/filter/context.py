"""What all parts of a step are computed in: the field, the region, the model and the data."""

from typing import NamedTuple, Self

from torch import Tensor

from torchdt.core.trees import take_sequences
from torchdt.field.base import BaseField
from torchdt.model.measurement import Measurement
from torchdt.model.model import Model
from torchdt.model.noise.base import NoiseCovariance
from torchdt.model.region import Region


class StepContext(NamedTuple):
    """Where objects may be, how they are seen, and the data of one step.

    Attributes:
        field: array response.
        region: region of interest.
        model: statistical model, with numbers as tensors.
        noise: that of the model, together with what else is heard and is no object.
        measurement: statistics of the step, batch `(*batch,)`.
    """

    field: BaseField
    region: Region
    model: Model
    noise: NoiseCovariance
    measurement: Measurement

    def select(self, rows: Tensor) -> Self:
        """The same for some sequences of a batch `(B,)`, `(B',)` int64."""
        chosen = rows.tolist()
        return self._replace(
            field=self.field.select(chosen),
            region=self.region.select(chosen),
            model=self.model.select(chosen),
            noise=self.noise.select(chosen),
            measurement=take_sequences(self.measurement, rows),
        )
