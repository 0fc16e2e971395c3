"""Normal modes of a layered waveguide by finite differences, in float64 on the CPU."""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import LinAlgError, eigh, eigh_tridiagonal, svd

from torchdt.field.waveguide.environment import Environment, HalfSpace, Layer

Array = NDArray[np.float64]

# A mode is cut off where it has decayed by this many nepers below the seafloor; the false bottom there
# changes its squared wavenumber by a relative exp(-2 * 15) = 1e-13.
_DECAY_NEPERS = 15.0
# Share of a mode in the span of those of the other mesh below which the meshes do not have the same modes.
_MIN_OVERLAP = 0.99
_MAX_POINTS = 1000
_NEPER_PER_DB = math.log(10.0) / 20.0


class ModeSolverError(RuntimeError):
    """The modes of a waveguide could not be computed."""


@dataclass(frozen=True)
class ModeTable:
    """Modes of one frequency, by descending wavenumber. The arrays are shared by a cache and read-only.

    Attributes:
        wavenumber: `(N,)` horizontal wavenumbers, rad/m.
        attenuation: `(N,)` modal attenuations, Np/m.
        depth: `(G,)` uniform grid from the surface to the seafloor, m.
        psi: `(G, N)` mode functions, `integral psi^2 / rho dz = 1` over water and bottom (rho in g/cm^3).
        slope: `(G, N)` their derivatives in depth, 1/m.
    """

    wavenumber: Array
    attenuation: Array
    depth: Array
    psi: Array
    slope: Array


@dataclass(frozen=True)
class _Mesh:
    """Elements of a depth mesh, each with linear sound speed: `(E,)` arrays."""

    size: Array
    speed_top: Array
    speed_bottom: Array
    density: Array
    attenuation: Array  # Np/m, the part that is the same at all speeds
    loss_parameter: Array  # Np/rad, the part that goes with the wavenumber omega / c

    def halved(self) -> "_Mesh":
        middle = (self.speed_top + self.speed_bottom) / 2
        return _Mesh(
            np.repeat(self.size / 2, 2),
            np.column_stack([self.speed_top, middle]).ravel(),
            np.column_stack([middle, self.speed_bottom]).ravel(),
            np.repeat(self.density, 2),
            np.repeat(self.attenuation, 2),
            np.repeat(self.loss_parameter, 2),
        )


