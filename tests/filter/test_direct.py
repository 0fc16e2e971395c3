"""The tracker on a line array: 8 sensors, 2 tones, bearings."""

import math

import pytest
import torch
from oracles.line_array import FREQS, POSITIONS, make_tracker, simulate

from torchdt.core.random import RandomStreams
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.bp.schedule import Flooding, Sequential
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.model.measurement import from_snapshots
from torchdt.model.prior import data_priors

TWO = (((0.0, -40.0), (20.0, -25.0)), ((0.0, 30.0), (20.0, 20.0)))
ONE = (((0.0, 5.0), (20.0, 12.0)),)


def run(snapshots: torch.Tensor, seeds, dtype=torch.float64, on_step=None, **config) -> TrackHistory:
    """Track (B, K, I, J, M) snapshots of order one."""
    complex_dtype = torch.complex128 if dtype == torch.float64 else torch.complex64
    measurement = from_snapshots(snapshots.to(complex_dtype))
    streams = RandomStreams.from_seeds(seeds, (len(seeds),), dtype)
    with torch.inference_mode():
        return make_tracker(dtype, **config).run(measurement, data_priors(measurement), streams, on_step)


def assert_sound(history: TrackHistory) -> None:
    """What holds for every history, whatever the data."""
    assert ((history.existence >= 0) & (history.existence <= 1)).all()
    for name, values in history._asdict().items():
        assert values.double().isfinite().all(), name
    assert (history.label[history.declared] > 0).all()
    assert (history.power >= 0).all()
    assert (history.noise > 0).all()
    alive = history.existence > 0
    for labels, present in zip(history.label.flatten(0, -2), alive.flatten(0, -2), strict=True):
        named = labels[present & (labels > 0)].tolist()
        assert len(set(named)) == len(named), "one label, one slot"


def labels_near(history: TrackHistory, run_index: int, step: int, bearing: float, within: float = 3.0):
    """Labels of the declared objects around a bearing."""
    declared = history.declared[run_index, step]
    near = (history.position[run_index, step, :, 0] - bearing).abs() < within
    return history.label[run_index, step][declared & near].tolist()


def assert_same(found: TrackHistory, expected: TrackHistory, **tolerance) -> None:
    """Equal estimates of every object; slots without an object hold no information."""
    for name in ("existence", "declared", "noise", "log_evidence"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), **tolerance)
    alive = expected.existence > 0
    for name in ("label", "state", "state_std", "power"):
        torch.testing.assert_close(getattr(found, name)[alive], getattr(expected, name)[alive], **tolerance)


@pytest.fixture(scope="module")
def mixed() -> torch.Tensor:
    """Four sequences: two sources, noise, one source, and a source that falls silent half-way."""
    sequences = [simulate(1, *TWO)[0], simulate(2)[0], simulate(3, *ONE)[0], simulate(4, *ONE)[0]]
    sequences[3][10:] = simulate(5)[0][10:]
    return torch.stack(sequences)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("schedule", [Sequential(), Flooding()])
def test_two_sources_are_found_and_keep_their_labels(dtype, schedule):
    seeds = [1, 2, 3]
    data, truth = zip(*(simulate(s, *TWO) for s in seeds), strict=True)
    history = run(torch.stack(data), seeds, dtype, schedule=schedule)
    assert_sound(history)
    assert history.state.dtype == dtype
    start = 2 if schedule == Sequential() else 5  # flooding takes longer to part two sources
    for b in range(len(seeds)):
        for source in range(2):
            seen = [labels_near(history, b, k, truth[b][k, source, 0].item()) for k in range(start, 20)]
            assert all(len(labels) == 1 for labels in seen), seen
            assert len({label for labels in seen for label in labels}) == 1
        assert history.declared[b, start:].sum(-1).eq(2).all()
        # Unit power each; with c_gamma = 1e4 the first step, of three amplitudes, decides for long.
        power = history.power[b, -1][history.declared[b, -1]]
        assert ((power > 0.2) & (power < 5.0)).all()


def test_particles_drawn_from_the_prior_find_the_sources_too():
    """The paper's proposals need more particles, and find a source within some steps."""
    data, truth = simulate(1, *TWO)
    history = run(data[None], [1], proposal=AsPredicted(), particles=1000)
    assert_sound(history)
    for source in range(2):
        assert labels_near(history, 0, 19, truth[19, source, 0].item(), within=4.0)


