import itertools

import numpy as np
import pytest
import torch
from oracles.arrays import complex_normal, sample_covariance
from oracles.detectors import PlanarField, matching_pursuit, planar_region
from oracles.line_array import BEARING, FREQS, POSITIONS, make_field, make_region

from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.detect.points import Points
from torchdt.baselines.detect.pursuit import MatchingPursuit
from torchdt.core.errors import InputError
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.measurement import Measurement, from_covariance, from_snapshots
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
LINE, PLANE = (make_field(), make_region()), (PlanarField(), planar_region())
COARSE = (LINE[0], Region([Coordinate(**(BEARING | {"cell": 10.0}))], F64))
THRESHOLD = 6.0


def make_detector(scene=LINE, **config) -> MatchingPursuit:
    field, region = scene
    threshold = config.get("threshold", THRESHOLD)
    settings = PursuitConfig(**({"points": 5, "threshold": threshold, "pick_threshold": threshold} | config))
    return MatchingPursuit(field, region, build_dictionary(field, region), settings)


def simulate(seed: int, sources, *, field=LINE[0], eta: float = 1e-4, J: int = 6) -> torch.Tensor:
    """Snapshots (steps, I, J, M) of Gaussian sources of unit power at positions (steps, L, d)."""
    rng = torch.Generator().manual_seed(seed)
    position = torch.as_tensor(sources, dtype=F64)
    response = field(position).transpose(1, 2)
    amplitude = complex_normal(rng, len(position), field.num_tones, J, position.shape[1])
    return amplitude @ response + eta**0.5 * complex_normal(rng, *amplitude.shape[:-1], field.num_sensors)