@lru_cache(maxsize=512)
def solve_modes(
    environment: Environment,
    frequency: float,
    max_phase_speed: float = 1750.0,
    points_per_wavelength: float = 16.0,
    grid_step: float = 0.5,
) -> ModeTable:
    """Trapped modes of a waveguide.

    Solves `rho (psi' / rho)' + (omega^2 / c^2 - k^2) psi = 0`, `psi = 0` at the surface, `psi` and
    `psi' / rho` continuous, on two meshes, the second with half the step, and extrapolates wavenumbers,
    attenuations and mode functions to step zero. Equation, scheme, extrapolation and the perturbation formula
    of the attenuation are those of Jensen, Kuperman, Porter and Schmidt, Computational Ocean Acoustics, 2nd
    ed. 2011, ch. 5. Extrapolated is the operator within the span of all modes, since modes of almost the same
    wavenumber mix differently on each mesh while their span does not. Results are cached.

    Args:
        environment: the waveguide.
        frequency: Hz.
        max_phase_speed: modes of a higher phase speed are left out, m/s. It must be below the sound speed of
            the half-space, so that every mode decays in it.
        points_per_wavelength: mesh points per wavelength at the lowest sound speed, on the coarser mesh.
        grid_step: largest step of the depth grid of the result, m.

    Raises:
        ValueError: if an argument is not positive, or `max_phase_speed` or `points_per_wavelength` too high.
        ModeSolverError: if there is no mode below `max_phase_speed`, as below the cutoff of the waveguide, if
            the eigenvalue solver fails, or if the two meshes disagree.
    """
    for name, value in (
        ("frequency", frequency),
        ("max_phase_speed", max_phase_speed),
        ("points_per_wavelength", points_per_wavelength),
        ("grid_step", grid_step),
    ):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}; expected a positive number")
    if points_per_wavelength > _MAX_POINTS:
        raise ValueError(
            f"points_per_wavelength is {points_per_wavelength}; expected {_MAX_POINTS} or fewer, "
            "for the memory of the mesh"
        )
    if max_phase_speed >= environment.halfspace.speed:
        raise ValueError(
            f"max_phase_speed is {max_phase_speed}; expected less than the speed of the half-space, "
            f"{environment.halfspace.speed}"
        )
    coarse = _build_mesh(environment, frequency, max_phase_speed, points_per_wavelength)
    k2_coarse, loss_coarse, psi_coarse = _solve_mesh(coarse, frequency, max_phase_speed)
    k2_fine, loss_fine, psi_fine = _solve_mesh(coarse.halved(), frequency, max_phase_speed)

    # A mode right at the limit may be there on one mesh only.
    n = min(len(k2_coarse), len(k2_fine))
    if n == 0:
        raise ModeSolverError(
            f"no mode at {frequency} Hz with a phase speed below max_phase_speed, {max_phase_speed} m/s: the "
            "frequency is below the cutoff of the waveguide; leave it out, or raise max_phase_speed towards "
            f"the speed of the half-space, {environment.halfspace.speed} m/s"
        )
    psi_coarse, psi_fine = psi_coarse[:, :n], psi_fine[::2, :n]
    half_mass = coarse.size / (2 * coarse.density)
    left, overlap, right = svd((psi_coarse.T * _lump(half_mass, half_mass)) @ psi_fine)
    if overlap.min() < _MIN_OVERLAP:
        raise ModeSolverError(
            f"two meshes give different modes at {frequency} Hz (overlap {overlap.min():.3f}, "
            f"expected above {_MIN_OVERLAP}); raise points_per_wavelength, now {points_per_wavelength}"
        )
    turn = left @ right  # of the coarse modes, to be most like the fine ones
    operator = _extrapolate((turn.T * k2_coarse[:n]) @ turn, np.diag(k2_fine[:n]))
    k2, mix = eigh(operator)
    k2, mix = k2[::-1], mix[:, ::-1]
    wavenumber = np.sqrt(k2)
    loss = _extrapolate(turn.T @ loss_coarse[:n, :n] @ turn, loss_fine[:n, :n])
    attenuation = np.einsum("in,ij,jn->n", mix, loss, mix) / wavenumber
    psi = _extrapolate(psi_coarse @ turn, psi_fine) @ mix

    nodes = np.concatenate([[0.0], np.cumsum(coarse.size)])
    in_water = nodes < environment.water_depth + coarse.size.min() / 2
    psi = psi[in_water]
    speed = environment.profile[-1][1]
    curvature = (wavenumber**2 - (2 * math.pi * frequency / speed) ** 2) * psi[-1]
    spline = CubicSpline(nodes[in_water], psi, bc_type=((2, np.zeros(n)), (2, curvature)))
    depth = np.linspace(
        0.0, environment.water_depth, math.ceil(environment.water_depth / grid_step) + 1, dtype=np.float64
    )
    table = ModeTable(wavenumber, attenuation, depth, spline(depth), spline(depth, 1))
    for array in vars(table).values():
        array.setflags(write=False)
    return table


