import torch

from benchmarks.problem import random_problem
from torchdt.filter.bp.update import update

SIZES = (3, 40, 2, 8, 4, 5, 6)


def test_the_shapes_are_those_of_an_update():
    objects, response, noise, measurement = random_problem((2,), *SIZES, torch.float64, "cpu", 0)
    assert response.shape == (2, 3, 2, 40, 8)
    assert objects.log_weight.shape == (2, 3, 40)
    assert objects.power.shape == objects.log_power_weight.shape == (2, 3, 2, 5)
    assert noise.variance.shape == noise.log_weight.shape == (2, 2, 6)
    assert measurement.factor.shape == (2, 2, 8, 4)
    assert {t.dtype for t in (response, measurement.factor)} == {torch.complex128}
    torch.testing.assert_close(response.norm(dim=-1), torch.ones(2, 3, 2, 40, dtype=torch.float64))
    for weight in (objects.log_weight, objects.log_power_weight, noise.log_weight):
        torch.testing.assert_close(weight.exp().sum(-1), torch.ones_like(weight[..., 0]))
    assert (objects.existence >= 0.5).all()
    assert (objects.existence <= 0.99).all()


def test_a_sequence_is_what_it_is_alone():
    batch = random_problem((2,), *SIZES, torch.float32, "cpu", 7)
    alone = random_problem((), *SIZES, torch.float32, "cpu", 8)
    for many, one in zip(batch, alone, strict=True):
        for a, b in zip(many, one, strict=True) if isinstance(many, tuple) else [(many, one)]:
            torch.testing.assert_close(a[1], b, rtol=1e-5, atol=1e-6)


def test_the_data_hold_every_object_at_its_first_particle():
    beliefs = update(*random_problem((4,), *SIZES, torch.float64, "cpu", 0))
    assert (beliefs.objects.log_weight.argmax(-1) == 0).double().mean() > 0.7
    assert torch.sigmoid(beliefs.objects.log_odds).mean() > 0.9
