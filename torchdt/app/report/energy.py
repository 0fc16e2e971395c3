"""What the energy of a recording went to, and what to look at where the model explains too little."""

from collections.abc import Sequence

from torch import Tensor

from torchdt.filter.history import TrackHistory
from torchdt.filter.shares import PARTS

TOO_MUCH = 0.2
"""Share of the energy that neither objects nor noise explain from which on a result is doubted."""


def mean_shares(history: TrackHistory) -> dict[str, float] | None:
    """Shares of the energy by the names of `PARTS`, mean over tones and steps with data of all runs.

    None where the tracker does not know them.
    """
    shares = history.shares.double().flatten(0, -2)
    known = shares[shares.sum(-1) > 0]
    return dict(zip(PARTS, known.mean(0).tolist(), strict=True)) if len(known) else None


def energy_line(shares: dict[str, float]) -> str:
    """One line for people."""
    return "energy: " + ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())


def hints(history: TrackHistory) -> list[str]:
    """What may be wrong where much of the energy is that of no object and no noise, for each run.

    Args:
        history: batch shape `(B,)`.
    """
    found = []
    for run, shares in enumerate(history.shares.double()):
        known = shares.flatten(0, 1)[shares.flatten(0, 1).sum(-1) > 0]
        if not len(known):
            continue
        by_part = dict(zip(PARTS, known.mean(0).tolist(), strict=True))
        strange = by_part["interferers"] + by_part["unexplained"]
        if strange > TOO_MUCH:
            found.append(
                f"run {run}: {100 * strange:.0f} % of the energy is that of no object the field can model "
                f"and of no noise (objects {100 * by_part['objects']:.0f} %): a source outside the region, "
                "or the order of the channels, the sign of the phases (field.sign), the positions of the "
                "sensors or the environment are not what the field says"
            )
    return found


def energy_rows(shares: Tensor, noise: Tensor, times: Sequence[Sequence[str]]) -> list[tuple[object, ...]]:
    """Rows `run, step, time_s, tone, noise, objects, interferers, noise share, unexplained`.

    Args:
        shares: `(B, K, I, 4)`.
        noise: `(B, K, I)` level, in squared units of the data.
        times: of runs and steps, as they are written.
    """
    return [
        (run, step, times[run][step], tone + 1, level, *values)
        for run, (of_run, levels) in enumerate(zip(shares.tolist(), noise.tolist(), strict=True))
        for step, (of_step, at) in enumerate(zip(of_run, levels, strict=True))
        for tone, (values, level) in enumerate(zip(of_step, at, strict=True))
    ]
