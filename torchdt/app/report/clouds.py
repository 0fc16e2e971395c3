"""Particle clouds of one step: where each object may be, and how sure of it the tracker is."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torchdt.app.report.belief import Belief
from torchdt.app.report.figures import COLOURS, Axis, to_array
from torchdt.filter.history import StepEstimate
from torchdt.model.region import Region

CLOSE_UPS = 3
MOST_PARTICLES = 500
MOST_OPAQUE = 0.5
WIDE = 4.0
"""Half the width of a close-up, in standard deviations of the cloud."""


class Frame(NamedTuple):
    """What particles are drawn in: positions; a single one with its rate, or without one, its weight.

    Attributes:
        axes: of the d coordinates.
        low, high: `(max(d, 2),)` limits of what is drawn.
        beside: label of what a single coordinate is drawn against.
    """

    axes: Sequence[Axis]
    low: Tensor
    high: Tensor
    beside: str = "Rate (per s)"

    @classmethod
    def of_region(cls, region: Region, axes: Sequence[Axis]) -> Self:
        """A whole region, with the rates of newborn objects where one coordinate has one."""
        number = max(2, len(axes))
        if region.num_entries < number:
            low, high = torch.zeros_like(region.low), torch.ones_like(region.low)
            return cls(axes, torch.cat([region.low, low]), torch.cat([region.high, high]), "Weight")
        low, high = torch.cat([region.low, region.rate_low]), torch.cat([region.high, region.rate_high])
        return cls(axes, low[:number], high[:number])

    @property
    def scale(self) -> np.ndarray:
        """Factors `(max(d, 2),)` to what is drawn."""
        return np.array([axis.scale for axis in self.axes] * 2)[: len(self.low)]

    def entries(self, particles: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """What is drawn, `(P, max(d, 2))`, of particles `(P, D)` and their weights over the largest."""
        drawn = np.column_stack([particles, weight / weight.max()])[:, : len(self.low)]
        return drawn * self.scale

    def around(self, points: np.ndarray, middle: np.ndarray) -> np.ndarray:
        """Scaled points `(*batch, d)` or `(*batch, D)` on the turn that is nearest to a middle `(D,)`."""
        moved = points.copy()
        for i, axis in enumerate(self.axes):
            if axis.period is not None:
                turn = axis.period * axis.scale
                moved[..., i] -= turn * np.round((moved[..., i] - middle[i]) / turn)
        return moved


class Cloud(NamedTuple):
    """Particles of one object, scaled as the axes are.

    Attributes:
        label: of the object, 0 if it was never declared.
        existence: its probability.
        points: `(P', max(d, 2))`, some of the P.
        opacity: `(P',)`, in proportion to the weights.
        centre, spread: `(max(d, 2),)` weighted mean and standard deviation of all P.
    """

    label: int
    existence: float
    points: np.ndarray
    opacity: np.ndarray
    centre: np.ndarray
    spread: np.ndarray

    @property
    def colour(self) -> str:
        """Of the label."""
        return COLOURS[(self.label - 1) % len(COLOURS)] if self.label else "grey"

    @property
    def title(self) -> str:
        """Of its close-up."""
        name = f"label {self.label}" if self.label else "no label"
        return f"{name}, existence {self.existence:.3g}"


def cloud_figure(
    belief: Belief, estimate: StepEstimate, truth: Tensor | None, time_s: float, frame: Frame
) -> Figure:
    """Draw all potential objects in the whole region, and the most probable ones from close up.

    One row of panels shows the first two coordinates; a third one, against the first, adds a row. A single
    coordinate is drawn against its rate, or without one against the weights of the particles.

    Args:
        belief: about N potential objects.
        estimate: of the same step and sequence.
        truth: `(L, d)` true positions, NaN = absent; None if unknown.
        time_s: of the step, s.
        frame: axes and limits of the d coordinates.
    """
    clouds = clouds_of(belief, estimate, frame)
    faint = [cloud._replace(opacity=cloud.opacity * cloud.existence) for cloud in clouds]
    pairs = [(0, entry) for entry in range(1, max(2, len(frame.axes)))]
    columns = 1 + CLOSE_UPS
    figure = Figure(figsize=(2.7 * columns, 0.4 + 2.6 * len(pairs)), dpi=80, layout="constrained")
    panels = figure.subplots(len(pairs), columns, squeeze=False)
    limits = to_array(frame.low) * frame.scale, to_array(frame.high) * frame.scale
    for row, pair in zip(panels, pairs, strict=True):
        draw_panel(row[0], faint, limits, truth, frame, pair)
        row[0].set_title(f"{time_s:.15g} s, potential objects: {len(clouds)}", fontsize="small")
        for panel, cloud in zip(row[1:], clouds, strict=False):
            # The particles of an object may all lie in one place.
            half = np.maximum(WIDE * cloud.spread, 1e-6 * (1 + abs(cloud.centre)))
            draw_panel(panel, [cloud], (cloud.centre - half, cloud.centre + half), truth, frame, pair)
            panel.set_title(cloud.title, color=cloud.colour, fontsize="small")
        for panel in row[1 + len(clouds) :]:
            panel.set_axis_off()
    return figure


def clouds_of(belief: Belief, estimate: StepEstimate, frame: Frame) -> list[Cloud]:
    """Clouds of all objects that may exist, the most probable first."""
    existence, label = to_array(estimate.existence), to_array(estimate.label)
    clouds = []
    for slot in np.argsort(-existence, kind="stable")[: np.count_nonzero(existence > 0)].tolist():
        weight = to_array(belief.weight[slot])
        points = frame.entries(to_array(belief.particles[slot]), weight)
        centre = weight @ points
        spread = np.sqrt(weight @ (points - centre) ** 2)
        some = slice(None, None, math.ceil(len(weight) / MOST_PARTICLES))
        opacity = MOST_OPAQUE * weight / weight.max()
        clouds.append(Cloud(int(label[slot]), existence[slot], points[some], opacity[some], centre, spread))
    return clouds


def draw_panel(
    panel: Axes,
    clouds: Sequence[Cloud],
    limits: tuple[np.ndarray, np.ndarray],
    truth: Tensor | None,
    frame: Frame,
    pair: tuple[int, int],
) -> None:
    """Particles as dots, means of labelled objects as crosses, true positions as circles.

    Args:
        panel: where to draw.
        clouds: the most important first.
        limits: `(max(d, 2),)` each, scaled as the axes are.
        truth: `(L, d)`, or None.
        frame: axes of the d coordinates.
        pair: entries drawn across and up; beside a single true position there is nothing, and it is a line.
    """
    across, up = pair
    beside = up >= len(frame.axes)
    low, high = limits
    middle = (low + high) / 2
    for cloud in reversed(clouds):
        points, centre = frame.around(cloud.points, middle), frame.around(cloud.centre, middle)
        x, y = points[:, across], points[:, up]
        panel.scatter(x, y, s=9, color=cloud.colour, alpha=cloud.opacity, linewidths=0)
        if cloud.label:
            panel.plot(centre[across], centre[up], "x", ms=7, mew=1.5, color=cloud.colour)
    for place in [] if truth is None else to_array(truth[~truth.isnan().any(-1)]):
        place = frame.around(place * frame.scale[: len(frame.axes)], middle)
        if beside:
            panel.axvline(place[across], color="black", lw=1.0)
        else:
            panel.plot(place[across], place[up], "o", ms=11, mew=1.5, mfc="none", color="black")
    panel.set_xlim(low[across], high[across])
    panel.set_ylim(low[up], high[up])
    if not beside and frame.axes[up].downward:
        panel.invert_yaxis()
    panel.set_xlabel(frame.axes[across].label)
    panel.set_ylabel(frame.beside if beside else frame.axes[up].label)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MaxNLocator(3))  # as close-ups have long numbers
    panel.ticklabel_format(useOffset=False)
    panel.tick_params(labelsize="small")
