"""A recording: what the array measured, where its sensors are and, if known, where the objects were."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import torch
from torch import Tensor

from torchdt.core.errors import InputError

HERMITIAN_TOLERANCE = 1e-5  # of the largest magnitude of a matrix; single-precision files stay well below
SNAPSHOTS_SHAPE = "(B, K, I, J, M) or (K, I, J, M)"
COVARIANCE_SHAPE = "(B, K, I, M, M) or (K, I, M, M)"
TRUTH_SHAPE = "(B, K, L, d) or (K, L, d)"


class MissingSummary(NamedTuple):
    """What is missing from the data of a recording.

    Attributes:
        num_missing: number of data entries that are NaN.
        num_entries: number of data entries.
        dead_channels: `(B, M)` bool, sensors without a single value in the whole run.
    """

    num_missing: int
    num_entries: int
    dead_channels: Tensor


@dataclass(frozen=True, eq=False)
class Recording:
    """B recordings of equal size; make one with `validate`, which states what fits.

    Attributes:
        step_s: seconds from one step to the next.
        start_s: `(B,)` float64, time of the first sample of the first step, s.
        span_s: seconds from the first to the last sample of a step, which may be more than `step_s` where
            steps share samples; None if it is `step_s`.
        snapshots: `(B, K, I, J, M)` complex, any unit of pressure; NaN = missing. None if `covariance`.
        covariance: `(B, K, I, M, M)` complex Hermitian sample covariance; NaN = missing. None if `snapshots`.
        num_snapshots: number of snapshots J behind each covariance.
        freqs: `(I,)` float64, Hz.
        element_depths: `(M,)` float64, m.
        sensor_positions: `(M, 3)` float64, m.
        truth: `(B, K, L, d)` float64 true positions in the field's coordinates; NaN = absent.
        name: what to call the recording in reports.
    """

    step_s: float
    start_s: Tensor
    span_s: float | None = None
    snapshots: Tensor | None = None
    covariance: Tensor | None = None
    num_snapshots: float | None = None
    freqs: Tensor | None = None
    element_depths: Tensor | None = None
    sensor_positions: Tensor | None = None
    truth: Tensor | None = None
    name: str = ""

    @property
    def data(self) -> Tensor:
        """The snapshots or, without them, the covariance; its leading dimensions are (B, K, I)."""
        data = self.covariance if self.snapshots is None else self.snapshots
        assert data is not None
        return data

    @property
    def batch_size(self) -> int:
        """Number B of recordings."""
        return self.data.shape[0]

    @property
    def num_steps(self) -> int:
        """Number K of steps."""
        return self.data.shape[1]

    @property
    def num_tones(self) -> int:
        """Number I of tones."""
        return self.data.shape[2]

    @property
    def num_sensors(self) -> int:
        """Number M of sensors."""
        return self.data.shape[-1]

    @property
    def truth_mask(self) -> Tensor | None:
        """`(B, K, L)` bool, the objects present: those with all coordinates known. None without truth."""
        return None if self.truth is None else ~self.truth.isnan().any(-1)

    def select(self, sequences: slice) -> Self:
        """Some of the sequences, without copying them."""
        return self._of_each(lambda values: values[sequences])

    def repeat(self, number: int) -> Self:
        """All sequences `number` times, the batch as a whole each time."""
        return self._of_each(lambda values: torch.cat([values] * number))

    def _of_each(self, change: Callable[[Tensor], Tensor]) -> Self:
        """Change what has a batch dimension."""
        parts = (self.snapshots, self.covariance, self.truth)
        snapshots, covariance, truth = (None if part is None else change(part) for part in parts)
        start_s = change(self.start_s)
        return replace(self, start_s=start_s, snapshots=snapshots, covariance=covariance, truth=truth)

    def times(self) -> Tensor:
        """Time of each step, to which its estimates and its truth belong: `(B, K)`, see `step_times`."""
        return step_times(self.num_steps, self.step_s, self.start_s, self.span_s)

    def missing_summary(self) -> MissingSummary:
        """Count the missing entries and find the channels that never deliver."""
        missing = self.data.isnan()
        channel = missing if self.covariance is None else missing.diagonal(dim1=-2, dim2=-1)
        dead = channel.flatten(1, -2).all(1)
        return MissingSummary(int(missing.sum()), missing.numel(), dead)


def step_times(
    num_steps: int, step_s: float, start_s: Tensor | float = 0.0, span_s: float | None = None
) -> Tensor:
    """The middle of the samples that each step is made of, `start_s + k step_s + span_s / 2`.

    Args:
        num_steps: number K of steps.
        step_s: seconds from one step to the next.
        start_s: `(*batch,)` time of the first sample of the first step, s.
        span_s: seconds from the first to the last sample of a step; None if it is `step_s`.

    Returns:
        `(*batch, K)` float64, s.
    """
    middle = torch.as_tensor(start_s, dtype=torch.float64) + (step_s if span_s is None else span_s) / 2
    steps = torch.arange(num_steps, dtype=torch.float64, device=middle.device)
    return middle[..., None] + step_s * steps


def validate(
    *,
    step_s: Tensor | float | None = None,
    start_s: Tensor | float | None = None,
    span_s: Tensor | float | None = None,
    snapshots: Tensor | None = None,
    covariance: Tensor | None = None,
    num_snapshots: Tensor | float | None = None,
    freqs: Tensor | None = None,
    element_depths: Tensor | None = None,
    sensor_positions: Tensor | None = None,
    truth: Tensor | None = None,
    name: str = "",
) -> Recording:
    """Make a recording out of arrays, or say what is wrong with them.

    The arguments are the attributes of `Recording`. The batch dimension may be left out of the data and of
    the truth; `start_s` may be one number for all, and is 0 if it is left out. Data keep their precision; all
    else becomes float64.

    Raises:
        InputError: naming the key, what was found and what was expected. Missing data (NaN) are no error.
    """
    if step_s is None:
        raise InputError.of_key("step_s", "nothing", "the seconds from one step to the next")
    step = _scalar("step_s", step_s, "a number of seconds above zero")
    if step <= 0:
        raise InputError.of_key("step_s", step, "a number of seconds above zero")
    span = None if span_s is None else _scalar("span_s", span_s, "a number of seconds from zero up")
    if span is not None and span < 0:
        raise InputError.of_key("span_s", span, "a number of seconds from zero up")

    if snapshots is not None and covariance is not None:
        raise InputError.of_key("covariance", "snapshots as well", "either snapshots or covariance")
    if snapshots is not None:
        snapshots = data = _complex("snapshots", snapshots, SNAPSHOTS_SHAPE)
    elif covariance is not None:
        covariance = data = _complex("covariance", covariance, COVARIANCE_SHAPE, square=True)
        _check_covariance(covariance)
    else:
        raise InputError.of_key("snapshots", "neither snapshots nor covariance", "one of the two")
    batch_size, num_steps, num_tones, num_sensors = *data.shape[:3], data.shape[-1]
    start = _start(start_s, batch_size)

    count = None if num_snapshots is None else _scalar("num_snapshots", num_snapshots, "a number from one up")
    if covariance is not None and count is None:
        raise InputError.of_key("num_snapshots", "nothing", "the number of snapshots behind the covariance")
    if count is not None and count < 1:
        raise InputError.of_key("num_snapshots", count, "a number from one up")
    if snapshots is not None and count not in (None, snapshots.shape[-2]):
        raise InputError.of_key("num_snapshots", count, f"{snapshots.shape[-2]}, as in snapshots, or nothing")

    if freqs is not None:
        freqs = _finite("freqs", freqs, (num_tones,), "Hz, one for each tone")
        if not (freqs > 0).all():
            raise InputError.of_key("freqs", float(freqs.min()), "frequencies above zero Hz")
    if element_depths is not None:
        element_depths = _finite("element_depths", element_depths, (num_sensors,), "m, one for each sensor")
    if sensor_positions is not None:
        wanted = (num_sensors, 3)
        sensor_positions = _finite("sensor_positions", sensor_positions, wanted, "m, one row for each sensor")
    if truth is not None:
        truth = _truth(truth, batch_size, num_steps)

    return Recording(
        step_s=step,
        start_s=start,
        span_s=span,
        snapshots=snapshots,
        covariance=covariance,
        num_snapshots=count,
        freqs=freqs,
        element_depths=element_depths,
        sensor_positions=sensor_positions,
        truth=truth,
        name=name,
    )


def _start(value: Tensor | float | None, batch_size: int) -> Tensor:
    """`(B,)`, of one number for all recordings or one for each."""
    start = value if isinstance(value, Tensor) else torch.tensor(value or 0.0, dtype=torch.float64)
    if start.dim() == 0:
        start = start.expand(batch_size)
    return _finite("start_s", start, (batch_size,), "s, one number or one for each recording")


def _scalar(key: str, value: Tensor | float, expected: str) -> float:
    if not isinstance(value, Tensor):
        value = torch.tensor(value, dtype=torch.float64)
    _check_real(key, value, expected)
    if value.dim() > 0:
        raise InputError.of_key(key, f"shape {tuple(value.shape)}", f"a scalar, {expected}")
    if not value.isfinite():
        raise InputError.of_key(key, value.item(), expected)
    return value.item()


def _complex(key: str, value: Tensor, shape: str, square: bool = False) -> Tensor:
    """Data with a batch dimension, checked for all that snapshots and covariances share."""
    if not value.is_complex():
        raise InputError.of_key(key, value.dtype, f"complex numbers of shape {shape}")
    if value.dim() not in (4, 5) or value.numel() == 0:
        raise InputError.of_key(key, f"shape {tuple(value.shape)}", f"{shape}, none of them zero")
    if square and value.shape[-2] != value.shape[-1]:
        raise InputError.of_key(key, f"shape {tuple(value.shape)}", shape)
    _check_not_infinite(key, value)
    return value if value.dim() == 5 else value[None]


def _finite(key: str, value: Tensor, shape: tuple[int, ...], meaning: str) -> Tensor:
    _check_real(key, value, f"real numbers of shape {shape}")
    if tuple(value.shape) != shape:
        raise InputError.of_key(key, f"shape {tuple(value.shape)}", f"{shape}: {meaning}")
    if not value.isfinite().all():
        raise InputError.of_key(key, "a value that is NaN or infinite", "finite values")
    return value.double()


def _truth(truth: Tensor, batch_size: int, num_steps: int) -> Tensor:
    _check_real("truth", truth, f"real numbers of shape {TRUTH_SHAPE}")
    shape = tuple(truth.shape)
    if len(shape) not in (3, 4) or shape[-1] == 0:
        raise InputError.of_key("truth", f"shape {shape}", f"{TRUTH_SHAPE}, d above zero")
    truth = truth.double() if len(shape) == 4 else truth.double()[None]
    if truth.shape[1] != num_steps:
        found = f"{truth.shape[1]} steps (shape {shape})"
        raise InputError.of_key("truth", found, f"{num_steps} steps, as in the data")
    if truth.shape[0] != batch_size:
        found = f"{truth.shape[0]} runs (shape {shape})"
        raise InputError.of_key("truth", found, f"{batch_size} runs, as in the data")
    _check_not_infinite("truth", truth)
    return truth


def _check_real(key: str, value: Tensor, expected: str) -> None:
    if value.is_complex() or value.dtype == torch.bool:
        raise InputError.of_key(key, value.dtype, expected)


def _check_not_infinite(key: str, value: Tensor) -> None:
    infinite = value.isinf()
    if infinite.any():
        where = tuple(infinite.nonzero()[0].tolist())
        raise InputError.of_key(key, f"{int(infinite.sum())} infinite values, the first at {where}", "none")


def _check_covariance(covariance: Tensor) -> None:
    """Check `(B, K, I, M, M)` for matrices that no set of snapshots can have, missing channels left out."""
    missing = covariance.isnan()
    matrix = torch.where(missing, 0, covariance.to(torch.complex128))
    tolerance = HERMITIAN_TOLERANCE * matrix.abs().amax((-2, -1))

    asymmetric = (missing != missing.mT).flatten(-2).any(-1)
    _refuse(asymmetric, "NaN at [m, n] but not at [n, m]", "missing values in symmetric places")
    not_hermitian = (matrix - matrix.mH).abs().amax((-2, -1)) > tolerance
    _refuse(not_hermitian, "a matrix that is not Hermitian", "Hermitian matrices")

    # Eigenvalues exist only for a block without gaps: keep the sensors whose own power is known, then drop
    # those with a gap towards one of the kept. Errors within the tolerance move an eigenvalue M times as far.
    known = ~missing.diagonal(dim1=-2, dim2=-1)
    gap = missing & known[..., :, None] & known[..., None, :]
    known = known & ~gap.any(-1)
    block = torch.where(known[..., :, None] & known[..., None, :], matrix, 0)
    indefinite = torch.linalg.eigvalsh(block)[..., 0] < -block.shape[-1] * tolerance
    _refuse(indefinite, "a matrix with a negative eigenvalue", "positive semidefinite matrices")


def _refuse(bad: Tensor, found: str, expected: str) -> None:
    """Raise for the first bad matrix of `(B, K, I)`."""
    if bad.any():
        run, step, tone = bad.nonzero()[0].tolist()
        where = f"{found} (run {run}, step {step}, tone {tone}; {int(bad.sum())} in all)"
        raise InputError.of_key("covariance", where, expected)
