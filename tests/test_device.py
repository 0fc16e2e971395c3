"""Any device and any type: nothing is left to PyTorch's defaults, and results have the type of the region."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.devices import NamedDevices, assert_kind, default_dtype, foreign_defaults
from oracles.line_array import FREQS, POSITIONS, SMALL, SMALL_PAPER, make_region, simulate
from oracles.waveguide import make_field as make_waveguide
from oracles.waveguide import make_region as make_water
from torch import Tensor

from torchdt.baselines.detect.config import PursuitConfig, SblConfig
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.random import RandomStreams
from torchdt.data.recording import Recording, validate
from torchdt.field.mismatch import MismatchedField
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.bp.evidence import GaussianEvidence
from torchdt.filter.bp.schedule import Flooding
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.interference.settings import NoInterference
from torchdt.filter.likelihood import log_likelihood
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.tracker import PaperTracker
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.filter.tracker import Tracker
from torchdt.metrics import gospa
from torchdt.metrics.delays import track_delays
from torchdt.model.measurement import from_snapshots
from torchdt.model.model import Model
from torchdt.model.prior import data_priors
from torchdt.run.track import track

F32, F64 = torch.float32, torch.float64
DTYPES = pytest.mark.parametrize("dtype", [F32, F64])
PATHS = (((0.0, -40.0), (5.0, -38.0)), ((0.0, 30.0), (5.0, 29.0)))
PLACES, TILTS = [(2812.0, 57.0), (2930.0, 41.0)], (0.0, 0.5)
SMALLER = {"particles": 40, "births": 2, "proposal": Adapted(rounds=2, round_size=64)}
# Flooding doubts both of two sources that begin together, and finds one of them only.
FLOODING = {"schedule": Flooding(), "interference": NoInterference()}
DIRECT = {
    "adapted, sequential, sampled": {},
    "adapted, flooding, gaussian": FLOODING | {"evidence": GaussianEvidence()},
    "as predicted, sequential, gaussian": {"proposal": AsPredicted(), "evidence": GaussianEvidence()},
    "as predicted, flooding, sampled": FLOODING | {"proposal": AsPredicted()},
}
DETECTORS = {
    "matching pursuit": PursuitConfig(points=4, threshold=8.0),
    "sparse Bayesian learning": SblConfig(points=4, threshold=8.0, max_iterations=15),
}
TRACKERS = [*DIRECT, "diffuse", "paper", *DETECTORS]


def make_tracker(kind: str, dtype: torch.dtype) -> Tracker[Any]:
    if kind == "diffuse":
        share = torch.full((2,), 0.1, dtype=dtype, device="cpu")
        fields = [MismatchedField(make_waveguide(dtype, tilt=tilt), share) for tilt in TILTS]
        return DirectTracker(StackedField(fields), make_water(dtype), 1.0, TrackerConfig(**SMALL))
    field = LineArrayField(FREQS, POSITIONS, device="cpu", dtype=dtype)
    if kind in DIRECT:
        return DirectTracker(field, make_region(dtype), 1.0, TrackerConfig(**SMALL | DIRECT[kind]))
    if kind == "paper":
        return PaperTracker(field, make_region(dtype), 1.0, PaperConfig(**SMALL_PAPER))
    config = TwoStepConfig(
        slots=4, particles=200, birth_mean=0.1, clutter_mean=0.1, detector=DETECTORS[kind], survival=0.95
    )
    return TwoStepTracker(field, make_region(dtype), 1.0, config)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Two sources, the second silent in the first three of six steps."""
    data, truth = simulate(1, *PATHS, steps=6)
    data[:3] = simulate(2, PATHS[0], steps=6)[0][:3]
    truth[:3, 1] = torch.nan
    return validate(step_s=1.0, snapshots=data[None], truth=truth[None])


@pytest.fixture(scope="module")
def in_water() -> Recording:
    """The same of standing sources in two waveguides, one for each sequence; 20 dB."""
    rng, truth = torch.Generator().manual_seed(3), torch.tensor(PLACES, dtype=F64).repeat(2, 4, 1, 1)
    truth[:, :2, 1] = torch.nan
    response = torch.stack([make_waveguide(F64, tilt=tilt)(truth[0, -1]) for tilt in TILTS])
    amplitude = complex_normal(rng, 2, 4, 2, 3, 2)
    amplitude[:, :2, ..., 1] = 0.0
    data = torch.einsum("bkijn,bnim->bkijm", amplitude, response)
    data = data + 0.1 * response.shape[-1] ** -0.5 * complex_normal(rng, *data.shape)
    return validate(step_s=1.0, snapshots=data, truth=truth)


@pytest.fixture
def data_of(recording, in_water) -> Callable[[str], Recording]:
    return lambda kind: in_water if kind == "diffuse" else recording


def run(kind: str, dtype: torch.dtype, data: Recording) -> tuple[TrackHistory, Any]:
    """History, and what scores it."""
    history = track(data, make_tracker(kind, dtype), range(data.batch_size))
    score = gospa(history.position, history.declared, data.truth, data.truth_mask, 100.0)
    return history, (score, track_delays(history.select(0), data.truth[0], 100.0))


