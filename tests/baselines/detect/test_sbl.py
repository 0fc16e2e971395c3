import numpy as np
import pytest
import torch
from oracles import sparse_bayesian as oracle
from oracles.arrays import complex_normal
from oracles.line_array import make_field, make_region
from torch import Tensor

from torchdt.baselines.detect.config import SblConfig
from torchdt.baselines.detect.peaks import Grid
from torchdt.baselines.detect.sbl import SparseBayesianLearning
from torchdt.baselines.detect.spectrum import sparse_spectrum, update
from torchdt.core.errors import InputError
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.proposal.dictionary import Dictionary, build_dictionary
from torchdt.model.measurement import Measurement, from_covariance, from_snapshots
from torchdt.model.region import Coordinate, Region

pytestmark = pytest.mark.slow
FIELD, REGION = make_field(), make_region()
DICTIONARY = build_dictionary(FIELD, REGION)
CELLS = (15, 42, 60)  # bearings -39, 15 and 51 degrees


class Plane:
    """Direction cosines of a square of 5 x 5 sensors at half a wavelength: two coordinates."""

    num_tones, num_sensors, num_coordinates = 2, 25, 2

    def __call__(self, state: Tensor) -> Tensor:
        place = torch.cartesian_prod(*[torch.arange(5.0, dtype=state.dtype)] * 2)
        phase = torch.pi * (state[..., None, :2] * place).sum(-1)
        tones = torch.tensor([1.0, 0.8], dtype=state.dtype)
        return torch.exp(-1j * phase[..., None, :] * tones[:, None]) / 5


PLANE_REGION = Region(
    [Coordinate(name, "", -0.9, 0.9, 0.1, -1, 1, 1e-3) for name in ("u", "v")], torch.float64
)


def simulate(
    *cells: int,
    noise: float = 1e-3,
    snapshots: int = 20,
    steps: int = 2,
    powers=(1.0, 0.5, 2.0),
    seed: int = 0,
) -> Tensor:
    """Snapshots (K, I, J, M) of sources at the centres of cells of the line array."""
    rng = torch.Generator().manual_seed(seed)
    z = noise**0.5 * complex_normal(rng, steps, 2, snapshots, 8)
    for cell, power in zip(cells, powers, strict=False):
        amplitude = power**0.5 * complex_normal(rng, steps, 2, snapshots, 1)
        z = z + amplitude * DICTIONARY.response[:, cell, None]
    return z


def numpy_problem(snapshots: Tensor, dictionary: Dictionary = DICTIONARY) -> tuple:
    """Dictionary (I, M, C) and scatter / J (I, M, M) of one step."""
    return dictionary.response.mT.numpy(), (snapshots.mT @ snapshots.conj() / snapshots.shape[-2]).numpy()


def spectrum(snapshots: Tensor, config: SblConfig):
    return sparse_spectrum(DICTIONARY.response, from_snapshots(snapshots), Grid.of(REGION), config)


def detector(**config) -> SparseBayesianLearning:
    return SparseBayesianLearning(FIELD, REGION, DICTIONARY, SblConfig(**config))


def found(points, step: int = 0) -> list[float]:
    """Sorted first coordinate of the points of a step."""
    return sorted(points.position[step][points.present[step]][:, 0].tolist())


@pytest.mark.parametrize("noise", [1e-3, 0.1, 1.0])
def test_powers_are_those_of_the_plain_implementation(noise):
    z = simulate(*CELLS, noise=noise)
    ours = spectrum(z, SblConfig(prune=0.0))
    for step in range(2):
        plain = oracle.learn(*numpy_problem(z[step]), REGION.grid_shape, 3, max_iterations=300)
        assert ours.iterations[step] == plain.iterations
        np.testing.assert_allclose(ours.power[step], plain.power, atol=1e-8 * plain.power.max())
        np.testing.assert_allclose(ours.noise[step], plain.noise, rtol=1e-6)


def test_both_plain_formulations_agree():
    problem = numpy_problem(simulate(*CELLS, noise=0.1)[0])
    sums = oracle.learn(*problem, REGION.grid_shape, 3, max_iterations=20)
    outer = oracle.learn(*problem, REGION.grid_shape, 3, oracle.outer_products, max_iterations=20)
    np.testing.assert_allclose(sums.power, outer.power, atol=1e-12)


