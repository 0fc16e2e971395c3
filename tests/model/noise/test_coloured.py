"""Coloured noise is white noise on whitened data: matrices, likelihood, belief of its level."""

import numpy as np
import pytest
import torch
from oracles.arrays import complex_normal, direct_log_likelihood, random_covariance

from torchdt.core.errors import InputError
from torchdt.model.measurement import from_snapshots, gaussian_log_likelihood
from torchdt.model.model import Model
from torchdt.model.noise.base import BaseNoise, Noise, NoiseModel
from torchdt.model.noise.coloured import ColouredNoise
from torchdt.model.noise.white import WHITE, WhiteNoise
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
TONES, SNAPSHOTS, SENSORS, POINTS = 2, 3, 5, 7
MISSING = pytest.mark.parametrize("missing", [[], [1], [0, 3]])


class Scene:
    """Two objects in coloured noise; some sensors are missing, and `kept` are left."""

    def __init__(self, missing: list[int], batch: tuple[int, ...] = ()):
        rng = torch.Generator().manual_seed(5)
        self.matrix = random_covariance(rng, TONES, sensors=SENSORS)
        self.model = ColouredNoise(matrix=self.matrix)
        self.columns = complex_normal(rng, *batch, TONES, SENSORS, 2)
        self.snapshots = complex_normal(rng, *batch, TONES, SNAPSHOTS, SENSORS)
        self.variance = torch.rand(*batch, TONES, generator=rng, dtype=F64) + 0.1
        points = torch.logspace(-2, 1, POINTS, dtype=F64).expand(*batch, TONES, -1)
        log_weight = torch.randn(*batch, TONES, POINTS, generator=rng).double().log_softmax(-1)
        self.prior = Noise(points, log_weight)
        broken = self.snapshots.clone()
        broken[..., missing] = torch.nan
        self.measurement = from_snapshots(broken)
        self.kept = [m for m in range(SENSORS) if m not in missing]

    @property
    def signal(self) -> torch.Tensor:
        return self.columns @ self.columns.mH

    def direct(self, variance: torch.Tensor) -> torch.Tensor:
        """Of the smaller array, by determinant and inverse."""
        covariance = self.signal + variance[..., None, None] * self.model.matrix
        return direct_log_likelihood(
            self.snapshots[..., self.kept], covariance[..., self.kept, :][..., self.kept]
        )


