"""Which way positive points: signals by their delays, to spectra, to tracks, in every field."""

import numpy as np
import pytest
import torch
from oracles.line_array import SMALL
from oracles.waveguide import DEPTHS, WATER
from oracles.waveguide import FREQS as TONES

from torchdt.data.recording import validate
from torchdt.data.signals.spectra import tone_snapshots
from torchdt.field import LineArrayField, NormalModeField, PlaneWaveField, SphericalWaveField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.region import Coordinate, Region
from torchdt.run.track import track

F64 = torch.float64
SPEED, RATE, FREQ = 1500.0, 1024.0, 128.0
LINE = [4.0 * m for m in range(8)]
ELL = [*([x, 0.0, 0.0] for x in LINE), *([0.0, y, 0.0] for y in LINE[1:4])]
RATES = {"rate_low": -1.0, "rate_high": 1.0, "driving_variance": 1e-3}
ANGLE = {"name": "bearing", "unit": "deg", "cell": 4.0, **RATES}
METRES = {"unit": "m", "low": -60.0, "high": 60.0, "cell": 8.0, **RATES}
FAR = 1e7

# Field, region, where the object is, and the point that sends the waves.
CASES = {
    "line_array": (
        lambda sign: LineArrayField([FREQ], LINE, SPEED, sign=sign, dtype=F64),
        [Coordinate(low=-70, high=70, **ANGLE)],
        [30.0],
        FAR * np.array([np.sin(np.deg2rad(30)), np.cos(np.deg2rad(30)), 0]),
    ),
    "plane_wave": (
        lambda sign: PlaneWaveField([FREQ], ELL, SPEED, "bearing", sign=sign, dtype=F64),
        [Coordinate(low=0, high=360, **ANGLE)],
        [120.0],
        FAR * np.array([np.sin(np.deg2rad(120)), np.cos(np.deg2rad(120)), 0]),
    ),
    "spherical_wave": (
        lambda sign: SphericalWaveField([FREQ], ELL, SPEED, sign=sign, dtype=F64),
        [Coordinate(name=name, **METRES) for name in ("x", "y")],
        [25.0, -30.0],
        np.array([25.0, -30.0, 0.0]),
    ),
}


def recorded(places: list[list[float]], source: np.ndarray) -> torch.Tensor:
    """Snapshots of a tone that reaches each sensor later and weaker by its distance, in weak noise."""
    rng = np.random.default_rng(0)
    distance = np.linalg.norm(np.array(places) - source, axis=-1)
    later = (distance - distance.min()) / SPEED
    time = np.arange(6 * 512) / RATE
    signals = (distance.min() / distance * np.cos(2 * np.pi * FREQ * (time[:, None] - later))).T
    signals += 0.1 * rng.standard_normal(signals.shape)
    window = {"window_length": 256, "hop": 256, "snapshots_per_step": 2, "search_hz": 0.0}
    return torch.as_tensor(tone_snapshots([signals], RATE, [FREQ], **window))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", CASES)
def test_objects_are_tracked_on_their_side(name, sign):
    """Signals know nothing of fields but the delays; the mirrored place is 20 cells or more away."""
    make, coordinates, place, source = CASES[name]
    snapshots = recorded([[x, 0.0, 0.0] for x in LINE] if name == "line_array" else ELL, source)
    recording = validate(snapshots=snapshots if sign == 1 else snapshots.conj(), step_s=0.5)
    region = Region(coordinates, F64)
    history = track(recording, DirectTracker(make(sign), region, 0.5, TrackerConfig(**SMALL)), seeds=[0])
    declared = history.declared[0, -1]
    assert declared.sum() == 1
    found = history.position[0, -1][declared][0]
    assert ((found - torch.tensor(place, dtype=F64)).abs() < region.cell).all()


def test_sign_in_a_waveguide():
    """A metre further away the wave, of 30 m at 49 Hz, arrives later by 12 degrees: with sign +1 the phase
    falls by that, and sign -1 is the conjugate."""
    field, other = (
        NormalModeField(WATER, TONES[:1], DEPTHS, normalize=False, sign=sign, dtype=F64) for sign in (1, -1)
    )
    state = torch.tensor([[2000.0, 40.0], [2001.0, 40.0]], dtype=F64)
    nearer, further = field(state)
    turn = torch.rad2deg((further * nearer.conj()).angle())
    assert ((turn < -9) & (turn > -15)).all()
    torch.testing.assert_close(other(state), field(state).conj().resolve_conj())
    torch.testing.assert_close(other.incoherent(state), field.incoherent(state).conj().resolve_conj())