def test_estimates_are_as_accurate_as_the_data_allow():
    """Bearing errors beside the prediction of the beamwidth and the SNR: a few tenths of a degree."""
    seeds = list(range(6))
    data, truth = zip(*(simulate(s, *ONE) for s in seeds), strict=True)
    history = run(torch.stack(data), seeds)
    assert history.declared[:, 3:].sum(-1).eq(1).all()
    error = (
        history.position[..., 0][history.declared][:, None]
        - torch.stack(truth)[..., 0][history.declared.any(-1)]
    )
    assert error[:, 0].square().mean().sqrt() < 0.6


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.slow
def test_a_batch_equals_single_runs(mixed, dtype):
    tolerance = {"rtol": 1e-6, "atol": 1e-6} if dtype == torch.float64 else {"rtol": 2e-3, "atol": 2e-3}
    seeds = [5, 6, 7, 8]
    together = run(mixed, seeds, dtype)
    counts = together.declared.sum(-1)
    assert [counts[0, -1], counts[1].max(), counts[2, -1], counts[3, 9], counts[3, -1]] == [2, 0, 1, 1, 0]
    for b, seed in list(enumerate(seeds))[::3]:
        alone = run(mixed[b : b + 1], [seed], dtype)
        assert_same(TrackHistory(*(t[b : b + 1] for t in together)), alone, **tolerance)


@pytest.mark.slow
def test_births_in_some_sequences_of_a_batch_leave_each_as_it_is_alone():
    """In two of three sequences a strong source appears beside a known one, which is then placed again."""
    sequences, seeds = [simulate(seed, *ONE, steps=12)[0] for seed in (11, 12, 13)], [5, 6, 7]
    for b in (0, 2):
        sequences[b][6:] += simulate(20 + b, ((0.0, ONE[0][0][1] + 6.0),), steps=12)[0][6:]
    together = run(torch.stack(sequences), seeds)
    assert together.declared.sum(-1)[:, 5].tolist() == [1, 1, 1]
    assert together.declared.sum(-1)[:, -1].tolist() == [2, 1, 2]
    for b, seed in enumerate(seeds):
        alone = run(sequences[b][None], [seed])
        assert_same(TrackHistory(*(t[b : b + 1] for t in together)), alone, rtol=1e-6, atol=1e-6)


def test_a_batch_of_two_dimensions(mixed):
    mixed = mixed[:, :6]
    flat = run(mixed, [1, 2, 3, 4])
    measurement = from_snapshots(mixed.reshape(2, 2, *mixed.shape[1:]))
    streams = RandomStreams.from_seeds([1, 2, 3, 4], (2, 2), torch.float64)
    with torch.inference_mode():
        square = make_tracker().run(measurement, data_priors(measurement), streams)
    assert_same(TrackHistory(*(t.flatten(0, 1) for t in square)), flat, rtol=1e-6, atol=1e-6)


def test_without_a_batch_dimension(mixed):
    mixed = mixed[:, :6]
    measurement = from_snapshots(mixed[0])
    streams = RandomStreams.from_seeds([1], (), torch.float64)
    with torch.inference_mode():
        history = make_tracker().run(measurement, data_priors(measurement), streams)
    expected = run(mixed[:1], [1])
    assert_same(TrackHistory(*(t[None] for t in history)), expected, rtol=1e-6, atol=1e-6)


def test_steps_in_a_loop_equal_a_run(mixed):
    mixed, reported = mixed[:, :6], []
    expected = run(mixed[:2], [1, 2], on_step=lambda k, _, estimate: reported.append((k, estimate.noise)))
    tracker, measurement = make_tracker(), from_snapshots(mixed[:2])
    priors, streams = data_priors(measurement), RandomStreams.from_seeds([1, 2], (2,), torch.float64)
    state, estimates = tracker.init(priors), []
    with torch.inference_mode():
        for k in range(mixed.shape[1]):
            state, estimate = tracker.step(state, measurement.at(k), priors, streams)
            estimates.append(estimate)
    for found, values in zip(zip(*estimates, strict=True), expected, strict=True):
        assert torch.equal(torch.stack(found, 1), values)
    assert [k for k, _ in reported] == list(range(mixed.shape[1]))
    assert torch.equal(reported[-1][1], expected.noise[:, -1])


def test_the_same_seed_gives_the_same_numbers(mixed):
    first, again, other = (run(mixed[:1, :5], [seed]) for seed in (1, 1, 2))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first.state, other.state)


