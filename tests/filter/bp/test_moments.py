import torch
from oracles.arrays import complex_normal

from torchdt.filter.bp.moments import response_moment, signal_covariance, signal_without_each, without

OBJECTS, TONES, PARTICLES, SENSORS = 3, 2, 5, 4


def scene():
    rng = torch.Generator().manual_seed(2)
    response = complex_normal(rng, OBJECTS, TONES, PARTICLES, SENSORS)
    log_weight = torch.randn(OBJECTS, PARTICLES, generator=rng).double().log_softmax(-1)
    strength = torch.rand(OBJECTS, TONES, generator=rng).double()
    return response, log_weight, strength


def moment_of_one(response, log_weight):
    """Plain loops over particles, (I, M, M)."""
    total = torch.zeros(TONES, SENSORS, SENSORS, dtype=torch.complex128)
    for p in range(PARTICLES):
        for i in range(TONES):
            total[i] += log_weight[p].exp() * torch.outer(response[i, p], response[i, p].conj())
    return total


def test_response_moment_equals_the_loop():
    response, log_weight, _ = scene()
    expected = torch.stack([moment_of_one(a, w) for a, w in zip(response, log_weight, strict=True)])
    torch.testing.assert_close(response_moment(response, log_weight), expected)


def test_signals_equal_the_loop():
    response, log_weight, strength = scene()
    moment = response_moment(response, log_weight)
    each = signal_without_each(strength, moment)
    for n in range(OBJECTS):
        others = sum(strength[m][:, None, None] * moment[m] for m in range(OBJECTS) if m != n)
        torch.testing.assert_close(each[n], others)
        torch.testing.assert_close(signal_covariance(without(strength, torch.tensor(n)), moment), others)
    everyone = sum(strength[m][:, None, None] * moment[m] for m in range(OBJECTS))
    torch.testing.assert_close(signal_covariance(strength, moment), everyone)


def test_batch_leaves_out_its_own_object():
    _, _, strength = scene()
    batch = torch.stack([strength, 2 * strength])
    left = without(batch, torch.tensor([2, 0]))
    assert left[0, 2].eq(0).all()
    assert left[1, 0].eq(0).all()
    assert int(left.eq(0).sum()) == 2 * TONES
