"""From a recording in any units to tracks in the same units."""

import pytest
import torch
from oracles.arrays import sample_covariance
from oracles.line_array import FREQS, POSITIONS, make_tracker, simulate

from torchdt.core.errors import InputError
from torchdt.core.linalg import NumericalError
from torchdt.data.prepare import Prepared, prepare
from torchdt.data.recording import Recording, validate
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.interference.settings import NoInterference
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.run.chunks import bytes_per_sequence
from torchdt.run.track import derive_seed, generator, track

pytestmark = pytest.mark.slow
SEEDS, SPEEDS, POISON = [7, 8, 9, 10, 11], (1500.0, 1480.0, 1520.0, 1500.0, 1490.0), 1234.5
TWO = (((0.0, -40.0), (20.0, -25.0)), ((0.0, 30.0), (20.0, 20.0)))


@pytest.fixture(scope="module")
def snapshots() -> torch.Tensor:
    return torch.stack([simulate(seed, *TWO, steps=8)[0] for seed in (1, 2)])


def record(snapshots: torch.Tensor) -> Recording:
    return validate(step_s=1.0, snapshots=snapshots)


def scaled_to_one(recording: Recording, tracker: DirectTracker) -> Prepared:
    return prepare(recording, tracker.field, tracker.region, tracker.config)


def assert_same_tracks(found: TrackHistory, expected: TrackHistory, **tolerance) -> None:
    assert torch.equal(found.declared, expected.declared)
    alive = expected.existence > 0
    assert torch.equal(found.label[alive], expected.label[alive])
    torch.testing.assert_close(found.existence, expected.existence, **tolerance)
    torch.testing.assert_close(found.state[alive], expected.state[alive], **tolerance)


@pytest.fixture(scope="module")
def one(snapshots) -> TrackHistory:
    return track(record(snapshots), make_tracker(), [1, 2])