def forgetful() -> dict[str, Callable[[], Tensor]]:
    rng = torch.Generator()
    return {
        "zeros": lambda: torch.zeros(3),
        "tensor": lambda: torch.tensor(1.0, dtype=F64),
        "as_tensor": lambda: torch.as_tensor([1.0]),
        "arange": lambda: torch.arange(3, device=None),
        "randn": lambda: torch.randn(2, generator=rng),
    }


@pytest.mark.parametrize("name", forgetful())
def test_the_trap_names_the_place_of_a_call_without_device(name):
    with (
        NamedDevices(Path(__file__).parent),
        pytest.raises(AssertionError, match=rf"test_device\.py:\d+: {name} names no device"),
    ):
        forgetful()[name]()


def test_the_trap_lets_pass_what_names_its_device_or_takes_it_from_a_tensor():
    there = torch.ones(2)
    with NamedDevices(Path(__file__).parent):
        torch.zeros(3, device="cpu")
        torch.as_tensor(there, dtype=F64)
        there.new_zeros(3), torch.zeros_like(there)
    with NamedDevices(), torch.device("meta"):  # another one's file
        assert torch.zeros(3).is_meta


@DTYPES
@pytest.mark.parametrize("kind", TRACKERS)
def test_defaults_of_pytorch_have_no_part_in_tracking(data_of, kind, dtype):
    """Objects known and newborn, and their scores, are the same to the last bit. All has the type of the
    region but what is in the recording's units, which is double."""
    with default_dtype(dtype):
        expected = run(kind, dtype, data_of(kind))
    with foreign_defaults(dtype):
        found = run(kind, dtype, data_of(kind))
    torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)
    history = found[0]
    counts = history.declared.sum(-1)
    assert counts[:, -1].tolist() == [2] * len(counts)
    assert (counts[:, 0] < 2).all()
    in_units = {name: getattr(history, name) for name in ("power", "noise", "log_evidence")}
    assert {values.dtype for values in in_units.values()} == {F64}
    assert_kind(history._replace(**dict.fromkeys(in_units, history.existence)), dtype)


@DTYPES
@pytest.mark.parametrize("kind", TRACKERS)
def test_a_state_has_the_type_of_the_region(data_of, kind, dtype):
    tracker, data = make_tracker(kind, dtype), data_of(kind)
    prepared = tracker.prepare(data)
    assert prepared.scale.dtype == F64
    assert_kind((prepared.measurement, prepared.priors, tracker.dictionary), dtype)
    streams = RandomStreams.from_seeds(range(data.batch_size), (data.batch_size,), dtype)
    state = tracker.init(prepared.priors)
    assert_kind(state, dtype)
    for step in range(2):
        state, estimate = tracker.step(state, prepared.measurement.at(step), prepared.priors, streams)
        assert_kind((state, estimate), dtype)


def test_both_types_find_the_same():
    """At 30 dB. Random numbers differ, and with them bearings, by 0.004 degrees (standard deviation); the
    tolerance is twelve times that, a fortieth of a cell."""
    easy = validate(step_s=1.0, snapshots=simulate(4, *PATHS, steps=6, snr_db=30.0)[0][None])
    single, double = (track(easy, make_tracker(next(iter(DIRECT)), dtype), [1]) for dtype in (F32, F64))
    found = []
    for history in (single, double):
        order = history.label.argsort(-1, descending=True)[..., :2]
        assert history.declared.gather(-1, order).all()
        found.append(history.position[..., 0].gather(-1, order).double())
    torch.testing.assert_close(*found, rtol=0, atol=0.05)
    assert torch.equal(single.declared.sum(-1), double.declared.sum(-1))


@DTYPES
def test_defaults_of_pytorch_have_no_part_in_the_likelihood_and_its_gradient(in_water, dtype):
    tilt = torch.tensor(0.3, dtype=F64, requires_grad=True)
    measurement = from_snapshots(in_water.snapshots.to(dtype.to_complex()))
    field, config = make_waveguide(dtype, tilt=tilt), TrackerConfig(**SMALL | SMALLER)

    def differentiate() -> tuple[Tensor, ...]:
        region = make_water(dtype)
        model = Model().on(region)
        values = {name: value.requires_grad_() for name, value in model.known().items()}
        tracker = DirectTracker(field, region, 1.0, config, model.with_numbers(values))
        streams = RandomStreams.from_seeds([1, 2], (2,), dtype)
        priors, blocks = data_priors(measurement), {"block": 2, "truncate": 3}
        evidence = log_likelihood(tracker, measurement, priors, streams, **blocks)
        return evidence, *torch.autograd.grad(evidence.sum(), [*values.values(), tilt])

    with default_dtype(dtype):
        expected = differentiate()
    with foreign_defaults(dtype):
        found = differentiate()
    torch.testing.assert_close(found, expected, rtol=0, atol=0)
    assert [t.dtype for t in found] == [dtype] * (len(found) - 1) + [F64]
    assert all(t.ne(0).all() for t in found)
