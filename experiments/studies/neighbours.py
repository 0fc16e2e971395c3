"""Random scenes of objects close together, small enough to sum over everything that may be there."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.core.weights import normalise
from torchdt.field.plane_wave import LineArrayField
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.configurations import UniformDraws, draw_configurations, labellings
from torchdt.filter.bp.evidence import sampled_evidence
from torchdt.filter.bp.joint import clusters, joint_marginals
from torchdt.filter.bp.schedule import Flooding, Schedule, Sequential
from torchdt.filter.bp.update import update
from torchdt.filter.proposal.moved import respond
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.noise.base import Noise
from torchdt.model.noise.white import WHITE

FREQS, SENSORS, SNAPSHOTS, STATES = (100.0, 150.0), 8, 3, 24
NOISE, POWERS, LEVELS = 1.0, 3, 3
F64 = torch.float64


class Scene(NamedTuple):
    """What is known before the data, the data, and how hard it is.

    Attributes:
        prior: N objects on grids of states.
        response: `(N, I, P, M)` complex.
        noise: of one level, or of several.
        measurement: of one step.
        separation: of neighbours, degrees.
        level: of the weakest object over the strongest, dB.
    """

    prior: Objects
    response: Tensor
    noise: Noise
    measurement: Measurement
    separation: float
    level: float


class Exact(NamedTuple):
    """Marginals by enumeration.

    Attributes:
        existence: `(N,)`.
        state: `(N, P)` given existence.
        log_evidence: of the step.
    """

    existence: Tensor
    state: Tensor
    log_evidence: Tensor


def draw_scene(seed: int) -> Scene:
    """Two or three objects 0 to 15 degrees apart, equal to 25 dB apart, known or new, some of them there."""
    rng = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=rng, dtype=F64)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=rng, dtype=torch.complex128)

    number = 2 + seed % 2
    separation, weaker = float(uniform(0, 15)), float(uniform(-25, 0))
    centre = float(uniform(-30, 30)) + separation * torch.arange(number, dtype=F64)
    level = torch.cat([torch.zeros(1, dtype=F64), torch.full((number - 1,), weaker, dtype=F64)])
    power = SENSORS * NOISE * 10 ** ((float(uniform(5, 15)) + level) / 10)
    known = uniform(0, 1, number) < 0.5
    existence = torch.where(known, uniform(0.5, 0.95, number), uniform(0.05, 0.3, number))
    exists = uniform(0, 1, number) < existence.clamp_min(0.5)
    exists[0] = True
    # Known objects are predicted to a degree or two, new ones lie anywhere in a cell.
    deviation, offset = uniform(0.7, 2.0, number), uniform(-1.0, 1.0, number)
    along = torch.linspace(-5, 5, STATES, dtype=F64)
    state = (centre - offset * deviation)[:, None] + along
    bell = torch.exp(-0.5 * (along / deviation[:, None]).square())
    weight = torch.where(known[:, None], bell, torch.ones_like(bell))
    positions = [5.0 * m for m in range(SENSORS)]
    field = LineArrayField(FREQS, positions, dtype=F64)
    response = respond(field, state[..., None])
    truth = respond(field, centre[:, None, None])[:, :, 0]  # (N, I, M)
    tones = len(FREQS)
    amplitude = (power * exists)[:, None, None].sqrt() * normal(number, tones, SNAPSHOTS)
    snapshots = math.sqrt(NOISE) * normal(tones, SNAPSHOTS, SENSORS)
    snapshots = snapshots + (amplitude[..., None] * truth[:, :, None]).sum(0)
    points = torch.logspace(-0.5, 0.5, POWERS, dtype=F64)
    levels = LEVELS if seed % 4 < 2 else 1
    spread = torch.logspace(-0.15, 0.15, levels, dtype=F64) if levels > 1 else torch.ones(1, dtype=F64)
    prior = Objects(
        state=state[..., None],
        log_weight=(weight / weight.sum(-1, keepdim=True)).log(),
        power=(power[:, None, None] * points).expand(-1, tones, -1),
        log_power_weight=torch.full((number, tones, POWERS), -math.log(POWERS), dtype=F64),
        log_odds=torch.logit(existence),
        label=torch.zeros(number, dtype=torch.int64),
        transmits=torch.ones_like(state),
    )
    noise = Noise(
        (NOISE * spread).expand(tones, -1), torch.full((tones, levels), -math.log(levels), dtype=F64)
    )
    return Scene(prior, response, noise, from_snapshots(snapshots), separation, weaker)


def enumerate_scene(scene: Scene) -> Exact:
    """Sum over existence, states, powers and noise of everything."""
    prior, number = scene.prior, len(scene.prior.log_odds)
    existence, log_rows = torch.sigmoid(prior.log_odds), []
    states = torch.full((number, STATES), -torch.inf, dtype=F64)
    there = torch.full((number,), -torch.inf, dtype=F64)
    for pattern in itertools.product((0, 1), repeat=number):
        here = [n for n in range(number) if pattern[n]]
        log_joint = torch.where(torch.tensor(pattern) > 0, existence, 1 - existence).log().sum()
        shape = [STATES] * len(here)
        log_joint = log_joint.expand(shape) + _log_likelihood(scene, here)
        for axis, n in enumerate(here):
            log_joint = log_joint + prior.log_weight[n].reshape(
                [-1 if a == axis else 1 for a in range(len(here))]
            )
        total = log_joint.flatten().logsumexp(0)
        log_rows.append(total)
        for axis, n in enumerate(here):
            rest = log_joint.movedim(axis, 0).flatten(1).logsumexp(-1) if len(here) > 1 else log_joint
            states[n] = torch.logaddexp(states[n], rest)
            there[n] = torch.logaddexp(there[n], total)
    log_evidence = torch.stack(log_rows).logsumexp(0)
    return Exact((there - log_evidence).exp(), normalise(states)[0].exp(), log_evidence)


def _log_likelihood(scene: Scene, here: list[int]) -> Tensor:
    """Of all states of the objects that exist, powers and noise summed over, `(P, ..., P)`."""
    total = torch.zeros([STATES] * len(here), dtype=F64)
    for i in range(len(FREQS)):
        scatter = scene.measurement.factor[i] @ scene.measurement.factor[i].mH
        terms = []
        for noise, log_noise in zip(scene.noise.variance[i], scene.noise.log_weight[i], strict=True):
            for g in itertools.product(range(POWERS), repeat=len(here)):
                columns = []
                for axis, n in enumerate(here):
                    column = scene.response[n, i] * scene.prior.power[n, i, g[axis]].sqrt()
                    view = [1] * len(here) + [SENSORS]
                    view[axis] = STATES
                    columns.append(column.reshape(view).expand(*total.shape, -1))
                weight = sum(scene.prior.log_power_weight[n, i, k] for n, k in zip(here, g, strict=True))
                terms.append(_gaussian(columns, scatter, float(noise)) + log_noise + weight)
        total = total + torch.stack([t.expand(total.shape) for t in terms]).logsumexp(0)
    return total


def _gaussian(columns: list[Tensor], scatter: Tensor, noise: float) -> Tensor:
    constant = -SNAPSHOTS * SENSORS * math.log(math.pi * noise) - scatter.diagonal().sum().real / noise
    if not columns:
        return constant
    matrix = torch.stack(columns, -1)
    eye = torch.eye(len(columns), dtype=matrix.dtype)
    lower = torch.linalg.cholesky(eye + matrix.mH @ matrix / noise)
    log_det = 2 * lower.diagonal(dim1=-2, dim2=-1).real.log().sum(-1)
    root = torch.linalg.cholesky(scatter + 1e-9 * torch.eye(SENSORS))
    solved = torch.linalg.solve_triangular(lower, matrix.mH @ root, upper=False)
    return constant - SNAPSHOTS * log_det + solved.abs().square().sum((-2, -1)) / noise**2


def messages(scene: Scene, schedule: Schedule, sweeps: int = 3) -> Beliefs:
    """Beliefs of BP."""
    at = scene.prior, scene.response, scene.noise, scene.measurement
    return update(*at, sweeps=sweeps, schedule=schedule)


def joint(scene: Scene, beliefs: Beliefs, seed: int, samples: int = 64, coherence: float = 0.25) -> Beliefs:
    """Beliefs of BP, those of overlapping objects from joint configurations."""
    number = len(scene.prior.log_odds)
    exchange = torch.ones(number, number, dtype=torch.bool)
    streams = RandomStreams.from_seeds([seed], (), F64)
    draws = UniformDraws.draw(streams, number, len(FREQS), samples)
    cluster = clusters(beliefs, coherence, exchange)
    at = scene.prior, scene.response, scene.measurement
    return joint_marginals(*at, beliefs, cluster, exchange, draws, WHITE)


def evidence(scene: Scene, beliefs: Beliefs, seed: int, samples: int = 64) -> Tensor:
    """The sampled evidence, with beliefs as the proposal."""
    number = len(scene.prior.log_odds)
    exchange = torch.ones(number, number, dtype=torch.bool)
    draws = UniformDraws.draw(RandomStreams.from_seeds([1000 + seed], (), F64), number, len(FREQS), samples)
    found = labellings(scene.prior, scene.response, scene.measurement, beliefs, exchange)
    drawn = draw_configurations(*found, beliefs.noise, draws)
    return sampled_evidence(scene.prior, scene.response, scene.noise, scene.measurement, drawn)


class Errors(NamedTuple):
    """Of the marginals of one scene.

    Attributes:
        existence: `(N,)` believed less exact.
        exact: `(N,)` existence.
        variation: `(N,)` total variation of the states, given existence.
        log_evidence: estimated less exact.
    """

    existence: Tensor
    exact: Tensor
    variation: Tensor
    log_evidence: Tensor


def errors(scene: Scene, exact: Exact, beliefs: Beliefs, seed: int) -> Errors:
    """Of beliefs."""
    found = beliefs.objects
    variation = 0.5 * (found.log_weight.exp() - exact.state).abs().sum(-1)
    error = torch.sigmoid(found.log_odds) - exact.existence
    return Errors(error, exact.existence, variation, evidence(scene, beliefs, seed) - exact.log_evidence)


def all_errors(scene: Scene, seed: int) -> dict[str, Errors]:
    """Of every method, by name."""
    exact, sequential = enumerate_scene(scene), messages(scene, Sequential())
    beliefs = {
        "flooding": messages(scene, Flooding()),
        "sequential": sequential,
        "sequential, 12 sweeps": messages(scene, Sequential(), 12),
        "joint": joint(scene, sequential, seed),
    }
    return {name: errors(scene, exact, belief, seed) for name, belief in beliefs.items()}


def summary(found: Sequence[Errors]) -> list[float]:
    """Mean and rms error of existence, share on the wrong side of a half, variation of states, evidence.

    The median over the states of objects that may be there; of the evidence the median error and the rms.
    """
    error, exact, variation, evidence = (
        torch.cat([torch.atleast_1d(t) for t in part]) for part in zip(*found, strict=True)
    )
    wrong = (exact > 0.5) != (exact + error > 0.5)
    numbers = (
        error.mean(),
        error.square().mean().sqrt(),
        wrong.double().mean(),
        variation[exact > 0.05].median() if bool((exact > 0.05).any()) else torch.tensor(torch.nan),
        evidence.abs().median(),
        evidence.square().mean().sqrt(),
    )
    return [float(x) for x in numbers]