@pytest.mark.parametrize("unit", [1e-20, 7.3, 1e20])
def test_units_change_nothing_but_the_units(snapshots, one, unit):
    other = track(record(unit * snapshots), make_tracker(), [1, 2])
    assert one.declared[:, -1].sum() == 4
    assert_same_tracks(other, one, rtol=1e-6, atol=1e-6)
    alive = one.existence > 0
    torch.testing.assert_close(other.power[alive] / unit**2, one.power[alive], rtol=1e-6, atol=0)
    torch.testing.assert_close(other.noise / unit**2, one.noise, rtol=1e-6, atol=0)
    # A density: 2 tones, 3 snapshots, 8 sensors of complex numbers.
    jacobian = 2 * 2 * 3 * 8 * torch.tensor(unit).double().log()
    torch.testing.assert_close(other.log_evidence + jacobian, one.log_evidence, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("unit", [1e25, 1e-25, 1e140])
def test_units_in_single_precision(snapshots, unit):
    """Powers in squared units, which single precision does not hold, are in double."""
    tracker = make_tracker(torch.float32)
    data = snapshots[:, :6].to(torch.complex128)
    one, other = (track(record(u * data), tracker, [1, 2]) for u in (1.0, unit))
    assert_same_tracks(other, one, rtol=2e-3, atol=2e-3)
    alive = one.declared
    assert alive.any()
    for name, found, expected in zip(
        ("power", "noise"), (other.power[alive], other.noise), (one.power[alive], one.noise), strict=True
    ):
        assert found.dtype == torch.float64, name
        torch.testing.assert_close(found / unit**2, expected, rtol=2e-3, atol=0)


@pytest.mark.parametrize("unit", [1e200, 1e-200])
def test_units_whose_powers_are_no_numbers_are_named(snapshots, unit):
    data = unit * snapshots[:, :2].to(torch.complex128)
    with pytest.raises(
        InputError, match=r"key 'snapshots': found a root mean square of .*e[+-](199|200|201), "
    ):
        track(record(data), make_tracker(), [1, 2])


@pytest.mark.parametrize("name", ["power_max", "noise_max"])
@pytest.mark.parametrize("limit", [1e60, 1e-60])
def test_limits_far_from_the_data_are_named(snapshots, name, limit):
    tracker = make_tracker(torch.float32, **{name: limit})
    with pytest.raises(InputError, match=rf"key 'tracker.{name}': found 1e.60, expected a number within"):
        track(record(snapshots), tracker, [1, 2])


def test_limits_of_the_priors_are_in_units_of_the_data(snapshots):
    unit = 50.0
    one = track(record(snapshots), make_tracker(power_max=9.0, noise_max=0.5), [1, 2])
    scaled = make_tracker(power_max=9.0 * unit**2, noise_max=0.5 * unit**2)
    other = track(record(unit * snapshots), scaled, [1, 2])
    assert_same_tracks(other, one, rtol=1e-6, atol=1e-6)
    prepared = scaled_to_one(record(unit * snapshots), scaled)
    limit = prepared.priors.power_max * prepared.scale[:, None] ** 2
    torch.testing.assert_close(limit, torch.full_like(limit, 9.0 * unit**2))


@pytest.mark.parametrize(("dtype", "unit"), [(torch.float64, 3e4), (torch.float32, 1.0)])
def test_covariances_say_the_same_as_their_snapshots(snapshots, dtype, unit):
    tracker = make_tracker(dtype)
    covariance = unit**2 * sample_covariance(snapshots)
    one = track(record(unit * snapshots), tracker, [1, 2])
    other = track(validate(step_s=1.0, covariance=covariance, num_snapshots=3), tracker, [1, 2])
    tolerance = 1e-5 if dtype == torch.float64 else 5e-3
    assert_same_tracks(other, one, rtol=tolerance, atol=tolerance)
    torch.testing.assert_close(other.noise, one.noise, rtol=tolerance, atol=0)
    prepared = scaled_to_one(validate(step_s=1.0, covariance=covariance, num_snapshots=3), tracker)
    assert 0.1 < prepared.measurement.energy.mean() / 8 < 10  # brought to order one


def test_precision_of_the_recording_hardly_matters(snapshots):
    tracker = make_tracker(torch.float32)
    types = (torch.complex64, torch.complex128)
    one, other = (track(record(snapshots.to(t)), tracker, [1, 2]) for t in types)
    assert_same_tracks(one, other, rtol=2e-3, atol=2e-3)


def test_each_sequence_has_its_own_scale(snapshots):
    """A loud recording beside a quiet one changes neither."""
    uneven = snapshots * torch.tensor([1e-6, 1e6])[:, None, None, None, None]
    together = track(record(uneven), make_tracker(), [1, 2])
    for b in range(2):
        alone = track(record(uneven[b : b + 1]), make_tracker(), [b + 1])
        assert_same_tracks(TrackHistory(*(t[b : b + 1] for t in together)), alone, rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(together.noise[b], alone.noise[0], rtol=1e-6, atol=0)


def test_a_dead_recording_beside_a_good_one(snapshots):
    broken = snapshots.clone()
    broken[1] = torch.nan
    history = track(record(broken), make_tracker(), [1, 2])
    alone = track(record(snapshots[:1]), make_tracker(), [1])
    assert_same_tracks(TrackHistory(*(t[:1] for t in history)), alone, rtol=1e-6, atol=1e-6)
    assert not history.declared[1].any()


@pytest.mark.parametrize(
    ("cut", "message"),
    [
        ((slice(None), slice(0, 1)), "key 'snapshots': found 1 tones, expected 2 tones, as the field has"),
        ((slice(None), slice(None), slice(None), slice(0, 7)), "found 7 sensors, expected 8 sensors"),
    ],
)
def test_a_recording_of_another_array_is_named(snapshots, cut, message):
    with pytest.raises(InputError, match=message):
        track(record(snapshots[(slice(None), *cut)]), make_tracker(), [1, 2])


def test_zeros_are_named(snapshots):
    with pytest.raises(InputError, match="key 'snapshots': found only zeros"):
        track(record(0 * snapshots), make_tracker(), [1, 2])


def test_wrong_number_of_seeds_is_named(snapshots):
    for seeds in ([1], [1, 2, 3]):
        with pytest.raises(InputError, match=f"key 'seeds': found {len(seeds)}, expected 2, one for each"):
            track(record(snapshots), make_tracker(), seeds)


@pytest.fixture(scope="module")
def five() -> Recording:
    """Short sequences of which no two are alike, in units of their own."""
    sequences = [simulate(seed, *TWO[:count], steps=6)[0] for seed, count in enumerate((2, 0, 1, 2, 1))]
    return record(torch.stack(sequences) * torch.logspace(-3, 3, 5)[:, None, None, None, None])


@pytest.fixture(scope="module")
def own_fields() -> StackedField:
    return StackedField([LineArrayField(FREQS, POSITIONS, c, dtype=torch.float64) for c in SPEEDS])


def gigabytes(tracker: DirectTracker, recording: Recording, sequences: int) -> float:
    """Memory for so many sequences."""
    return (sequences + 0.5) * bytes_per_sequence(tracker, recording) / 1e9


@pytest.mark.parametrize(
    ("at_once", "workers", "fields", "dtype"),
    [
        (1, 1, "shared", torch.float64),
        (2, 1, "own", torch.float64),
        (4, 2, "own", torch.float32),
        (5, 3, "shared", torch.float32),
    ],
)
def test_neither_chunks_nor_workers_change_the_tracks(five, at_once, workers, fields, dtype):
    tracker = make_tracker(dtype)
    if fields == "own":
        stack = StackedField([LineArrayField(FREQS, POSITIONS, c, dtype=dtype) for c in SPEEDS])
        tracker = DirectTracker(stack, tracker.region, 1.0, tracker.config)
    whole = track(five, tracker, SEEDS)
    steps = []
    chunked = track(
        five,
        tracker,
        SEEDS,
        lambda step, _, estimate, sequences: steps.append((sequences.start, sequences.stop, step)),
        memory_gb=gigabytes(tracker, five, at_once),
        workers=workers,
    )
    assert len({start for start, _, _ in steps}) >= 2
    counted = [(b, step) for start, stop, step in steps for b in range(start, stop)]
    assert sorted(counted) == [(b, step) for b in range(5) for step in range(6)]
    tolerance = 1e-6 if dtype == torch.float64 else 2e-3
    assert_same_tracks(chunked, whole, rtol=tolerance, atol=tolerance)
    torch.testing.assert_close(chunked.log_evidence, whole.log_evidence, rtol=tolerance, atol=1e-3)
    torch.testing.assert_close(chunked.noise, whole.noise, rtol=tolerance, atol=0)


def test_sequences_keep_numbers_and_fields_of_their_own(five, own_fields):
    """The third of five, in a chunk of its own, beside the same sequence alone."""
    tracker = make_tracker()
    survival = torch.tensor([0.5, 0.6, 0.7, 0.8, 0.9], dtype=torch.float64)
    model = tracker.model.with_numbers({"survival": survival})
    stacked = DirectTracker(own_fields, tracker.region, 1.0, tracker.config, model)
    history = track(five, stacked, SEEDS, memory_gb=gigabytes(stacked, five, 1))
    one = DirectTracker(
        own_fields.fields[2],
        tracker.region,
        1.0,
        tracker.config,
        model.with_numbers({"survival": survival[2]}),
    )
    alone = track(five.select(slice(2, 3)), one, SEEDS[2:3])
    found = TrackHistory(*(t[2:3] for t in history))
    assert_same_tracks(found, alone, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(found.log_evidence, alone.log_evidence, rtol=1e-6, atol=1e-6)
    other = track(five.select(slice(2, 3)), one.with_model(tracker.model), SEEDS[2:3])
    assert (other.log_evidence - alone.log_evidence).abs().max() > 1e-3


def test_a_chunk_has_its_own_part_of_the_dictionary_alone(five, own_fields, monkeypatch):
    sizes = []

    def recorded(field, region):
        dictionary = build_dictionary(field, region)
        sizes.append(dictionary.response.shape[0])
        return dictionary

    monkeypatch.setattr("torchdt.filter.tracker.build_dictionary", recorded)
    tracker = DirectTracker(own_fields, make_tracker().region, 1.0, make_tracker().config)
    track(five, tracker, SEEDS, memory_gb=gigabytes(tracker, five, 2))
    assert sizes == [1, 2, 2]
    sizes.clear()
    track(five, make_tracker(), SEEDS, memory_gb=gigabytes(tracker, five, 2))
    assert sizes == [len(FREQS)]  # one for all, without a batch dimension


@pytest.mark.parametrize("workers", [1, 2])
def test_a_breakdown_is_named_by_its_place_in_the_whole_batch(five, workers, caplog):
    class Broken(DirectTracker):
        def step(self, state, measurement, priors, streams):
            if (measurement.factor[:, 0, 0, 0] == POISON).any():
                raise NumericalError("covariance: not positive definite")
            return super().step(state, measurement, priors, streams)

        def prepare(self, recording):
            prepared = super().prepare(recording)
            bad = recording.data[:, 0, 0, 0, 0] == five.data[3, 0, 0, 0, 0]
            prepared.measurement.factor[bad, 2] = POISON
            return prepared

    tracker = Broken(make_tracker().field, make_tracker().region, 1.0, make_tracker().config)
    with caplog.at_level("WARNING", "torchdt"):
        history = track(
            five, tracker, SEEDS, memory_gb=gigabytes(tracker, five, 2 * workers), workers=workers
        )
    assert "sequence 3, step 2 broke down and counts as missing: covariance: not" in caplog.text
    assert history.failed.nonzero().tolist() == [[3, 2]]


def between_extremes(case: str) -> Recording:
    """Two sources without noise for ten steps, and what `case` makes of them."""
    rng = torch.Generator().manual_seed(1)
    field = LineArrayField(FREQS, POSITIONS, 1500.0, dtype=torch.float64)
    at = torch.tensor([[-40.0, 0.0], [25.0, 0.0]], dtype=torch.float64)
    response = field(at).movedim(0, -2)  # I, 2, M

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, dtype=torch.complex128, generator=rng)

    data = normal(10, 2, 3, 2) @ response
    noise = normal(*data.shape)
    if case == "60 dB":
        return record((data + 1e-3 * noise)[None])
    if case == "no noise":
        return record(data[None])
    if case == "rank one":
        one = data[:, :, :1]
        return validate(step_s=1.0, covariance=(one.mT @ one.conj())[None], num_snapshots=3)
    data = data + 0.1 * noise
    if case == "a loud step":
        data[6] *= 1e4
    else:
        data[5:] = 0
    return record(data[None])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("case", ["60 dB", "no noise", "rank one", "a loud step", "zeros at the end"])
def test_level_differences_that_the_precision_can_bear(case, dtype):
    """None of them breaks down, and both sources are found where they can be."""
    # Where all is suddenly 80 dB louder, signals of free signature take the place of both objects.
    plain = {"interference": NoInterference()} if case == "a loud step" else {}
    history = track(between_extremes(case), make_tracker(dtype, **plain), [1])
    assert not history.failed.any()
    assert all(part.isfinite().all() for part in history if part.is_floating_point())
    assert history.declared[0, 4].sum() == 2
    if case != "zeros at the end":
        assert history.declared[0, -1].sum() == 2


def test_estimates_are_made_in_inference_mode_and_without_gradient(five):
    modes = []
    track(five, make_tracker(), SEEDS, lambda *_: modes.append(torch.is_inference_mode_enabled()), workers=2)
    assert modes == [True] * 12
    assert not torch.is_inference_mode_enabled()


def test_seeds_of_different_purposes_differ():
    seeds = [derive_seed(s, purpose) for s in range(50) for purpose in ("filter", "scenario", "x")]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= s < 2**63 for s in seeds)
    assert torch.equal(torch.rand(3, generator=generator(1, "a")), torch.rand(3, generator=generator(1, "a")))
