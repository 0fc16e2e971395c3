import itertools
import math

import pytest
import torch
from oracles.detectors import planar_region

from torchdt.baselines.detect.peaks import Grid, close, find_peaks
from torchdt.core.errors import InputError

F64 = torch.float64


def open_grid(shape) -> Grid:
    return Grid(tuple(shape), tuple(False for _ in shape))


def peaks(surface, number: int = 5, separation: float = 1.0) -> list[tuple[int, ...]]:
    """Coordinates of the peaks of one surface given as a grid."""
    grid = torch.as_tensor(surface, dtype=F64)
    index, present = find_peaks(grid.flatten(), open_grid(grid.shape), number, separation)
    assert index.shape == present.shape == (number,)
    assert index[~present].eq(0).all()
    assert present.int().diff().le(0).all()
    return [tuple(int(c) for c in torch.unravel_index(i, grid.shape)) for i in index[present]]


def slow_peaks(grid: torch.Tensor, number: int, separation: float) -> list[tuple[int, ...]]:
    """By loops, for surfaces without plateaus."""
    cells = list(itertools.product(*(range(n) for n in grid.shape)))
    found = []
    for cell in cells:
        around = [
            o for o in cells if o != cell and all(abs(a - b) <= 1 for a, b in zip(o, cell, strict=True))
        ]
        if grid[cell] > 0 and all(grid[cell] > grid[o] for o in around):
            found.append(cell)
    kept: list[tuple[int, ...]] = []
    for cell in sorted(found, key=lambda c: -float(grid[c])):
        if not any(all(abs(a - b) < separation for a, b in zip(cell, k, strict=True)) for k in kept):
            kept.append(cell)
    return kept[:number]


@pytest.mark.parametrize("shape", [(40,), (9, 13), (5, 6, 4)])
@pytest.mark.parametrize("separation", [1.0, 2.5, 4.0])
def test_peaks_are_those_of_the_loop(shape, separation):
    rng = torch.Generator().manual_seed(len(shape))
    for _ in range(5):
        grid = torch.randn(shape, generator=rng, dtype=F64)
        found = peaks(grid, 6, separation)
        assert found == slow_peaks(grid, 6, separation)
        assert found


def test_the_edge_may_be_a_peak():
    assert peaks([3.0, 1.0, 0.5, 2.0]) == [(0,), (3,)]
    assert peaks([[1.0, 0.2, 0.3], [0.1, 0.1, 0.4]]) == [(0, 0), (1, 2)]


def test_what_is_not_positive_is_no_peak():
    assert peaks([0.0, 0.0, 0.0]) == []
    assert peaks([-1.0, -0.5, -1.0, 0.0, -1.0]) == []


def test_a_plateau_counts_once():
    assert len(peaks([1.0, 2.0, 2.0, 2.0, 2.0, 1.0])) == 1
    assert len(peaks(torch.ones(4, 5))) == 1
    # Bent, so that no cell of it is beside all the others.
    bent = torch.zeros(7, 7)
    bent[1, 1:6] = bent[1:6, 5] = bent[5, 2:6] = 2.0
    assert len(peaks(bent)) == 1
    bent[3, 1] = 2.0
    assert len(peaks(bent)) == 2


def test_a_shoulder_is_no_peak():
    assert peaks([1.0, 2.0, 2.0, 2.0, 3.0, 0.0]) == [(4,)]
    assert peaks([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]]) == [(2, 2)]


def test_peaks_close_to_a_stronger_one_are_dropped():
    surface = [0.0, 5.0, 0.0, 4.0, 0.0, 3.0, 0.0]
    assert peaks(surface, separation=2.0) == [(1,), (3,), (5,)]
    # The last one is close only to one that is dropped itself.
    assert peaks(surface, separation=2.5) == [(1,), (5,)]
    assert peaks(surface, separation=4.5) == [(1,)]


def test_peaks_are_close_only_where_they_are_so_in_every_coordinate():
    grid = torch.zeros(4, 9)
    grid[0, 0], grid[0, 8], grid[2, 1] = 3.0, 2.0, 1.0
    assert peaks(grid, separation=3.0) == [(0, 0), (0, 8)]
    assert peaks(grid, separation=2.0) == [(0, 0), (0, 8), (2, 1)]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cells_at_the_separation_are_apart_whatever_their_rounding(dtype):
    region = planar_region(dtype)
    grid = region.cell_centres().reshape(*region.grid_shape, 2)
    assert not close((grid[3:] - grid[:-3]) / region.cell, 3.0).any()
    assert not close((grid[:, 3:] - grid[:, :-3]) / region.cell, 3.0).any()
    assert close((grid[2:, 2:] - grid[:-2, :-2]) / region.cell, 3.0).all()


def test_no_more_peaks_than_asked_for():
    assert peaks([1.0, 0.0, 3.0, 0.0, 2.0], number=2) == [(2,), (4,)]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_surface_does_not_depend_on_the_others_of_a_batch(dtype):
    rng = torch.Generator().manual_seed(7)
    surface = torch.randn(3, 2, 48, generator=rng, dtype=dtype)
    surface[1, 0, 4:20] = 5.0
    surface[2, 1] = -1.0
    index, present = find_peaks(surface, open_grid((6, 8)), 4, 2.0)
    assert index.shape == present.shape == (3, 2, 4)
    assert present.any(-1).flatten().tolist() == [True] * 5 + [False]
    for b, k in itertools.product(range(3), range(2)):
        alone = find_peaks(surface[b, k], open_grid((6, 8)), 4, 2.0)
        assert torch.equal(index[b, k], alone[0])
        assert torch.equal(present[b, k], alone[1])


@pytest.mark.parametrize(("shape", "key"), [((2, 2, 2, 2), "'grid'"), ((), "'grid'"), ((3, 5), "surface")])
def test_a_grid_that_does_not_fit_is_refused(shape, key):
    with pytest.raises(InputError, match=key):
        find_peaks(torch.zeros(16 if key == "surface" else math.prod(shape)), open_grid(shape), 2, 1.0)


@pytest.mark.parametrize("closed", [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize("separation", [1.0, 3.0])
def test_peaks_of_a_closed_coordinate_turn_with_the_surface(closed, separation):
    """Wherever the seam lies: single cells, and a plateau that it cuts."""
    shape, turns = (9, 12), [4 * c for c in closed]
    grid = torch.randn(shape, generator=torch.Generator().manual_seed(5), dtype=F64)
    grid[:, 0] = grid[:, -1] = 5.0

    def found(surface: torch.Tensor) -> set[tuple[int, ...]]:
        index, present = find_peaks(surface.flatten(), Grid(shape, closed), 4, separation)
        cells = torch.stack(torch.unravel_index(index[present], shape), -1)
        return {surface[tuple(cell)].item() for cell in cells}

    assert found(grid.roll(turns, (0, 1))) == found(grid)


def test_two_sides_of_the_seam_are_one_peak():
    surface = torch.tensor([3.0, 1.0, 0.5, 0.2, 1.0, 2.9])
    for closed, cells in ((True, [0]), (False, [0, 5])):
        index, present = find_peaks(surface, Grid((6,), (closed,)), 3, 1.0)
        assert index[present].tolist() == cells