def test_two_coordinates():
    dictionary = build_dictionary(Plane(), PLANE_REGION)
    rng = torch.Generator().manual_seed(3)
    z = 0.05 * complex_normal(rng, 2, 10, 25)
    cells = (5 * 18 + 4, 11 * 18 + 13)
    for cell in cells:
        z = z + complex_normal(rng, 2, 10, 1) * dictionary.response[:, cell, None]
    config = SblConfig(prune=0.0, sources=2)
    ours = sparse_spectrum(dictionary.response, from_snapshots(z), Grid.of(PLANE_REGION), config)
    plain = oracle.learn(*numpy_problem(z, dictionary), PLANE_REGION.grid_shape, 2)
    np.testing.assert_allclose(ours.power, plain.power, atol=1e-8 * plain.power.max())
    points = SparseBayesianLearning(Plane(), PLANE_REGION, dictionary, SblConfig(refine=False))(
        from_snapshots(z)
    )
    expected = dictionary.points[list(cells)]
    assert points.present.sum() == 2
    torch.testing.assert_close(points.position[:2].sort(0).values, expected.sort(0).values)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_exact_support_at_high_signal_to_noise(dtype):
    """Three sources on the grid, 30 dB: nothing else, and their mean powers."""
    z = simulate(*CELLS, snapshots=50, steps=4)
    field, region = make_field(dtype), make_region(dtype)
    learner = SparseBayesianLearning(field, region, build_dictionary(field, region), SblConfig(refine=False))
    points = learner(from_snapshots(z.to(torch.complex64 if dtype == torch.float32 else torch.complex128)))
    assert points.position.dtype == dtype
    for step in range(4):
        assert found(points, step) == pytest.approx([-39, 15, 51], abs=1e-4)
        order = points.position[step][points.present[step]][:, 0].argsort()
        power = points.power[step][points.present[step]][order].mean(-1)
        # 100 squared amplitudes of relative standard deviation 1: 0.5 are five of theirs, 6e-7 each.
        torch.testing.assert_close(power, torch.tensor([1.0, 0.5, 2.0], dtype=dtype), rtol=0.5, atol=0)


def test_refinement_finds_sources_between_the_cells():
    bearings = torch.tensor([[-38.3], [14.1]], dtype=torch.float64)
    rng = torch.Generator().manual_seed(5)
    z = 0.01 * complex_normal(rng, 1, 2, 20, 8)
    for response in FIELD(bearings):
        z = z + complex_normal(rng, 1, 2, 20, 1) * response[:, None]
    coarse, fine = (found(detector(refine=refine)(from_snapshots(z))) for refine in (False, True))
    assert fine == pytest.approx([-38.3, 14.1], abs=0.2)
    assert max(abs(a - b) for a, b in zip(coarse, [-38.3, 14.1], strict=True)) > 0.2


def test_the_evidence_rises():
    """With the noise variance held, every update lowers minus the log evidence."""
    z = simulate(*CELLS, noise=0.05)[0]
    dictionary, scatter = numpy_problem(z)
    noise = torch.full((2,), 0.05, dtype=torch.float64)
    power = torch.full((70,), 0.1, dtype=torch.float64)
    values = []
    for _ in range(60):
        values.append(oracle.objective(dictionary, power.numpy(), noise.numpy(), scatter))
        power = update(power, DICTIONARY.response, noise, from_snapshots(z))
    steps = np.diff(values)
    assert (steps < 1e-9).all()
    assert values[0] - values[-1] > 1
    assert abs(steps[-1]) < 1e-3


def test_a_fixed_point_satisfies_the_update():
    z = simulate(*CELLS, noise=0.01)[0]
    result = spectrum(z, SblConfig(tolerance=1e-6, max_iterations=5000))
    assert result.iterations < 5000
    dictionary, scatter = numpy_problem(z)
    top, bottom = oracle.column_sums(dictionary, result.power.numpy(), result.noise.numpy(), scatter)
    held = result.power.numpy() > 1e-3
    assert held.sum() >= 3
    np.testing.assert_allclose((top / bottom)[held], 1, atol=1e-3)
    assert (top / bottom)[~held].max() < 1 + 1e-3  # no other column wants to grow


def test_noise_within_ten_percent():
    """One source in 400 snapshots: 2800 free squares a tone, standard deviation 1.9 %, false alarm 2e-6."""
    z = simulate(42, noise=0.3, snapshots=400)
    points = detector(sources=1)(from_snapshots(z))
    torch.testing.assert_close(points.noise, torch.full_like(points.noise, 0.3), rtol=0.1, atol=0)


