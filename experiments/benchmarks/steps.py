"""Time of the parts of a step, of the whole, and of many sequences at once."""

import itertools
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import torch
from torch import Tensor

from benchmarks.clock import clock_in_turn
from benchmarks.report import Measured
from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import Systematic
from torchdt.data.recording import Recording
from torchdt.filter.bp.moments import response_moment, signal_covariance
from torchdt.filter.bp.update import update
from torchdt.filter.context import StepContext
from torchdt.filter.declare import posterior, report
from torchdt.filter.direct import DirectTracker
from torchdt.filter.placement import Placer
from torchdt.filter.proposal.moved import respond
from torchdt.filter.proposal.newborn import propose_newborn
from torchdt.filter.proposal.search import search
from torchdt.filter.state import Objects, TrackerState
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise
from torchdt.model.noise.white import update_noise
from torchdt.model.part import append_dims
from torchdt.model.prior import Priors
from torchdt.run.track import track

ROUNDS = 5
"""Calls of every part for each repeat: parts take milliseconds."""

WHOLE = "whole step"

Part = tuple[Callable[[], Any], str]
"""What is called, and what there is to say about it."""


def measure_step(tracker: DirectTracker, recording: Recording, warm_up: int, repeats: int) -> list[Measured]:
    """Parts of a step of one sequence, on the state that tracking has reached.

    Parts contain one another, so that their shares do not add up to one.

    Args:
        tracker: the tracker.
        recording: of more steps than `warm_up`; its first sequence is tracked.
        warm_up: steps before the one that is timed.
        repeats: medians are over `ROUNDS` times as many calls, one part after another.

    Raises:
        InputError: where there is no source to be found in that step.
    """
    prepared = tracker.prepare(recording.select(slice(1)))
    region, priors = tracker.region, prepared.priors
    streams = RandomStreams.from_seeds([0], (1,), region.low.dtype, region.low.device)
    state = tracker.init(priors)
    # Inference mode would make a state from which no gradient can be taken.
    with torch.no_grad():
        for k in range(warm_up):
            state, _ = tracker.step(state, prepared.measurement.at(k), priors, streams)
        measurement = prepared.measurement.at(warm_up)
        parts = forward_parts(tracker, state, measurement, priors, streams)
    calls = {name: torch.inference_mode()(call) for name, (call, _) in parts.items()}
    with_gradient = gradient_parts(tracker, state, measurement, priors, streams)
    calls |= {name: call for name, (call, _) in with_gradient.items()}
    taken = clock_in_turn(calls, ROUNDS * repeats, region.low.device)
    seconds = {name: median(times) for name, times in taken.items()}
    rows: list[tuple[str, float, str, str]] = []
    for name, (_, note) in (parts | with_gradient).items():
        rows.append((name, 1e3 * seconds[name], "ms", note))
        if name != WHOLE:
            rows.append((f"{name} / {WHOLE}", seconds[name] / seconds[WHOLE], "ratio", ""))
    speed = f"steps of {recording.step_s:g} s, one sequence"
    rows.append(("times real time", recording.step_s / seconds[WHOLE], "ratio", speed))
    return [Measured("step", *row) for row in rows]