def pairs(seed: int, steps: int, cells: torch.Tensor, shape: tuple[int, ...], apart: int, number: int = 2):
    """Random sets of cells that are at least `apart` from each other in some coordinate."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < steps:
        chosen = rng.choice(len(cells), number, replace=False)
        at = np.stack(np.unravel_index(chosen, shape), -1)
        if all(np.abs(a - b).max() >= apart for a, b in itertools.combinations(at, 2)):
            found.append(chosen)
    return torch.tensor(np.array(found))


def same(found: Points, expected: Points, rtol: float = 1e-6) -> None:
    for name, ours, theirs in zip(Points._fields, found, expected, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=rtol, atol=1e-9, msg=lambda m, n=name: f"{n}: {m}")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("scene", "apart", "number"), [(COARSE, 4, 2), (PLANE, 4, 3)])
def test_sources_on_the_grid_are_recovered_exactly(scene, apart, number, dtype):
    field, region = scene
    cell = pairs(1, 30, region.cell_centres(), region.grid_shape, apart, number)
    z = simulate(2, region.cell_centres()[cell], field=field)
    own = make_field(dtype) if field is LINE[0] else PlanarField(dtype)
    detector = make_detector((own, Region(region.coordinates, dtype)), refine=False)
    found = detector(from_snapshots(z.to(dtype.to_complex())))
    assert found.position.dtype == dtype
    assert (found.present.sum(-1) == number).all()
    distance = (detector.points[:, None, None] - found.position[:, :number]).abs().sum(-1)
    assert torch.equal(distance.argmin(0).sort(-1).values, cell.sort(-1).values)
    assert (distance.amin(0) == 0).all()


@pytest.mark.parametrize(("scene", "apart", "number"), [(LINE, 12, 2), (PLANE, 4, 3)])
def test_sources_between_the_points_of_the_grid_are_found_there(scene, apart, number):
    field, region = scene
    cell = pairs(3, 30, region.cell_centres(), region.grid_shape, apart, number)
    rng = torch.Generator().manual_seed(4)
    offset = torch.rand(30, number, region.num_coordinates, generator=rng, dtype=F64) - 0.5
    truth = region.cell_centres()[cell] + offset * region.cell
    found = make_detector(scene, separation=3.0)(from_snapshots(simulate(5, truth, field=field, eta=1e-4)))
    assert (found.present.sum(-1) == number).all()
    error = (found.position[:, None, :number] - truth[:, :, None]).abs() / region.cell
    assert (error.amax(-1).amin(-1) < 0.1).all()
    assert error.amax(-1).amin(-1).median() < 1 / 32


def test_refining_leaves_only_the_noise():
    """200 steps of 36 complex numbers per tone left to noise have a standard deviation of 1.2 %, and two
    fitted bearings take 2 %: 10 % is more than 6 of them, 1e-9."""
    z = simulate(6, [[[-31.8], [14.2]]] * 200, eta=1e-3)
    fine, coarse = (make_detector(refine=refine)(from_snapshots(z)) for refine in (True, False))
    assert (fine.present.sum(-1) == 2).all()
    assert (coarse.noise.mean(0) > 2e-3).all()
    np.testing.assert_allclose(fine.noise.mean(0), 1e-3, rtol=0.1)
    # 2400 amplitudes of unit mean square: a standard deviation of 2 %, 7 of them.
    np.testing.assert_allclose(fine.power[:, :2].mean((0, 1)), 1.0, rtol=0.15)
    assert fine.strength[:, :2].min() > 5 * THRESHOLD


def test_noise_alone_is_left_alone():
    """A best cell over 6 was found in 0.1 % of 20000 scenes of noise; in four or more of 20: 5e-9."""
    z = simulate(7, torch.zeros(20, 0, 1), eta=2.0)
    found = make_detector()(from_snapshots(z))
    assert found.present.any(-1).sum() < 4
    nothing = ~found.present.any(-1)
    energy = z.abs().square().mean((-2, -1))
    torch.testing.assert_close(found.noise[nothing], energy[nothing])


@pytest.mark.parametrize(("scene", "separation"), [(LINE, 3.0), (PLANE, 2.0)])
def test_picks_are_those_of_the_plain_method(scene, separation):
    field, region = scene
    detector = make_detector(scene, threshold=1.0, refine=False, points=4, separation=separation)
    cells = torch.stack(torch.unravel_index(torch.arange(region.num_cells), region.grid_shape), -1).numpy()
    middle = region.cell_centres()[pairs(8, 4, region.cell_centres(), region.grid_shape, 3)]
    z = simulate(9, middle + 0.2 * region.cell, field=field, eta=0.01, J=3)
    z[..., 1] = torch.nan
    found = detector(from_snapshots(z))
    heard = [m for m in range(field.num_sensors) if m != 1]
    response = build_dictionary(field, region).response[..., heard].numpy()
    for step in range(4):
        expected = matching_pursuit(response, z[step][..., heard].numpy(), cells, 4, separation, 1.0)
        here = found.position[step, found.present[step]]
        picked = (detector.points[:, None] - here).abs().sum(-1).argmin(0)
        assert sorted(picked.tolist()) == sorted(expected)
        assert len(expected) > 1


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize(("scene", "separation"), [(LINE, 3.0), (PLANE, 2.0)])
def test_points_keep_their_separation_and_come_in_order_of_strength(scene, separation, refine):
    field, region = scene
    z = simulate(10, torch.zeros(8, 0, region.num_coordinates), field=field, eta=1.0)
    found = make_detector(scene, threshold=0.0, refine=refine, separation=separation)(from_snapshots(z))
    assert found.present.sum() > 30
    apart = (found.position[:, :, None] - found.position[:, None]).abs() / region.cell
    both = found.present[:, :, None] & found.present[:, None] & ~torch.eye(5, dtype=torch.bool)
    assert (apart.amax(-1)[both] > separation - 2e-3).all()
    assert region.contains(found.position[found.present]).all()
    assert found.strength.diff(dim=-1).le(0).all()
    assert found.present.int().diff(dim=-1).le(0).all()


def test_more_points_than_sensors_can_tell_apart():
    z = simulate(11, torch.zeros(2, 0, 1), eta=1.0)
    found = make_detector(threshold=0.0, points=12)(from_snapshots(z))
    assert (found.present.sum(-1) < 8).all()
    for values in found:
        assert values.isfinite().all()


@pytest.mark.parametrize("bearing", [-69.9, 69.8])
def test_a_source_at_the_edge_of_the_region(bearing):
    found = make_detector()(from_snapshots(simulate(12, [[[bearing]]] * 3)))
    assert (found.present.sum(-1) == 1).all()
    assert (found.position[:, 0] - bearing).abs().max() < 0.25
    assert LINE[1].contains(found.position).all()


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_the_unit_of_the_data_does_not_matter(scale):
    detector = make_detector((make_field(torch.float32), make_region(torch.float32)))
    z = simulate(13, [[[-31.3], [14.6]]] * 3, eta=1e-3).to(torch.complex64)
    ours, theirs = detector(from_snapshots(z)), detector(from_snapshots(scale * z))
    factor = torch.tensor(scale**2)
    scaled = theirs._replace(power=theirs.power / factor, noise=theirs.noise / factor)
    torch.testing.assert_close(theirs.present, ours.present)
    torch.testing.assert_close(theirs.position, ours.position, rtol=0, atol=0.1)
    torch.testing.assert_close(scaled.power, ours.power, rtol=0.02, atol=1e-6)
    torch.testing.assert_close(scaled.noise, ours.noise, rtol=0.05, atol=0)


def test_missing_sensors_are_as_if_they_did_not_exist():
    z = simulate(14, [[[-31.3], [14.6]]] * 4, eta=1e-3)
    z[..., 2] = torch.nan
    heard = [m for m in range(8) if m != 2]
    shorter = LineArrayField(FREQS, [POSITIONS[m] for m in heard], dtype=F64)
    found = make_detector()(from_snapshots(z))
    expected = make_detector((shorter, LINE[1]))(from_snapshots(z[..., heard]))
    same(found, expected._replace(power=expected.power * 8 / 7))
    assert (found.present.sum(-1) == 2).all()


def test_tones_without_data_say_nothing():
    z = simulate(15, [[[-31.3], [14.6]]] * 4, eta=1e-3)
    z[:, 1] = torch.nan
    one = LineArrayField(FREQS[:1], POSITIONS, dtype=F64)
    found = make_detector()(from_snapshots(z))
    expected = make_detector((one, LINE[1]))(from_snapshots(z[:, :1]))
    torch.testing.assert_close(found.position, expected.position)
    torch.testing.assert_close(found.strength, expected.strength)
    assert found.present.any()
    assert found.power[..., 1].eq(0).all()


@pytest.mark.parametrize("value", [0.0, torch.nan])
def test_nothing_heard_is_nothing_found(value):
    found = make_detector(threshold=0.0)(
        from_snapshots(torch.full((2, 2, 3, 8), value, dtype=torch.complex128))
    )
    assert not found.present.any()
    for values in found:
        assert values.isfinite().all()
    assert found.noise.eq(0).all()


def test_data_without_noise_are_explained_by_their_sources():
    found = make_detector(threshold=0.0)(from_snapshots(simulate(16, [[[-31.0], [15.0]]] * 3, eta=0.0)))
    assert (found.present.sum(-1) == 2).all()
    for values in found:
        assert values.isfinite().all()


def test_covariances_are_as_good_as_snapshots():
    z = simulate(17, [[[-31.3], [14.6]]] * 3, eta=1e-3)
    found = make_detector()(from_covariance(sample_covariance(z), 6))
    same(found, make_detector()(from_snapshots(z)), rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "threshold"), [(18, THRESHOLD), (20, 0.0)])
def test_a_step_does_not_depend_on_the_others_of_a_batch(seed, threshold):
    """12 steps of 6 columns are more than are multiplied at once."""
    z = simulate(seed, [[[-31.3], [14.6]]] * 12, eta=1e-3)
    z[3], z[5, 0, :, 3], z[6, 1] = torch.nan, torch.nan, torch.nan
    z[7:9] = simulate(seed + 1, torch.zeros(2, 0, 1), eta=1.0)
    measurement, detector = from_snapshots(z.reshape(3, 4, 2, 6, 8)), make_detector(threshold=threshold)
    together = detector(measurement)
    assert together.present.shape == (3, 4, 5)
    for b, k in itertools.product(range(3), range(4)):
        alone = detector(Measurement(*(t[b, k] for t in measurement)))
        same(Points(*(t[b, k] for t in together)), alone)


@pytest.mark.parametrize("steps", [(), (3,)])
def test_a_field_for_each_sequence(steps):
    other = LineArrayField(FREQS, [1.1 * x for x in POSITIONS], dtype=F64)
    field = StackedField([LINE[0], other])
    sources = [[[-31.3], [14.6]]] * 3
    data = torch.stack([simulate(20 + b, sources, field=f, eta=1e-3) for b, f in enumerate(field.fields)])
    measurement = from_snapshots(data if steps else data[:, 0])
    together = make_detector((field, LINE[1]))(measurement)
    assert together.present.shape == (2, *steps, 5)
    for b, one in enumerate(field.fields):
        alone = make_detector((one, LINE[1]))(Measurement(*(t[b] for t in measurement)))
        same(Points(*(t[b] for t in together)), alone)
        assert (alone.present.sum(-1) == 2).all()
        assert (alone.position[..., :2, 0].sort(-1).values - torch.tensor([-31.3, 14.6])).abs().max() < 0.2


def test_points_above_a_strength():
    found = make_detector(threshold=0.0)(from_snapshots(simulate(22, [[[-31.3], [14.6]]], eta=1e-3)))
    assert found.present.sum() == 5
    assert found.above(float(found.strength[0, 1])).present[0].tolist() == [True, True, False, False, False]


def test_sequences_with_fields_of_their_own_may_run_out_of_points():
    """One sequence has nothing left to pick while another goes on."""
    stacked = StackedField([LINE[0], LINE[0]])
    z = torch.stack([simulate(24, [[[-31.0], [15.0]]])[0], simulate(25, [[[15.0]]])[0]])
    together = make_detector((stacked, LINE[1]))(from_snapshots(z))
    assert together.present.sum(-1).tolist() == [2, 1]
    for index in range(2):
        alone = make_detector()(from_snapshots(z[index]))
        torch.testing.assert_close(together.position[index], alone.position)


def test_picks_go_on_below_the_threshold_of_the_points():
    """The points kept are those of all picks, and as strong as they are beside them."""
    z = from_snapshots(simulate(26, [[[-31.3], [14.6]]], eta=1e-2))
    everything = make_detector(threshold=0.0)(z)
    strong = make_detector(threshold=20.0, pick_threshold=0.0)(z)
    assert everything.present.sum() == 5
    assert strong.present.sum() == 2
    same(strong._replace(present=everything.present), everything)


def test_pick_threshold_out_of_range():
    with pytest.raises(InputError, match=r"tracker\.detector\.pick_threshold.*-1"):
        PursuitConfig(pick_threshold=-1.0)
