"""The statistical model as a set of parts (Liang and Meyer, Sec. II); each can be replaced."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.core.support import POSITIVE, UNIT, UP_TO_ONE, Quantity
from torchdt.model.birth import UniformBirth
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.noise.white import WhiteNoise
from torchdt.model.part import Number, Part, number
from torchdt.model.power.gamma import GammaPower
from torchdt.model.region import Region

if TYPE_CHECKING:
    from torchdt.model.birth import Birth
    from torchdt.model.motion.base import Motion
    from torchdt.model.noise.base import NoiseModel
    from torchdt.model.power.base import PowerModel
else:  # configurations have no protocols
    Birth = Motion = NoiseModel = PowerModel = Any


@dataclass(frozen=True)
class Model(Part):
    """What direct tracking assumes of objects and noise; numbers of the parts are numbers of the model.

    Attributes:
        motion: of objects.
        power: what they send.
        noise: of the sensors.
        birth: of objects.
        survival: p_s, probability to go on existing for one step.
        likelihood_power: power to which the likelihood is raised in the update; below 1 the snapshots count
            as fewer.
        effective_count: J that every sample covariance counts as, in update and evidence; None leaves it to
            the data, see `torchdt.model.wishart`.
    """

    motion: Motion = dataclasses.field(default_factory=ConstantVelocity)
    power: PowerModel = dataclasses.field(default_factory=GammaPower)
    noise: NoiseModel = dataclasses.field(default_factory=WhiteNoise)
    birth: Birth = dataclasses.field(default_factory=UniformBirth)
    survival: Number = number(0.95, UNIT)
    likelihood_power: Number = number(1.0, UP_TO_ONE)
    effective_count: Number = number(None, POSITIVE)

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: where one is not in its support, or two parts have numbers of one name.
        """
        super().__post_init__()
        owners: dict[str, str] = {}
        for key, quantities in self._owned().items():
            for name in quantities:
                found = f"a number of both {owners.get(name)} and {key}"
                require(name not in owners, name, found, "one owner for each name")
                owners[name] = key

    @property
    def parts(self) -> dict[str, Any]:
        """The parts by the names of their fields."""
        return {name: getattr(self, name) for name in PARTS}

    def keys(self) -> tuple[str, ...]:
        """Keys of the model and its parts in the configuration."""
        return (self.KEY, *(f"{self.KEY}.{name}" for name in PARTS))

    def _owned(self) -> dict[str, dict[str, Quantity]]:
        """Numbers by owner: the parts, and `model` itself."""
        own = {"model": super().quantities()}
        return own | {name: p.quantities() for name, p in self.parts.items() if isinstance(p, Part)}

    def all_quantities(self) -> dict[str, Quantity]:
        """The numbers of the model and of all its parts, by name."""
        return {name: q for quantities in self._owned().values() for name, q in quantities.items()}

    def known(self) -> dict[str, Any]:
        """Those that have a value, by name."""
        return {name: q.value for name, q in self.all_quantities().items() if q.value is not None}

    def with_numbers(self, values: Mapping[str, Tensor | float | Sequence[float]]) -> Self:
        """The same model with other numbers; gradients pass.

        Raises:
            InputError: where a name is that of no number of the model, or a value not in its support.
        """
        names = self.all_quantities()
        for name in values:
            require(name in names, name, "an unknown number", f"one of {sorted(names)}")
        if isinstance(self.survival, Tensor):
            like = self.survival
            values = {
                n: v if v is None else torch.as_tensor(v, dtype=like.dtype, device=like.device)
                for n, v in values.items()
            }
        own = {name: part for name, part in self.parts.items() if isinstance(part, Part)}
        parts: dict[str, Any] = {name: part.with_numbers(values) for name, part in own.items()}
        return dataclasses.replace(super().with_numbers(values), **parts)

    def on(self, region: Region) -> Self:
        """The model in a region: all numbers are tensors of its type and on its device.

        Raises:
            InputError: where `driving_variance` is not one number for each coordinate.
        """
        parts = {name: part.on(region) for name, part in self.parts.items()}
        return dataclasses.replace(super().on(region), **parts)

    def select(self, sequences: slice | list[int]) -> Self:
        """The model of some sequences of a batch `(B,)`."""
        parts = {name: part.select(sequences) for name, part in self.parts.items()}
        return dataclasses.replace(super().select(sequences), **parts)

    def as_config(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Numbers by name as a configuration nests them: those of a part under the part's name."""
        nested: dict[str, Any] = {}
        for owner, quantities in self._owned().items():
            own = {name: values[name] for name in quantities if name in values}
            if own and owner != "model":
                nested[owner] = own
            else:
                nested.update(own)
        return nested


PARTS = ("motion", "power", "noise", "birth")


def stack_models(models: Sequence[Model], num_sequences: int) -> Model:
    """Several settings of a model for the same sequences, setting by setting.

    Args:
        models: V of them, which differ in numbers alone, each of scalars and `(d,)`.
        num_sequences: B.

    Returns:
        Model of batch `(V * B,)`: the numbers of setting v at `v * B` up to `v * B + B - 1`.

    Raises:
        InputError: where some settings have a number, such as `effective_count`, and others leave it open.
    """
    stacked = {}
    for name in models[0].all_quantities():
        known = [m.known()[name] for m in models if name in m.known()]
        found = f"{len(known)} of {len(models)} settings with a value"
        require(len(known) in (0, len(models)), name, found, "one in each or in none")
        if known:
            stacked[name] = torch.stack(known).repeat_interleave(num_sequences, 0)
    return models[0].with_numbers(stacked)