def test_pruning_does_not_move_the_peaks():
    z = simulate(*CELLS, noise=0.3, snapshots=3, steps=4)
    for step, (pruned, whole) in enumerate(
        zip(*(spectrum(z, SblConfig(prune=prune)).power for prune in (1e-6, 0.0)), strict=True)
    ):
        peaks = [oracle.strongest_peaks(power.numpy(), REGION.grid_shape, 10) for power in (pruned, whole)]
        high = [
            set(p[power.numpy()[p] > 1e-3 * power.max().item()])
            for p, power in zip(peaks, (pruned, whole), strict=True)
        ]
        assert high[0] == high[1], step


def test_in_a_batch_as_alone():
    z = simulate(*CELLS, noise=0.5, snapshots=3, steps=4)
    learner = detector(max_iterations=40)
    together = learner(from_snapshots(z))
    nested = learner(from_snapshots(z.reshape(2, 2, *z.shape[1:])))
    for step in range(4):
        alone = learner(from_snapshots(z[step]))
        for name, value in alone._asdict().items():
            torch.testing.assert_close(value, getattr(together, name)[step])
            torch.testing.assert_close(value, getattr(nested, name)[step // 2, step % 2])


def test_a_field_for_each_sequence():
    tilted = LineArrayField((100.0, 150.0), tuple(5.2 * m for m in range(8)), dtype=torch.float64)
    stacked = StackedField([FIELD, tilted])
    learner = SparseBayesianLearning(stacked, REGION, build_dictionary(stacked, REGION), SblConfig())
    z = simulate(*CELLS, steps=1)[0]
    together = learner(from_snapshots(torch.stack([z, z])[:, None]))
    for index, field in enumerate((FIELD, tilted)):
        own = SparseBayesianLearning(field, REGION, build_dictionary(field, REGION), SblConfig())
        alone = own(from_snapshots(z))
        torch.testing.assert_close(together.position[index, 0], alone.position)
        torch.testing.assert_close(together.strength[index, 0], alone.strength)
    assert not torch.equal(together.position[0], together.position[1])


def test_the_unit_of_the_data_does_not_matter():
    z = simulate(*CELLS, noise=0.1)
    points, scaled = (detector(max_iterations=40)(from_snapshots(z * unit)) for unit in (1.0, 1e-4))
    torch.testing.assert_close(scaled.position, points.position)
    torch.testing.assert_close(scaled.strength, points.strength)
    torch.testing.assert_close(scaled.power, 1e-8 * points.power)


def test_covariances_say_the_same_as_snapshots():
    z = simulate(*CELLS, noise=0.1)
    points = detector(max_iterations=40)(from_snapshots(z))
    same = detector(max_iterations=40)(from_covariance(z.mT @ z.conj() / z.shape[-2], z.shape[-2]))
    torch.testing.assert_close(same.position, points.position)
    torch.testing.assert_close(same.strength, points.strength)


def test_missing_sensors_and_tones():
    z = simulate(*CELLS)
    z[..., 3] = torch.nan
    z[0, 1] = torch.nan
    points = detector()(from_snapshots(z))
    for step in range(2):
        assert found(points, step) == pytest.approx([-39, 15, 51], abs=0.3)
    assert points.power[0, :3, 1].eq(0).all()


def test_no_data_no_points():
    points = detector()(from_snapshots(torch.full((2, 2, 3, 8), torch.nan, dtype=torch.complex128)))
    assert not points.present.any()
    assert all(bool(t.isfinite().all()) for t in points)


def test_noise_alone_rarely_reaches_the_threshold():
    rng = torch.Generator().manual_seed(1)
    points = detector()(from_snapshots(complex_normal(rng, 40, 2, 3, 8)))
    assert points.present.sum() <= 4


def test_weak_data_of_one_snapshot():
    z = simulate(42, snapshots=1, noise=1e-4)
    assert found(detector()(from_snapshots(z))) == pytest.approx([15], abs=0.3)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sources", 0),
        ("min_iterations", 0),
        ("max_iterations", 3),
        ("tolerance", 0.0),
        ("prune", 1.0),
        ("points", 0),
        ("separation", 0.5),
        ("threshold", -1.0),
    ],
)
def test_settings_out_of_range(key, value):
    with pytest.raises(InputError, match=rf"tracker\.detector\.{key}"):
        SblConfig(**{key: value})


def test_as_many_sources_as_sensors():
    with pytest.raises(InputError, match=r"tracker\.detector\.sources.*8.*fewer than the 8 sensors"):
        detector(sources=8)


def test_measurement_is_left_as_it_was():
    measurement = from_snapshots(simulate(*CELLS))
    before = Measurement(*(t.clone() for t in measurement))
    detector()(measurement)
    assert all(torch.equal(a, b) for a, b in zip(before, measurement, strict=True))
