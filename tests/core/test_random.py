import pytest
import torch

from torchdt.core.random import RandomStreams


@pytest.mark.parametrize("draw", ["normal", "uniform", "gamma"])
def test_a_stream_alone_equals_the_stream_in_a_batch(draw):
    seeds = [3, 1, 4, 1, 5, 9]
    batch = RandomStreams.from_seeds(seeds, (2, 3), torch.float32)
    first = (torch.tensor(0.7),) if draw == "gamma" else ()
    together = [getattr(batch, draw)(*first, 4, 5), getattr(batch, draw)(*first, 2)]
    for n, seed in enumerate(seeds):
        alone = RandomStreams.from_seeds([seed], (), torch.float32)
        for drawn in together:
            one = getattr(alone, draw)(*first, *drawn.shape[2:])
            assert torch.equal(one, drawn[n // 3, n % 3])
    assert together[0].shape == (2, 3, 4, 5)
    assert torch.equal(together[0][0, 1], together[0][1, 0])  # both of seed 1
    assert not torch.equal(together[0][0, 0], together[0][0, 1])


def test_moments():
    """Mean and variance of 1e5 draws; z-scores below 5.2 (false alarm of 2e-7 each)."""
    streams, number = RandomStreams.from_seeds([1], (), torch.float64), 100_000
    for draws, mean, variance, fourth in (
        (streams.normal(number), 0.0, 1.0, 3.0),
        (streams.uniform(number), 0.5, 1 / 12, 1 / 80),
        (streams.gamma(torch.tensor(100.0), number), 100.0, 100.0, 3 * 100.0**2 + 6 * 100.0),
    ):
        assert abs(draws.mean().item() - mean) < 5.2 * (variance / number) ** 0.5
        assert abs(draws.var().item() - variance) < 5.2 * ((fourth - variance**2) / number) ** 0.5
        assert draws.dtype == torch.float64


@pytest.mark.parametrize(("seeds", "shape"), [([1], (2,)), ([1, 2, 3], (2,)), ([], ())])
def test_wrong_number_of_generators_is_named(seeds, shape):
    with pytest.raises(ValueError, match=f"generators: found {len(seeds)}, expected"):
        RandomStreams.from_seeds(seeds, shape, torch.float32)


def streams() -> RandomStreams:
    found = RandomStreams.from_seeds([3, 1], (2,), torch.float64)
    found.normal(5)
    return found


def test_a_copy_goes_on_from_a_snapshot_and_leaves_the_streams_alone():
    first = streams()
    snapshot = first.snapshot()
    expected = [first.normal(3, 2), first.uniform(4)]
    for _ in range(2):
        copy = first.at(snapshot)
        assert torch.equal(copy.normal(3, 2), expected[0])
        assert torch.equal(copy.uniform(4), expected[1])
        assert (copy.batch_shape, copy.dtype) == (first.batch_shape, first.dtype)
    first.at(snapshot).normal(1)
    undisturbed = streams()
    undisturbed.normal(3, 2)
    undisturbed.uniform(4)
    assert torch.equal(first.normal(7), undisturbed.normal(7))


def test_a_snapshot_does_not_move_with_the_streams():
    first = streams()
    snapshot = first.snapshot()
    before = [state.clone() for state in snapshot]
    first.normal(1000)
    assert all(torch.equal(a, b) for a, b in zip(snapshot, before, strict=True))


def test_skipping_to_where_a_copy_ended():
    first, undisturbed = streams(), streams()
    copy = first.at(first.snapshot())
    copy.normal(11)
    undisturbed.normal(11)
    generators = list(first.generators)
    first.skip_to(copy.snapshot())
    assert torch.equal(first.uniform(6), undisturbed.uniform(6))
    assert all(a is b for a, b in zip(first.generators, generators, strict=True))


def test_a_snapshot_of_another_batch_is_refused():
    other = RandomStreams.from_seeds([1, 2, 3], (3,), torch.float64).snapshot()
    for go_on in (streams().at, streams().skip_to):
        with pytest.raises(ValueError, match="zip"):
            go_on(other)
