"""Signals of an array in time, and a writer of SIO files, independent of the library."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def plane_wave_signals(
    bearings_deg: NDArray,
    positions: Sequence[float],
    freqs: Sequence[float],
    sample_rate: float,
    generator: np.random.Generator,
    noise: float,
) -> NDArray:
    """Cosines of amplitude 1 that reach each sensor early by its place, in white noise; (channels, samples).

    A wave from a positive bearing is heard first by the sensor of the largest position. The bearing may
    change from sample to sample.
    """
    early = np.outer(positions, np.sin(np.radians(bearings_deg))) / 1500.0
    time = np.arange(len(bearings_deg)) / sample_rate + early
    signal = sum(np.cos(2 * np.pi * f * time + generator.uniform(0, 2 * np.pi)) for f in freqs)
    return signal + noise * generator.standard_normal(signal.shape)


def write_sio(
    path: Path,
    samples: NDArray,
    record_bytes: int = 512,
    order: str = ">",
    header: Mapping[str, int] | None = None,
) -> None:
    """A file as sioread.m reads it, int16 or float32 as the samples are; the last records are filled up.

    `header` replaces some of the true values.
    """
    width = 2 if samples.dtype.kind == "i" else 4
    per_record = record_bytes // width
    channels, number = samples.shape
    rounds = -(-number // per_record)
    true = {
        "id": 1,
        "records": 1 + rounds * channels,
        "record_bytes": record_bytes,
        "channels": channels,
        "sample_bytes": width,
        "real": int(width == 4),
        "samples": number,
        "mark": 32677,
    }
    head = struct.pack(
        f"{order}8i24s72s", *(true | dict(header or {})).values(), b"test.sio", b"written by a test"
    )
    padded = np.zeros((channels, rounds * per_record), f"{order}{'i2' if width == 2 else 'f4'}")
    padded[:, :number] = samples
    with path.open("wb") as file:
        file.write(head.ljust(record_bytes, b"\0"))
        for start in range(0, rounds * per_record, per_record):
            for channel in padded:
                file.write(channel[start : start + per_record].tobytes())
