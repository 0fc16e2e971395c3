"""Tracking in coloured noise is tracking in white noise with the whitened array.

The estimates are the same, and the evidence differs by the Jacobian of whitening, `J log|N|` for each tone,
N of the sensors that are there. Without interferers: the price of a free signature is in terms of the energy
received at a sensor, which whitening changes.
"""

import pytest
import torch
from oracles.arrays import random_covariance
from oracles.line_array import SMALL, make_field, make_region, simulate
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.field.base import BaseField
from torchdt.filter.bp.evidence import GaussianEvidence
from torchdt.filter.bp.schedule import Flooding
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.interference.settings import NoInterference
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.model.measurement import from_snapshots
from torchdt.model.model import Model
from torchdt.model.noise.coloured import ColouredNoise
from torchdt.model.prior import Priors

F64 = torch.float64
TONES, SENSORS, STEPS = 2, 8, 4
NOISE = ColouredNoise(matrix=random_covariance(torch.Generator().manual_seed(3), TONES, sensors=SENSORS))
PRIORS = Priors(*(torch.full((1, TONES), limit, dtype=F64) for limit in (8.0, 0.2)))
ONE = (((0.0, 5.0), (20.0, 12.0)),)


class Array(BaseField):
    """The line array behind a linear map of its sensors, `(I, K, M)`; a tenth of the energy goes anywhere."""

    num_tones, num_coordinates = TONES, 1

    def __init__(self, mapping: Tensor, share: float):
        self.mapping, self.share, self.field = mapping, share, make_field()
        self.num_sensors = mapping.shape[-2]

    def __call__(self, state: Tensor) -> Tensor:
        return (self.mapping @ self.field(state)[..., None]).squeeze(-1)

    def diffuse(self, state: Tensor) -> Tensor | None:
        if not self.share:
            return None
        covariance = self.share / SENSORS * self.mapping @ self.mapping.mH
        return covariance.expand(*state.shape[:-1], *covariance.shape)


def track(mapping: Tensor, snapshots: Tensor, model: Model, share: float, config: dict) -> TrackHistory:
    settings = TrackerConfig(**(SMALL | config), interference=NoInterference())
    tracker = DirectTracker(Array(mapping, share), make_region(), 1.0, settings, model)
    streams = RandomStreams.from_seeds([7], (1,), F64)
    with torch.inference_mode():
        return tracker.run(from_snapshots(snapshots[None]), PRIORS, streams)


@pytest.mark.parametrize(
    ("missing", "share", "config"),
    [
        ([], 0.0, {}),
        ([1, 6], 0.0, {}),
        ([1, 6], 0.1, {}),
        ([1, 6], 0.1, {"schedule": Flooding(), "evidence": GaussianEvidence()}),
        ([1, 6], 0.0, {"proposal": AsPredicted()}),
    ],
)
def test_tracks_are_those_of_white_noise_on_whitened_data(missing, share, config):
    kept = [m for m in range(SENSORS) if m not in missing]
    # The array hears objects and noise through the same filter.
    colouring = torch.linalg.cholesky(NOISE.matrix)
    snapshots = (colouring @ simulate(1, *ONE, steps=STEPS, snr_db=15.0)[0].mT).mT
    some = torch.eye(SENSORS, dtype=torch.complex128)[kept]
    lower = torch.linalg.cholesky(some @ NOISE.matrix @ some.mH)
    whitening = torch.linalg.inv(lower) @ some
    broken = snapshots.clone()
    broken[..., missing] = torch.nan
    found = track(colouring, broken, Model(noise=NOISE), share, config)
    expected = track(whitening @ colouring, (whitening @ snapshots.mT).mT, Model(), share, config)
    jacobian = 2 * snapshots.shape[-2] * lower.diagonal(dim1=-2, dim2=-1).real.log().sum()
    torch.testing.assert_close(found.log_evidence + jacobian, expected.log_evidence, rtol=1e-6, atol=1e-6)
    assert expected.declared[0, -1].any()
    for name in ("existence", "declared", "label", "state", "power", "noise"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-6)


def test_the_colour_counts():
    """White noise on the same data is another model: the evidence of the right one is larger."""
    snapshots = (torch.linalg.cholesky(NOISE.matrix) @ simulate(2, steps=STEPS)[0].mT).mT
    eye = torch.eye(SENSORS, dtype=torch.complex128).expand(TONES, -1, -1)
    coloured, white = (track(eye, snapshots, Model(noise=n), 0.0, {}) for n in (NOISE, Model().noise))
    assert (coloured.log_evidence - white.log_evidence).sum() > 10


def test_a_matrix_of_another_array_is_refused():
    model = Model(noise=ColouredNoise(matrix=torch.eye(SENSORS + 1)))
    with pytest.raises(InputError, match=r"'model.noise.matrix': found shape \(9, 9\), expected \(2, 8, 8\)"):
        DirectTracker(make_field(), make_region(), 1.0, TrackerConfig(**SMALL), model)
