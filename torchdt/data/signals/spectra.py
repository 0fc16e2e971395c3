"""Snapshots of tones from the signals of an array: windowed Fourier transforms, one bin for all sensors."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import torch
from numpy.typing import NDArray
from torch import Tensor

from torchdt.core.errors import require


def tone_snapshots(
    blocks: Iterable[Tensor | NDArray],
    sample_rate: float,
    freqs: Sequence[float],
    *,
    window_length: int,
    hop: int,
    snapshots_per_step: int,
    search_hz: float,
) -> Tensor:
    """Hann-windowed Fourier transforms of the signals, read off at the tones.

    `z_m = 2 / sum(w) * sum_t w_t p_m(t) exp(-i 2 pi b t / window_length)` with the tone's bin b: a cosine in
    the middle of a bin gives its amplitude and its phase at the start of the window, as the time factor
    `exp(+i 2 pi f t)` of the fields has it. White noise of variance v gives `4 v sum(w^2) / sum(w)^2`.

    The bin of a tone is the one with the largest energy, summed over sensors and snapshots of a step, within
    the search around its nominal frequency. All sensors share it, since phases compare only within a bin. It
    is chosen per step, because a moving source shifts its tones (by a bin of 0.37 Hz at 388 Hz for each
    1.4 m/s), and because nothing but the step at hand need be held then.

    Args:
        blocks: consecutive pieces `(M, samples)`, tensors or arrays of the signals; NaN is missing, and so
            are the snapshots of a sensor whose window holds one.
        sample_rate: Hz.
        freqs: `(I,)` Hz.
        window_length: samples of each transform.
        hop: samples from one window to the next, up to `window_length`.
        snapshots_per_step: J, consecutive windows of a step. A step lasts `J * hop / sample_rate` s.
        search_hz: a tone is looked for this far on both sides, Hz; at least the nearest bin is.

    Returns:
        `(K, I, J, M)` complex, in the complex type of the blocks: all steps whose windows are complete.
        What it is does not depend on how the signals are cut into blocks.

    Raises:
        InputError: where sizes make no sense, a tone with its search is not between zero and the Nyquist
            frequency, searches overlap, samples are infinite, or there are too few for one step.
    """
    for name, value, holds, expected in (
        ("window_length", window_length, window_length >= 4, "4 samples or more"),
        ("hop", hop, 1 <= hop <= window_length, f"from 1 to the window_length {window_length}"),
        ("snapshots_per_step", snapshots_per_step, snapshots_per_step >= 1, "a positive integer"),
        ("search_hz", search_hz, 0 <= search_hz < math.inf, "a number from 0 up"),
        ("sample_rate", sample_rate, 0 < sample_rate < math.inf, "a positive number"),
    ):
        require(holds, f"data.{name}", value, expected)
    searches = _searches(freqs, sample_rate, window_length, search_hz)
    length = samples_of_step(window_length, hop, snapshots_per_step)
    steps = []
    for signal in _spans(blocks, length, snapshots_per_step * hop):
        require(not signal.isinf().any(), "data.path", "infinite samples", "finite ones, or NaN for missing")
        steps.append(_snapshots_of_step(signal, window_length, hop, searches))
    require(len(steps) > 0, "data.path", "too few samples for a step", f"{length} or more")
    return torch.stack(steps)


def samples_of_step(window_length: int, hop: int, snapshots_per_step: int) -> int:
    """Samples from the start of the first window of a step to the end of its last."""
    return (snapshots_per_step - 1) * hop + window_length


def _searches(
    freqs: Sequence[float], sample_rate: float, window_length: int, search_hz: float
) -> list[slice]:
    """The bins in which each tone is looked for."""
    width, searches = sample_rate / window_length, list[slice]()
    for freq in freqs:
        nearest = round(freq / width)
        first = min(nearest, math.ceil((freq - search_hz) / width))
        last = max(nearest, math.floor((freq + search_hz) / width))
        found = f"{freq} Hz and a search of {search_hz} Hz"
        expected = f"less than the Nyquist frequency {sample_rate / 2} Hz"
        require(last < window_length / 2, "field.freqs", found, expected)
        require(first > 0, "data.search_hz", search_hz, f"less, which keeps {freq} Hz above the first bin")
        searches.append(slice(first, last + 1))
    ordered = sorted(searches, key=lambda s: s.start)
    for one, other in pairwise(ordered):
        require(one.stop <= other.start, "data.search_hz", search_hz, "less than half the way between tones")
    return searches


def _spans(blocks: Iterable[Tensor | NDArray], length: int, advance: int) -> Iterator[Tensor]:
    """Pieces `(M, length)` of the signals, each `advance` samples after the last."""
    held: Tensor | None = None
    for block in map(torch.as_tensor, blocks):
        held = block if held is None else torch.cat([held, block], -1)
        while held.shape[-1] >= length:
            yield held[:, :length]
            held = held[:, advance:]


def _snapshots_of_step(signal: Tensor, window_length: int, hop: int, searches: Sequence[slice]) -> Tensor:
    """Snapshots `(I, J, M)` of the signals `(M, samples)` of one step."""
    window = torch.hann_window(window_length, dtype=signal.dtype, device=signal.device)
    spectrum = torch.fft.rfft(signal.unfold(-1, window_length, hop) * (2 / window.sum() * window))
    tones = []
    for search in searches:
        candidates = spectrum[..., search]
        energy = candidates.abs().square().nansum((0, 1))
        tones.append(candidates[..., energy.argmax()].mT)
    return torch.stack(tones)