def _build_mesh(
    environment: Environment, frequency: float, max_phase_speed: float, points_per_wavelength: float
) -> _Mesh:
    """Mesh with nodes at all kinks and jumps, so that the error is a clean series in the squared step."""
    omega = 2 * math.pi * frequency
    # (thickness, speed at top, speed at bottom, density, attenuation, loss parameter) of pieces, speed linear
    pieces = [(z1 - z0, c0, c1, 1.0, 0.0, 0.0) for (z0, c0), (z1, c1) in pairwise(environment.profile)]
    top = environment.water_depth
    for layer in environment.layers:
        loss = _absorption(layer, frequency)
        pieces.append((layer.bottom - top, layer.speed_top, layer.speed_bottom, layer.density, *loss))
        top = layer.bottom
    half = environment.halfspace
    decay = omega * math.sqrt(1 / max_phase_speed**2 - 1 / half.speed**2)
    loss = _absorption(half, frequency)
    pieces.append((_DECAY_NEPERS / decay, half.speed, half.speed, half.density, *loss))

    min_speed = min(min(c0, c1) for _, c0, c1, *_ in pieces)
    step = min_speed / frequency / points_per_wavelength
    columns = []
    for thickness, c0, c1, *uniform in pieces:
        count = math.ceil(thickness / step)
        speed = np.linspace(c0, c1, count + 1)
        same = np.ones(count)
        columns.append([same * thickness / count, speed[:-1], speed[1:], *(same * x for x in uniform)])
    mesh = _Mesh(*(np.concatenate(column) for column in zip(*columns, strict=True)))

    # Leave out what lies deeper than the slowest decaying mode reaches.
    speed_middle = (mesh.speed_top + mesh.speed_bottom) / 2
    depth = np.cumsum(mesh.size)
    below = depth > environment.water_depth + mesh.size.min() / 2
    rate = omega * np.sqrt(np.maximum(1 / max_phase_speed**2 - 1 / speed_middle**2, 0.0))
    decayed = np.cumsum(np.where(below, rate * mesh.size, 0.0))
    end = int(np.searchsorted(decayed, _DECAY_NEPERS)) + 1
    return _Mesh(*(column[:end] for column in vars(mesh).values()))


def _absorption(medium: Layer | HalfSpace, frequency: float) -> tuple[float, float]:
    """Attenuation in Np/m and loss parameter in Np/rad, one of them zero."""
    if medium.attenuation_unit == "dB/wavelength":
        return 0.0, medium.attenuation / (2 * math.pi) * _NEPER_PER_DB
    return medium.attenuation * frequency / 1000 * _NEPER_PER_DB, 0.0


def _solve_mesh(mesh: _Mesh, frequency: float, max_phase_speed: float) -> tuple[Array, Array, Array]:
    """Squared wavenumbers `(N,)`, `k * attenuation` `(N, N)`, mode functions `(E + 1, N)` on the nodes.

    The scheme is the flux balance of the half elements on the two sides of a node. It is symmetrised by the
    square root of the mass `integral dz / rho` around the node.
    """
    omega = 2 * math.pi * frequency
    half_mass = mesh.size / (2 * mesh.density)
    stiffness = 1 / (mesh.density * mesh.size)
    mass = _lump(half_mass, half_mass)[1:-1]
    potential = _lump(
        half_mass * (omega / mesh.speed_top) ** 2, half_mass * (omega / mesh.speed_bottom) ** 2
    )[1:-1]
    diagonal = (potential - stiffness[:-1] - stiffness[1:]) / mass
    off_diagonal = stiffness[1:-1] / np.sqrt(mass[:-1] * mass[1:])
    min_speed = min(mesh.speed_top.min(), mesh.speed_bottom.min())
    limits = ((omega / max_phase_speed) ** 2, (omega / min_speed) ** 2)
    try:
        k2, vectors = eigh_tridiagonal(diagonal, off_diagonal, select="v", select_range=limits)
    except LinAlgError as error:
        raise ModeSolverError(f"eigenvalue solver failed at {frequency} Hz: {error}") from error
    if not (np.isfinite(k2).all() and np.isfinite(vectors).all()):
        raise ModeSolverError(f"eigenvalue solver returned numbers that are not finite at {frequency} Hz")
    k2, vectors = k2[::-1], vectors[:, ::-1]
    psi = np.pad(vectors / np.sqrt(mass)[:, None], ((1, 1), (0, 0)))
    at_top, at_bottom = (
        half_mass * (mesh.attenuation + mesh.loss_parameter * k) * k
        for k in (omega / mesh.speed_top, omega / mesh.speed_bottom)
    )
    loss = _lump(at_top, at_bottom)
    return k2, (psi.T * loss) @ psi, psi


def _lump(at_top: Array, at_bottom: Array) -> Array:
    """Add what the elements give to their two nodes: `(E,)`, `(E,)` to `(E + 1,)`."""
    return np.pad(at_top, (0, 1)) + np.pad(at_bottom, (1, 0))


def _extrapolate(coarse: Array, fine: Array) -> Array:
    """Richardson extrapolation to step zero of a quantity with an error in the squared step."""
    return (4 * fine - coarse) / 3
