"""Where the particles of a step are: known objects moved to the data, new ones found in what these leave."""

import copy
from functools import partial

import torch
from torch import Tensor

from torchdt.core.trees import put_sequences, select, take_sequences, tree_map
from torchdt.field.base import BaseField
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.bp.schedule import Beliefs, initial_beliefs
from torchdt.filter.config import TrackerConfig
from torchdt.filter.predict import Predicted
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.proposal.moved import Draws
from torchdt.filter.proposal.newborn import Picks, propose_newborn, search
from torchdt.filter.slots import Placed, join, join_beliefs
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.model import Model
from torchdt.model.noise.base import Noise
from torchdt.model.part import append_dims
from torchdt.model.prior import Priors
from torchdt.model.region import Region


class Placer:
    """Places the objects of a step.

    Args:
        field: array response.
        region: region of interest.
        dictionary: responses on the region's grid.
        config: settings of the filter.
        model: statistical model.
    """

    def __init__(
        self,
        field: BaseField,
        region: Region,
        dictionary: Dictionary,
        config: TrackerConfig,
        model: Model,
    ):
        self.field, self.region, self.dictionary = field, region, dictionary
        self.config, self.model = config, model

    def place(
        self,
        predicted: Predicted,
        noise: Noise,
        measurement: Measurement,
        priors: Priors,
        known: Draws,
        newborn: Draws,
        rounds: Tensor,
    ) -> Placed:
        """Known and new objects on the particles of this step, and beliefs to start the update from.

        Args:
            predicted: known objects before the data, batch `(*batch, N)`.
            noise: predicted noise.
            measurement: statistics of the step, batch `(*batch,)`.
            priors: limits of the priors.
            known, newborn: random numbers of the proposals.
            rounds: `(*batch, Q, rounds, S, d)` standard normal, for refining picks.
        """
        cfg = self.config
        first = self._place_known(predicted, predicted.beliefs, measurement, known)
        log_odds = partial(self.model.birth.log_odds, self.region)
        with torch.no_grad():
            top = log_odds(self.dictionary.points.expand(*noise.mean.shape[:-1], -1, -1)).amax(-1)
            picks, explained = search(
                self.field,
                self.region,
                self.dictionary,
                measurement,
                signal_covariance(first.beliefs.strength, first.beliefs.moment),
                noise,
                cfg.slots - predicted.objects.log_odds.isfinite().sum(-1),
                cfg.pick_threshold(top),
                rounds,
                proposal=cfg.proposal,
                favour=lambda position: log_odds(position) - append_dims(top, position.ndim - 1 - top.ndim),
                noise_model=self.model.noise,
            )
        explained = tree_map(Tensor.detach, explained)
        current = first._replace(beliefs=first.beliefs._replace(noise=explained))
        if picks is None:
            return current
        if cfg.proposal.moves:
            # Energy of objects not yet known has pulled at the known ones: place them again without it.
            found = signal_covariance(picks.power, picks.moment)
            current = self._place_again(current, predicted, explained, measurement, known, found, picks)
        return self._add_newborn(current, picks, measurement, priors, newborn)

    def _place_again(
        self,
        current: Placed,
        predicted: Predicted,
        noise: Noise,
        measurement: Measurement,
        draws: Draws,
        found: Tensor,
        picks: Picks,
    ) -> Placed:
        """Known objects placed anew in those sequences in which something was found."""
        some = picks.active.any(-1)
        if some.ndim != 1 or bool(some.all()):
            start = predicted.beliefs._replace(noise=noise)
            return select(some, self._place_known(predicted, start, measurement, draws, found), current)
        rows = some.nonzero().squeeze(-1)
        arguments = (predicted, noise, measurement, draws, found)
        predicted, noise, measurement, draws, found = take_sequences(arguments, rows)
        placer = copy.copy(self)
        chosen = rows.tolist()
        placer.field, placer.region = self.field.select(chosen), self.region.select(chosen)
        placer.model = self.model.select(chosen)
        start = predicted.beliefs._replace(noise=noise)
        return put_sequences(current, rows, placer._place_known(predicted, start, measurement, draws, found))

    def _place_known(
        self,
        predicted: Predicted,
        beliefs: Beliefs,
        measurement: Measurement,
        draws: Draws,
        found: Tensor | None = None,
    ) -> Placed:
        """First sweep over the known objects, so that new ones are looked for in what these leave."""
        cfg = self.config
        given = (predicted, beliefs, measurement, draws, found, self.model.noise)
        return cfg.proposal.place_known(self.field, self.region, *given, cfg.schedule, cfg.gradient)

    def _add_newborn(
        self, known: Placed, picks: Picks, measurement: Measurement, priors: Priors, draws: Draws
    ) -> Placed:
        """Known and new objects together."""
        cfg, dim = self.config, picks.active.ndim - 1
        signal = signal_covariance(known.beliefs.strength, known.beliefs.moment)
        new, response = propose_newborn(
            self.field,
            self.region,
            measurement,
            signal,
            picks,
            known.beliefs.noise,
            priors.power_max,
            self.model,
            cfg.power_points,
            draws,
            proposal=cfg.proposal,
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