@MISSING
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_likelihoods_are_those_of_the_smaller_array(missing, batch):
    scene = Scene(missing, batch)
    expected = scene.direct(scene.variance)
    covariance = scene.model.covariance(scene.signal, scene.variance, scene.measurement.present)
    of_matrix = gaussian_log_likelihood(scene.measurement, covariance)
    of_columns = scene.model.log_likelihood(scene.measurement, scene.columns, scene.variance)
    torch.testing.assert_close(of_matrix, expected, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(of_columns, expected, rtol=1e-10, atol=1e-10)


@MISSING
def test_levels_are_weighted_by_the_direct_likelihood(missing):
    scene = Scene(missing, (3,))
    found = scene.model.update(scene.prior, scene.measurement, scene.signal)
    points = [scene.direct(level) for level in scene.prior.variance.unbind(-1)]
    expected = (scene.prior.log_weight + torch.stack(points, -1)).log_softmax(-1)
    torch.testing.assert_close(found.log_weight, expected, rtol=1e-9, atol=1e-9)


@MISSING
@pytest.mark.parametrize("model", [WHITE, ColouredNoise(matrix=Scene([]).matrix)])
def test_what_follows_from_the_covariance_alone_is_the_same(missing, model):
    """A model of one's own need only say its covariance."""
    scene = Scene(missing, (2,))

    class Own(BaseNoise):
        def covariance(self, signal, variance, present):
            return model.covariance(signal, variance, present)

    own = Own()
    assert isinstance(own, NoiseModel)
    for name, given in (
        ("update", (scene.prior, scene.measurement, scene.signal)),
        ("log_likelihood", (scene.measurement, scene.columns, scene.variance)),
    ):
        found, expected = getattr(own, name)(*given), getattr(model, name)(*given)
        torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def test_white_noise_is_a_colour():
    scene = Scene([2])
    white = ColouredNoise(matrix=2.5 * torch.eye(SENSORS))  # only the shape counts
    given = scene.signal, scene.variance, scene.measurement.present
    torch.testing.assert_close(white.covariance(*given), WhiteNoise().covariance(*given))
    given = scene.prior, scene.measurement, scene.signal
    torch.testing.assert_close(white.update(*given), WhiteNoise().update(*given))


def test_gradients_reach_signal_level_and_matrix():
    scene = Scene([1])
    root = torch.linalg.cholesky(scene.matrix)

    def values(columns, variance, root):
        model = ColouredNoise(matrix=root @ root.mH)
        belief = model.update(scene.prior, scene.measurement, columns @ columns.mH)
        return model.log_likelihood(scene.measurement, columns, variance), belief.log_weight

    inputs = [t.clone().requires_grad_() for t in (scene.columns, scene.variance, root)]
    assert torch.autograd.gradcheck(values, inputs)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_types_are_those_of_the_region(dtype):
    scene = Scene([1])
    model = scene.model.on(Region([Coordinate("x", "m", 0, 10, 1, -1, 1, 1e-2)], dtype))
    signal, level = scene.signal.to(dtype.to_complex()), scene.variance.to(dtype)
    measurement = from_snapshots(scene.snapshots.to(dtype.to_complex()))
    prior = Noise(*(t.to(dtype) for t in scene.prior))
    assert model.covariance(signal, level, measurement.present).dtype == dtype.to_complex()
    found = model.update(prior, measurement, signal)
    assert found.log_weight.dtype == dtype
    expected = scene.model.update(scene.prior, from_snapshots(scene.snapshots), scene.signal)
    tolerance = 1e-4 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(found.log_weight.double(), expected.log_weight, rtol=tolerance, atol=tolerance)


def test_a_strong_signal_stays_positive_definite_in_single_precision():
    """60 dB above the quietest direction of a noise that is itself nearly singular."""
    scene = Scene([])
    level = torch.tensor([1e-6, 1e-3, 1.0, 1.0, 1.0], dtype=F64)
    model = ColouredNoise(matrix=torch.diag(level).to(torch.complex128))
    signal = (1e6 * scene.signal).to(torch.complex64)
    covariance = model.covariance(signal, torch.full((TONES,), 1e-3), torch.ones(TONES, SENSORS))
    assert torch.linalg.cholesky_ex(covariance.to(torch.complex128)).info.eq(0).all()


def test_matrices_come_from_files_and_lists(tmp_path):
    matrix = Scene([]).matrix.numpy()
    np.save(tmp_path / "n.npy", matrix)
    np.savez(tmp_path / "n.npz", covariance=matrix)
    lists = [[[str(z).strip("()") for z in row] for row in tone] for tone in matrix]
    expected = ColouredNoise(matrix=matrix).matrix
    torch.testing.assert_close(expected.diagonal(dim1=-2, dim2=-1).mean(-1), torch.ones(TONES).to(expected))
    for source in (str(tmp_path / "n.npy"), tmp_path / "n.npz", lists, torch.as_tensor(matrix)):
        torch.testing.assert_close(ColouredNoise(matrix=source).matrix, expected)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (None, "found nothing, expected a matrix for each tone"),
        ("missing.npy", "found 'missing.npy', which cannot be read"),
        ([[1, "a"], ["b", 1]], "expected a matrix of numbers"),
        ([1.0, 2.0], r"found shape \(2,\), expected \(tones, sensors, sensors\)"),
        ([[1.0, 0.0]], r"found shape \(1, 2\)"),
        ([[1.0, float("nan")], [0.0, 1.0]], "found entries that are not finite"),
        ([[1.0, 0.5], [0.2, 1.0]], "differ from those across the diagonal by 0.3"),
        ([[1.0, 2.0], [2.0, 1.0]], "found a least eigenvalue of -0.333 times the largest, expected positive"),
    ],
)
def test_what_is_no_covariance_is_refused(matrix, message):
    with pytest.raises(InputError, match=f"key 'model.noise.matrix': .*{message}"):
        ColouredNoise(matrix=matrix)


def test_other_arrays_are_refused():
    model = ColouredNoise(matrix=Scene([]).matrix)
    model.check_array(TONES, SENSORS)
    ColouredNoise(matrix=torch.eye(SENSORS)).check_array(7, SENSORS)
    expected = r"found shape \(2, 5, 5\), expected \(3, 5, 5\) or \(5, 5\)"
    with pytest.raises(InputError, match=expected):
        model.check_array(3, SENSORS)


def test_numbers_are_those_of_white_noise():
    model = Model(noise=ColouredNoise(matrix=torch.eye(3))).with_numbers({"noise_shape": 30.0})
    assert model.known()["noise_shape"] == 30.0
    assert model.noise.matrix.shape == (3, 3)
