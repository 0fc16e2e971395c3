import pytest
import torch

from torchdt.random import RandomStreams


@pytest.mark.parametrize("draw", ["normal", "uniform"])
def test_a_stream_alone_equals_the_stream_in_a_batch(draw):
    seeds = [3, 1, 4, 1, 5, 9]
    batch = RandomStreams.from_seeds(seeds, (2, 3), torch.float32)
    together = [getattr(batch, draw)(4, 5), getattr(batch, draw)(2)]
    for n, seed in enumerate(seeds):
        alone = RandomStreams.from_seeds([seed], (), torch.float32)
        for drawn in together:
            one = getattr(alone, draw)(*drawn.shape[2:])
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
    ):
        assert abs(draws.mean().item() - mean) < 5.2 * (variance / number) ** 0.5
        assert abs(draws.var().item() - variance) < 5.2 * ((fourth - variance**2) / number) ** 0.5
        assert draws.dtype == torch.float64


@pytest.mark.parametrize(("seeds", "shape"), [([1], (2,)), ([1, 2, 3], (2,)), ([], ())])
def test_wrong_number_of_generators_is_named(seeds, shape):
    with pytest.raises(ValueError, match=f"generators: found {len(seeds)}, expected"):
        RandomStreams.from_seeds(seeds, shape, torch.float32)