@pytest.mark.slow
def test_noise_alone_declares_nothing():
    """At a birth probability of 1e-4 a step only a likelihood ratio above 1e4 is declared, which noise
    exceeds with a probability of 1e-4 at most (Markov). So 2e-3 in a run of 20 steps; four or more of 30
    runs: 5e-7."""
    history = run(torch.stack([simulate(100 + s)[0] for s in range(30)]), list(range(30)))
    assert_sound(history)
    assert int(history.declared.any(-1).any(-1).sum()) < 4
    level = history.noise[:, -5:].mean((0, 1))  # 0.1 / 8 by the simulator
    torch.testing.assert_close(level, torch.full_like(level, 0.0125), rtol=0.1, atol=0)


def test_an_object_that_leaves_the_region_loses_existence():
    data, truth = simulate(3, ((0.0, 62.0), (20.0, 82.0)))
    outside = int((truth[:, 0, 0] > 72).nonzero()[0])
    inside = int((truth[:, 0, 0] < 69).nonzero()[-1])
    # Past the border its energy is still received; nothing in the region explains it.
    history = run(data[None], [1], noise_shape=20.0)
    assert history.declared[0, inside].sum() == 1
    label = int(history.label[0, inside][history.declared[0, inside]])
    last = history.existence[0, -1][history.label[0, -1] == label]
    assert outside < 20
    assert last.numel() == 0 or last.max() < 0.5


def test_a_silent_object_dies_and_the_next_one_has_a_new_label():
    data, _ = simulate(3, *ONE, steps=40)
    data[12:24] = simulate(5, steps=40)[0][12:24]
    history = run(data[None], [1])
    assert_sound(history)
    first, second = (history.label[0, k][history.declared[0, k]].tolist() for k in (11, 39))
    assert history.declared[0, 16:24].sum() == 0
    assert (first, second) == ([1], [2])


def test_a_dead_object_leaves_no_label_behind(mixed):
    """Where a history holds no object, it holds no label either."""
    history = run(mixed, [1, 2, 3, 4])
    assert history.label[history.existence == 0].eq(0).all()


@pytest.mark.parametrize("broken", ["snapshot", "channel", "tone", "steps", "everything"])
def test_missing_data_are_taken_in_stride(broken):
    data, truth = simulate(2, *TWO)
    if broken == "snapshot":
        data[::2, :, 1] = torch.nan
    elif broken == "channel":
        data[..., 3] = torch.nan
        data[5:8, 0, :, 6] = torch.nan
    elif broken == "tone":
        data[:, 1] = torch.nan
    elif broken == "steps":
        data[8:11] = torch.nan
    else:
        data[:] = torch.nan
    history = run(data[None], [1])
    assert_sound(history)
    if broken == "everything":
        assert history.existence.eq(0).all()
        assert history.log_evidence.eq(0).all()
        return
    for k in (7, 19):
        assert history.declared[0, k].sum() == 2
        for source in range(2):
            assert len(labels_near(history, 0, k, truth[k, source, 0].item(), within=4.0)) == 1
    if broken == "steps":
        assert history.log_evidence[0, 8:11].eq(0).all()
        # Nothing heard: existence falls by the survival probability and nothing else.
        top = history.existence[0, 7:11].sort(-1, descending=True).values[:, :2]
        torch.testing.assert_close(top[1:], 0.95 * top[:-1], rtol=1e-2, atol=0)
        assert set(history.label[0, 19][history.declared[0, 19]].tolist()) == set(
            history.label[0, 7][history.declared[0, 7]].tolist()
        )


@pytest.mark.parametrize(("step", "entry"), [(0, complex(math.inf, 0.0)), (7, complex(0.0, -math.inf))])
def test_infinite_data_count_as_missing(step, entry):
    data, _ = simulate(2, *TWO)
    data[step, 0, 1, 2] = entry
    priors = data_priors(from_snapshots(simulate(2, *TWO)[0][None]))
    streams = RandomStreams.from_seeds([1], (1,), torch.float64)
    with torch.inference_mode():
        history = make_tracker().run(from_snapshots(data[None]), priors, streams)
    assert history.failed[0].nonzero().squeeze(-1).tolist() == [step]
    assert history.log_evidence[0, step] == 0
    assert_sound(history)


def test_no_more_objects_than_slots():
    paths = [((0.0, b), (20.0, b)) for b in (-50.0, -20.0, 15.0)]
    data = torch.stack([simulate(seed, *paths)[0] for seed in range(3)])
    history = run(data, [1, 2, 3], slots=1, births=3)
    assert_sound(history)
    assert history.declared.shape == (3, 20, 1)


