"""Where the particles of a step are: known objects moved to the data, new ones found in what these leave."""

from functools import partial

import torch
from torch import Tensor

from torchdt.core.trees import put_sequences, select, take_sequences, tree_map
from torchdt.filter.bp.beliefs import Beliefs, initial_beliefs
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.config import TrackerConfig
from torchdt.filter.context import StepContext
from torchdt.filter.predict import Predicted
from torchdt.filter.proposal.cells import Unexplained
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.proposal.moved import Draws
from torchdt.filter.proposal.newborn import propose_newborn
from torchdt.filter.proposal.search import Picks, search
from torchdt.filter.slots import Placed, join, join_beliefs
from torchdt.filter.state import Objects
from torchdt.model.noise.base import Noise
from torchdt.model.part import append_dims
from torchdt.model.prior import Priors


class Placer:
    """Places the objects of a step.

    Args:
        context: field, region, model and data.
        dictionary: responses on the region's grid.
        config: settings of the filter.
    """

    def __init__(self, context: StepContext, dictionary: Dictionary, config: TrackerConfig):
        self.context, self.dictionary, self.config = context, dictionary, config

    def place(
        self, predicted: Predicted, priors: Priors, known: Draws, newborn: Draws, rounds: Tensor
    ) -> tuple[Placed, Unexplained]:
        """Known and new objects on the particles of this step, with beliefs to start the update from.

        Args:
            predicted: known objects and noise before the data, batch `(*batch, N)`.
            priors: limits of the priors.
            known, newborn: random numbers of the proposals.
            rounds: `(*batch, Q, rounds, S, d)` standard normal, for refining picks.

        Returns:
            The objects, and what the known ones among them leave unexplained.
        """
        cfg, noise = self.config, predicted.beliefs.noise
        field, region, model, heard, measurement = self.context
        first = self._place_known(self.context, predicted, predicted.beliefs, known)
        log_odds = partial(model.birth.log_odds, region)
        with torch.no_grad():
            top = log_odds(self.dictionary.points.expand(*noise.mean.shape[:-1], -1, -1)).amax(-1)
            picks, explained, residual = search(
                field,
                region,
                self.dictionary,
                measurement,
                signal_covariance(first.beliefs.strength, first.beliefs.moment),
                noise,
                cfg.slots - predicted.objects.log_odds.isfinite().sum(-1),
                cfg.pick_threshold(top),
                rounds,
                proposal=cfg.proposal,
                favour=lambda position: log_odds(position) - append_dims(top, position.ndim - 1 - top.ndim),
                noise_model=heard,
            )
        explained = tree_map(Tensor.detach, explained)
        current = first._replace(beliefs=first.beliefs._replace(noise=explained))
        if picks is None:
            return current, residual
        if cfg.proposal.moves:
            # Energy of objects not yet known has pulled at the known ones: place them again without it.
            current = self._place_again(current, predicted, explained, known, picks)
        return self._add_newborn(current, picks, priors, newborn), residual

    def _place_again(
        self, current: Placed, predicted: Predicted, noise: Noise, draws: Draws, picks: Picks
    ) -> Placed:
        """Known objects placed anew in those sequences in which something was picked."""
        some, extra_signal = picks.active.any(-1), signal_covariance(picks.power, picks.moment)
        arguments = (predicted, predicted.beliefs._replace(noise=noise), draws, extra_signal)
        if some.ndim != 1 or bool(some.all()):
            return select(some, self._place_known(self.context, *arguments), current)
        rows = some.nonzero().squeeze(-1)
        again = self._place_known(self.context.select(rows), *take_sequences(arguments, rows))
        return put_sequences(current, rows, again)

    def _place_known(
        self,
        context: StepContext,
        predicted: Predicted,
        beliefs: Beliefs,
        draws: Draws,
        extra_signal: Tensor | None = None,
    ) -> Placed:
        """First sweep over the known objects, so that new ones are looked for in what these leave."""
        cfg = self.config
        arguments = (context, predicted, beliefs, draws, extra_signal)
        return cfg.proposal.place_known(*arguments, cfg.schedule, cfg.gradient)

    def _add_newborn(self, known: Placed, picks: Picks, priors: Priors, draws: Draws) -> Placed:
        """Known and new objects together."""
        cfg, dim = self.config, picks.active.ndim - 1
        field, region, model, heard, measurement = self.context
        signal = signal_covariance(known.beliefs.strength, known.beliefs.moment)
        new, response = propose_newborn(
            field,
            region,
            measurement,
            signal,
            picks,
            known.beliefs.noise,
            priors.power_max,
            model,
            cfg.power_points,
            draws,
            proposal=cfg.proposal,
            noise_model=heard,
        )
        # What a pick sends beside its response is judged by the power it was picked with.
        newborn = initial_beliefs(new, response, known.beliefs.noise, picks.diffuse)._replace(
            power=picks.power
        )
        return Placed(
            Objects(*join(known.objects, new, dim)),
            torch.cat([known.response, response], dim),
            join_beliefs(known.beliefs, newborn),
        )