def forward_parts(
    tracker: DirectTracker,
    state: TrackerState,
    measurement: Measurement,
    priors: Priors,
    streams: RandomStreams,
) -> dict[str, Part]:
    """The functions of which `DirectTracker.step` is made, on what it gives them.

    Args:
        tracker: the tracker.
        state: belief before the step, batch `(1,)`.
        measurement: statistics of the step.
        priors: limits of the priors.
        streams: random numbers.
    """
    cfg, field, region, noise = tracker.config, tracker.field, tracker.region, state.noise
    draws = tracker.draw(streams)
    tempered = measurement.tempered(append_dims(tracker.model.likelihood_power, 1))
    born = tracker.model.birth.log_odds(region, tracker.dictionary.points[None]).amax(-1)
    context = StepContext(field, region, tracker.model, tracker.model.noise, tempered)
    placer = Placer(context, tracker.dictionary, cfg)

    predicted = tracker.predict(state, draws.driving)
    placing = (predicted, priors, draws.known, draws.newborn, draws.picks)
    placed, _ = placer.place(*placing)
    sweep = partial(
        update,
        placed.objects,
        placed.response,
        noise,
        tempered,
        schedule=cfg.schedule,
        initial=placed.beliefs,
    )
    beliefs = sweep(sweeps=cfg.sweeps)
    exact = context._replace(measurement=measurement)
    weighing = (exact, predicted, placed, beliefs, draws.evidence)
    log_evidence = tracker.evidence(*weighing)
    signal = signal_covariance(beliefs.strength, beliefs.moment)
    occupied = placed.objects.log_odds.isfinite().sum(-1)

    look = partial(
        search,
        field,
        region,
        tracker.dictionary,
        tempered,
        threshold=cfg.pick_threshold(born),
        rounds=draws.picks,
        proposal=cfg.proposal,
    )
    nothing = torch.zeros_like(signal)
    picks, explained, _ = look(nothing, noise, torch.full_like(occupied, cfg.slots))
    if picks is None:
        raise InputError.of_key("overrides", "a step in which nothing is found", "data with a source")
    model = tracker.model
    found = (picks, explained, priors.power_max, model, cfg.power_points, draws.newborn)

    particles, log_weight = placed.objects.state, beliefs.objects.log_weight
    always = Systematic(below=1.0)
    resampling = always.draw(streams, *particles.shape[-3:])
    one = f"{cfg.particles} particles"
    objects, born_objects = f"{int(occupied)} objects", f"{int(picks.active.sum())} objects"
    slot_state, slot_response = particles[:, 0], placed.response[:, 0]
    slot_weight = log_weight[:, 0]
    return {
        "field": (partial(respond, field, slot_state), one),
        "prediction": (partial(tracker.predict, state, draws.driving), f"{objects}, their field included"),
        "moment matching": (partial(response_moment, slot_response, slot_weight), one),
        "messages of one sweep": (partial(sweep, sweeps=1), f"{objects}, moments and noise included"),
        "update": (partial(sweep, sweeps=cfg.sweeps), f"all {cfg.sweeps} sweeps"),
        "noise update": (partial(update_noise, noise, tempered, signal), "one of several"),
        "search for new objects": (
            partial(look, signal, noise, cfg.slots - occupied),
            "in what known objects leave",
        ),
        "newborn proposal": (
            partial(propose_newborn, field, region, tempered, nothing, *found, proposal=cfg.proposal),
            f"{born_objects}, as if nothing were known; no part of a step in which none is found",
        ),
        "placement": (partial(placer.place, *placing), "known objects' proposals, search, newborn proposal"),
        "resampling": (
            partial(always.resample, particles, log_weight, resampling),
            f"{objects}, with roughening; no part of a step with adapted proposals",
        ),
        "evidence": (partial(tracker.evidence, *weighing), str(cfg.evidence)),
        "conclusion": (
            partial(
                report, posterior(placed.objects, beliefs), beliefs.noise, state, log_evidence, region, cfg
            ),
            "",
        ),
        WHOLE: (partial(tracker.step, state, measurement, priors, streams), f"{cfg.slots} slots, {one}"),
    }


def gradient_parts(
    tracker: DirectTracker,
    state: TrackerState,
    measurement: Measurement,
    priors: Priors,
    streams: RandomStreams,
) -> dict[str, Part]:
    """A step in the middle of a sequence whose likelihood is differentiated; see `forward_parts`.

    The gradient comes in through the evidence and through what the step leaves to the next one, and goes out
    to the numbers of the model and to what the step was given.
    """
    leaves = {name: _leaf(value) for name, value in tracker.model.known().items()}
    given = TrackerState(
        Objects(*(_leaf(t) for t in state.objects)),
        Noise(*(_leaf(t) for t in state.noise)),
        state.next_label,
        _leaf(state.undetected),
        _leaf(state.interference),
    )
    forward = partial(
        tracker.with_model(tracker.model.with_numbers(leaves)).step, given, measurement, priors, streams
    )
    left, estimate = forward()
    outputs = [
        t for t in (*left.objects, *left.noise, left.undetected, estimate.log_evidence) if t.requires_grad
    ]
    inputs = [
        t for t in (*leaves.values(), *given.objects, *given.noise, given.undetected) if t.requires_grad
    ]
    backward = partial(
        torch.autograd.grad,
        outputs,
        inputs,
        [torch.ones_like(t) for t in outputs],
        retain_graph=True,
        allow_unused=True,
    )
    return {
        f"{WHOLE}, kept for the gradient": (forward, "in all parameters"),
        "gradient": (backward, "backward through one step of a sequence"),
    }


def _leaf(tensor: Tensor) -> Tensor:
    return tensor.detach().clone().requires_grad_(tensor.is_floating_point())


def measure_batch(tracker: DirectTracker, recording: Recording, repeats: int) -> list[Measured]:
    """A batch of sequences and, in turn, one of them after the other alone, by `torchdt.run.track.track`.

    The batch has one worker for each thread of the linear algebra, the single sequence all threads.

    Args:
        tracker: the tracker.
        recording: B sequences.
        repeats: of either.
    """
    size = recording.batch_size
    rows = itertools.cycle(range(size))

    def alone() -> None:
        row = next(rows)
        track(recording.select(slice(row, row + 1)), tracker, [row])

    calls: dict[str, Callable[[], Any]] = {
        "batch": partial(track, recording, tracker, range(size), workers=torch.get_num_threads()),
        "one": alone,
    }
    taken = clock_in_turn(calls, repeats, tracker.region.low.device)
    batched, one = median(taken["batch"]) / size, median(taken["one"])
    steps = f"{recording.num_steps} steps"
    found: list[tuple[str, float, str, str]] = [
        ("one sequence", one, "s/sequence", steps),
        (f"batch of {size}", batched, "s/sequence", steps),
        ("batch / one sequence", batched / one, "ratio", "time per sequence, in turn"),
    ]
    return [Measured("step", *row) for row in found]