@pytest.mark.parametrize("bearings", [(-50.0, -20.0, 15.0), (-50.0, -20.0, 15.0, 45.0)])
def test_several_sources_of_equal_power_are_found(bearings):
    """19 dB above the noise with the gain of the array, a beamwidth apart and more: together they are
    beyond doubt (a hundred and more in log-evidence), though each alone could pass for noise."""
    data = torch.stack([simulate(seed, *[((0.0, b), (20.0, b)) for b in bearings])[0] for seed in range(3)])
    history = run(data, [1, 2, 3], slots=6, births=6)
    assert history.declared[:, 8:].sum(-1).eq(len(bearings)).all()


def test_the_limit_of_the_first_noise_variance_holds():
    """Noise of variance 0.0125 under a prior that ends at 0.008: the estimate of the first step stays
    within one transition (ten percent) of the limit."""
    measurement = from_snapshots(torch.stack([simulate(seed)[0][:1] for seed in range(10)]))
    priors = data_priors(measurement)._replace(noise_max=torch.full((10, 2), 0.008, dtype=torch.float64))
    streams = RandomStreams.from_seeds(range(10), (10,), torch.float64)
    with torch.inference_mode():
        history = make_tracker().run(measurement, priors, streams)
    assert history.noise.mean() < 0.0095


@pytest.mark.slow
def test_likelihood_power_counts_snapshots(mixed):
    """Estimates are those of so many fewer snapshots; the evidence is that of all of them."""
    blunt = run(mixed[2:3], [1], likelihood_power=0.3)
    measurement = from_snapshots(mixed[2:3])
    streams = RandomStreams.from_seeds([1], (1,), torch.float64)
    with torch.inference_mode():
        few = make_tracker().run(measurement.tempered(0.3), data_priors(measurement), streams)
    assert blunt.declared[0, 10:].sum(-1).eq(1).all()
    for name in ("existence", "state", "power", "noise"):
        torch.testing.assert_close(getattr(blunt, name), getattr(few, name), rtol=1e-9, atol=1e-12)
    sharp = run(mixed[2:3], [1])
    assert (blunt.log_evidence - sharp.log_evidence).abs().mean() < 0.1 * sharp.log_evidence.abs().mean()
    assert (few.log_evidence - sharp.log_evidence).abs().mean() > 0.3 * sharp.log_evidence.abs().mean()


def test_initial_state():
    measurement = from_snapshots(simulate(1)[0][None])
    priors = data_priors(measurement)
    tracker = make_tracker()
    state = tracker.init(priors)
    assert state.objects.existence.eq(0).all()
    assert state.next_label.tolist() == [1]
    assert state.objects.state.shape == (1, 4, 200, 2)
    assert (state.noise.variance <= priors.noise_max[..., None]).all()
    torch.testing.assert_close(state.noise.log_weight.exp().sum(-1), torch.ones(1, 2, dtype=torch.float64))


def test_some_sequences_share_what_all_share():
    tracker = make_tracker()
    part = tracker.select(slice(1, 3))
    assert part.dictionary is tracker.dictionary
    assert part.model == tracker.model


def test_some_sequences_have_fields_and_numbers_of_their_own():
    plain = make_tracker()
    fields = [LineArrayField(FREQS, POSITIONS, c, dtype=torch.float64) for c in (1500.0, 1400.0, 1600.0)]
    survival = torch.tensor([0.5, 0.6, 0.7], dtype=torch.float64)
    numbers = plain.model.with_numbers({"survival": survival})
    tracker = DirectTracker(StackedField(fields), plain.region, 1.0, plain.config, numbers)
    part = tracker.select(slice(1, 3))
    assert part.field.field.fields == tuple(fields[1:])
    assert part.model.survival.tolist() == [0.6, 0.7]
    assert torch.equal(part.dictionary.response, tracker.dictionary.response[1:])


@pytest.mark.slow
def test_a_source_keeps_its_label_when_a_louder_one_appears():
    """Another one 20 dB above it, 30 degrees away, from the sixth step on; 24 sequences. While nobody knows
    of that, its energy pulls at the first source; placed again without it, 22 keep their label (else 14)."""
    runs, sequences = 24, []
    for seed in range(runs):
        first, _ = simulate(seed, ((0.0, 10.0), (20.0, 10.0)), steps=8, snr_db=20.0)
        second, _ = simulate(50 + seed, ((0.0, 40.0), (20.0, 40.0)), steps=8, snr_db=20.0, powers_db=(20.0,))
        sequences.append(torch.cat([first[:5], (first + second)[5:]]))
    history = run(torch.stack(sequences), list(range(runs)), driving_variance=[1e-2])
    kept = [labels_near(history, b, 7, 10.0) == [1] for b in range(runs)]
    assert sum(kept) >= 19
