"""What the choices of the paper's graph are worth: `python experiments/paper_choices.py`.

Tracks the same recordings with `tracker=direct_paper`, with one of its choices at a time exchanged for that
of the direct tracker, with all of them exchanged, and with the direct tracker.
"""

import argparse
import dataclasses
from unittest.mock import patch

import torch
from hydra import initialize_config_module
from rich.table import Table
from torch import Tensor

from torchdt.app.build import build_recording, build_tracker
from torchdt.app.report.console import plain_console
from torchdt.app.score import score_history
from torchdt.app.suite import compose_track
from torchdt.filter.bp.moments import response_moment, signal_covariance
from torchdt.filter.bp.rank_one import peak_log_likelihood_ratio, statistics, whiten
from torchdt.filter.paper import messages
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.tracker import PaperDraws, PaperTracker
from torchdt.filter.proposal.moved import respond
from torchdt.filter.proposal.strongest import strongest_cell
from torchdt.filter.state import Objects, TrackerState
from torchdt.model.measurement import Measurement, mask_covariance
from torchdt.model.noise.base import Noise
from torchdt.model.prior import Priors
from torchdt.run.track import track


class PicksOfTheUnexplained(PaperTracker):
    """Cells where one more object raises the likelihood most, given known objects, noise, earlier picks."""

    def predict_objects(self, objects: Objects, draws: PaperDraws) -> Objects:
        """Remember what is known."""
        self.known = super().predict_objects(objects, draws)
        return self.known

    def predict_noise(self, noise: Noise, draws: PaperDraws) -> Noise:
        """Remember what is known."""
        self.noise = super().predict_noise(noise, draws)
        return self.noise

    def pick(self, measurement: Measurement) -> Tensor:
        """As many as ever."""
        known = self.known
        moment = response_moment(respond(self.field, known.state), known.log_weight)
        signal = signal_covariance(known.existence[..., None] * known.mean_power, moment)
        everywhere, cells = torch.ones_like(known.label[..., 0], dtype=torch.bool), []
        for _ in range(self.births):
            background = mask_covariance(signal, self.noise.mean, measurement.present)
            whitener = whiten(measurement, background)
            cells.append(strongest_cell(self.dictionary, whitener, everywhere)[1])
            response = respond(self.field, self.dictionary.points[cells[-1]][..., None, :])
            s, q = (t[..., 0] for t in statistics(whitener, response))
            power = peak_log_likelihood_ratio(measurement.num_snapshots, s, q)[1]
            signal = signal + power[..., None, None] * (response.mT @ response.conj())
        return torch.stack(cells, -1)


class SupportPoints(PaperTracker):
    """Powers and noise on support points, their Gamma transitions by moments."""

    def init(self, priors: Priors) -> TrackerState:
        """Noise as predicted for the first step."""
        self.first = True
        noise = self.model.noise.initial(priors.noise_max, self.config.noise_particles)
        return super().init(priors)._replace(noise=noise)

    def predict_objects(self, objects: Objects, draws: PaperDraws) -> Objects:
        """States as ever."""
        known = super().predict_objects(objects, draws)
        old = (t[:, : known.label.shape[-1]] for t in (objects.power, objects.log_power_weight))
        power, log_weight = self.model.power.predict(*old)
        return known._replace(power=power, log_power_weight=log_weight)

    def predict_noise(self, noise: Noise, draws: PaperDraws) -> Noise:
        """One transition, but not before the first step."""
        first, self.first = self.first, False
        return noise if first else self.model.noise.predict(noise)

    def place_newborn(self, measurement: Measurement, priors: Priors, draws: PaperDraws) -> Objects:
        """Powers evenly spaced in the logarithm."""
        born = super().place_newborn(measurement, priors, draws)
        points = self.model.power.initial(priors.power_max, self.config.power_particles)
        power, log_weight = (t.unsqueeze(-3).expand_as(born.power) for t in points)
        return born._replace(power=power, log_power_weight=log_weight)


class Both(PicksOfTheUnexplained, SupportPoints):
    """Support points, and picks of the unexplained."""


def together(measurement: Measurement) -> Measurement:
    """All snapshots of a tone as one factor."""
    return Measurement(*(t.unsqueeze(-k) for t, k in zip(measurement, (4, 2, 3), strict=True)))


PLAIN = (
    "tracker=direct",
    "tracker/proposal=as_predicted",
    "tracker/schedule=flooding",
    "tracker.resampler.roughening=0",
)
VARIANTS = {
    "direct_paper": (PaperTracker, False),
    "one factor per tone": (PaperTracker, True),
    "support points": (SupportPoints, False),
    "picks of the unexplained": (PicksOfTheUnexplained, False),
    "all three": (Both, True),
}


def evaluate(kind: type[PaperTracker] | None, joined: bool, overrides: list[str], runs: int) -> list[Tensor]:
    """GOSPA and its parts, a mean over the steps of each run, `(runs,)` each."""
    settings = compose_track("line_array", overrides, 0, runs)
    recording = build_recording(settings)
    tracker = build_tracker(settings, recording)
    if kind is not None and isinstance(settings.built_tracker, PaperConfig):
        points = {"noise_particles": 64} if issubclass(kind, SupportPoints) else {}
        config = dataclasses.replace(settings.built_tracker, **points)
        model = settings.statistical_model
        tracker = kind(tracker.field, tracker.region, recording.step_s, config, model)
    with patch.object(messages, "snapshots", together if joined else messages.snapshots):
        history = track(recording, tracker, range(settings.seed, settings.seed + settings.runs))
    score = score_history(history, recording, settings)
    assert score is not None
    parts = (score.total, score.localisation, score.missed, score.false)
    return [part.mean(-1) for part in parts]


def main() -> None:
    """Print a table of all variants."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("overrides", nargs="*", help="of the configuration of experiments/track.py")
    arguments = parser.parse_args()
    always, runs = arguments.overrides, arguments.runs
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        rows = {name: evaluate(*v, ["tracker=direct_paper", *always], runs) for name, v in VARIANTS.items()}
        rows["direct, plain"] = evaluate(None, False, [*PLAIN, *always], runs)
        rows["direct"] = evaluate(None, False, ["tracker=direct", *always], runs)
    table = Table("tracker", "GOSPA", "+-", "localisation", "missed", "false")
    for name, (total, *parts) in rows.items():
        error = 1.96 * total.std().item() / len(total) ** 0.5
        numbers = [total.mean().item(), error, *(part.mean().item() for part in parts)]
        table.add_row(name, *(f"{number:.2f}" for number in numbers))
    plain_console().print(table)


if __name__ == "__main__":
    main()
