"""The spectrum of multi-frequency sparse Bayesian learning (SBL) over the grid of birth cells.

Every column a_c of the dictionary has a power gamma_c that all tones share, `Sigma_f = sum_c gamma_c a_fc
a_fc^H + eta_f I`, and the evidence is raised by the fixed-point update

    `gamma <- gamma * sum_f (1/J) sum_j |a_f^H Sigma_f^-1 z_fj|^2 / sum_f a_f^H Sigma_f^-1 a_f`

(Gemba, Nannuru, Gerstoft and Hodgkiss, J. Acoust. Soc. Am. 141, 2017; Nannuru et al., Signal Processing 159,
2019), with the noise variance of what the strongest peaks leave over. Powers that go to zero stay there: most
columns do within a few steps, and are left out from then on.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.baselines.detect.config import SblConfig
from torchdt.baselines.detect.describe import describe
from torchdt.baselines.detect.peaks import Grid
from torchdt.filter.bp.moments import weighted_moment
from torchdt.filter.bp.rank_one import statistics, whiten
from torchdt.model.measurement import Measurement, mask_covariance

ALONE = 2048
"""Number of columns above which a problem is worked on by itself: fewer are faster in a batch."""

COLUMNS = 2048
"""Columns that are worked on at once."""

CANDIDATES = 256
"""Highest columns among which the peaks for the noise estimate are looked for."""

NARROWER = 0.8
"""Share of columns that still have power below which the others are left out."""

FLOOR = 1e-9
"""Smallest noise variance, as a share of the mean energy of a sensor."""


class Spectrum(NamedTuple):
    """Powers over the grid.

    Attributes:
        power: `(*batch, C)` gamma, squared units of the measurement.
        noise: `(*batch, I)` eta, likewise.
        iterations: `(*batch,)` int64, how many it took.
    """

    power: Tensor
    noise: Tensor
    iterations: Tensor


class Active(NamedTuple):
    """The columns of S problems that are still in.

    Attributes:
        column: `(S, n)` int64, index into the grid.
        response: `(S, I, n, M)` complex, zero at missing sensors.
        power: `(S, n)`; zero for columns that are only there to fill up.
        noise: `(S, I)`.
        iterations: `(S,)` int64.
        done: `(S,)` bool.
    """

    column: Tensor
    response: Tensor
    power: Tensor
    noise: Tensor
    iterations: Tensor
    done: Tensor


def sparse_spectrum(response: Tensor, measurement: Measurement, layout: Grid, config: SblConfig) -> Spectrum:
    """Powers of all columns that maximise the evidence, from the beamformer's as a start.

    Args:
        response: `(I, C, M)` complex dictionary, or `(B, I, C, M)` for the leading dimension of the batch.
        measurement: statistics, batch `(*batch,)`.
        layout: of the cells.
        config: settings.

    Raises:
        NumericalError: where a covariance is not positive definite.
    """
    batch = measurement.num_snapshots.shape[:-1]
    active = converge(response, flatten(measurement), layout, config)
    parts = (spread(active, response.shape[-2]), active.noise, active.iterations)
    return Spectrum(*(t.reshape(batch + t.shape[1:]) for t in parts))


def converge(response: Tensor, measurement: Measurement, layout: Grid, config: SblConfig) -> Active:
    """Columns with power in S problems, batch `(S,)`."""
    dictionaries = response.reshape(-1, *response.shape[-3:])
    problems, alone = len(measurement.num_snapshots), []
    for index in range(problems):
        own = dictionaries[index * len(dictionaries) // problems]
        part = Measurement(*(t[index : index + 1] for t in measurement))
        alone.append(_iterate(_start(own[None], part), part, layout, config, ALONE))
    return _iterate(_stack(alone), measurement, layout, config, 0)


def flatten(measurement: Measurement) -> Measurement:
    """Batch `(*batch,)` to `(S,)`."""
    dims = measurement.num_snapshots.ndim - 1
    return Measurement(*(t.reshape(-1, *t.shape[dims:]) for t in measurement))


def spread(active: Active, num_cells: int) -> Tensor:
    """Powers over the whole grid, `(S, C)`."""
    power = active.power.new_zeros(len(active.power), num_cells)
    return power.scatter_add(-1, active.column, active.power)


def _start(response: Tensor, measurement: Measurement) -> Active:
    """All columns with the powers of the conventional beamformer, averaged over the tones with data."""
    sensors = measurement.present[..., None, :]
    if not bool(sensors.all()):
        response = response * sensors
    output = (response.conj() @ measurement.factor).abs().square().sum(-1)
    norm = torch.linalg.vector_norm(response, dim=-1).square()
    tiny = torch.finfo(norm.dtype).tiny
    J = measurement.num_snapshots[..., None]
    observed = (J > 0).to(norm.dtype)
    power = (output / (J * norm.square()).clamp_min(tiny) * observed).sum(-2) / observed.sum(-2).clamp_min(
        1.0
    )
    column = torch.arange(power.shape[-1], device=power.device).expand(power.shape)
    count = torch.zeros_like(column[..., 0])
    return Active(column, response, power, torch.zeros_like(observed[..., 0]), count, count > 0)


def _iterate(
    active: Active,
    measurement: Measurement,
    layout: Grid,
    config: SblConfig,
    most_columns: int,
) -> Active:
    """Update until all problems are done, or no more columns than `most_columns` are left."""
    while not bool(active.done.all()) and active.column.shape[-1] > most_columns:
        noise = _noise(active, measurement, layout, config.sources)
        power = update(active.power, active.response, noise, measurement)
        top = power.amax(-1, keepdim=True)
        power = torch.where(power < config.prune * top, 0.0, power)
        total = power.sum(-1)
        change = (power - active.power).abs().sum(-1)
        count = active.iterations + 1
        settled = (change <= config.tolerance * total) & (count >= config.min_iterations)
        going = ~active.done
        active = active._replace(
            power=torch.where(going[..., None], power, active.power),
            noise=torch.where(going[..., None], noise, active.noise),
            iterations=torch.where(going, count, active.iterations),
            done=active.done | settled | (count >= config.max_iterations),
        )
        active = _narrow(active)
    return active


def update(power: Tensor, response: Tensor, noise: Tensor, measurement: Measurement) -> Tensor:
    """The fixed-point update of the powers.

    Args:
        power: `(*batch, n)` gamma.
        response: `(*batch, I, n, M)` complex columns.
        noise: `(*batch, I)` eta > 0.
        measurement: statistics, batch `(*batch,)`.

    Raises:
        NumericalError: where a covariance is not positive definite.
    """
    # A few columns at a time: temporaries that leave the cache cost more than the arithmetic.
    parts = response.split(COLUMNS, -2)
    signal = sum(map(weighted_moment, parts, power.split(COLUMNS, -1)))
    assert isinstance(signal, Tensor)
    whitener = whiten(measurement, mask_covariance(signal, noise, measurement.present))
    s, q = (torch.cat(t, -1) for t in zip(*(statistics(whitener, part) for part in parts), strict=True))
    J = measurement.num_snapshots[..., None]
    observed = (J > 0).to(s.dtype)
    tiny = torch.finfo(s.dtype).tiny
    return power * (q / J.clamp_min(1.0) * observed).sum(-2) / (s * observed).sum(-2).clamp_min(tiny)


def _noise(active: Active, measurement: Measurement, layout: Grid, sources: int) -> Tensor:
    """`tr[(I - A A^+) S] / (J (M - K))` with the columns A of the K strongest peaks, `(S, I)`."""
    index, present = _strongest_peaks(active.column, active.power, layout, sources)
    peak = index[..., None, :, None].expand(-1, active.response.shape[1], -1, active.response.shape[-1])
    response = active.response.gather(-2, peak).transpose(-3, -2)
    noise = describe(response, response.real[..., 0, :1], present, measurement).noise
    # Data without noise would leave nothing, and a tone without data has no variance at all.
    floor = FLOOR * measurement.energy / measurement.present.sum(-1).clamp_min(1.0)
    return torch.where(measurement.num_snapshots > 0, torch.maximum(noise, floor), 1.0)


def _strongest_peaks(column: Tensor, power: Tensor, layout: Grid, number: int) -> tuple[Tensor, Tensor]:
    """The strongest local maxima among the highest of the active columns.

    Returns:
        Index into the active columns `(S, K)` int64, and whether it is present, `(S, K)` bool, K <= `number`.
    """
    height, index = power.topk(min(CANDIDATES, power.shape[-1]))
    cell = torch.stack(torch.unravel_index(column.gather(-1, index), layout.shape), -1)
    adjacent = (layout.apart(cell.unsqueeze(-2) - cell.unsqueeze(-3)).abs() <= 1).all(-1)
    # Sorted by height: a column with a neighbour before it is on a slope.
    slope = adjacent.tril(-1).any(-1) | (height <= 0)
    order = slope.to(torch.int8).argsort(dim=-1, stable=True)[..., :number]
    return index.gather(-1, order), ~slope.gather(-1, order)


def _narrow(active: Active) -> Active:
    """Leave out columns without power, once enough of them are."""
    needed = max(int((active.power > 0).sum(-1).max()), 1)
    if needed > NARROWER * active.power.shape[-1]:
        return active
    power, index = active.power.topk(needed)
    chosen = index[..., None, :, None].expand(-1, active.response.shape[1], -1, active.response.shape[-1])
    return active._replace(
        column=active.column.gather(-1, index), response=active.response.gather(-2, chosen), power=power
    )


def _stack(problems: Sequence[Active]) -> Active:
    """Problems of batch one as one batch, filled up with powerless columns."""
    most = max(problem.column.shape[-1] for problem in problems)
    padded = []
    for problem in problems:
        missing = most - problem.column.shape[-1]
        padded.append(
            problem._replace(
                column=pad(problem.column, (0, missing)),
                response=pad(problem.response, (0, 0, 0, missing)),
                power=pad(problem.power, (0, missing)),
            )
        )
    return Active(*(torch.cat(parts) for parts in zip(*padded, strict=True)))
