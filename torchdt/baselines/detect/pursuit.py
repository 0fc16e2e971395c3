"""Multi-frequency orthogonal matching pursuit, refined between the cells of the grid.

Points are picked one after another where one more explains most of what the earlier ones leave (Mallat and
Zhang, IEEE Trans. Signal Process. 41, 1993), and all of them are projected out together (Pati, Rezaiifar and
Krishnaprasad, Asilomar 1993). With each pick all points so far move off the grid, since at 30 dB half a cell
beside the peak is enough energy left over for a ghost.
"""

import torch
from torch import Tensor

from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.detect.describe import Remainder, describe, polish, project_out
from torchdt.baselines.detect.peaks import close
from torchdt.baselines.detect.points import Points
from torchdt.core.trees import put
from torchdt.field.base import Field
from torchdt.filter.bp.rank_one import peak_log_likelihood_ratio
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.model.measurement import Measurement
from torchdt.model.region import Region

COLUMNS = 32
"""Columns that are multiplied with the dictionary at once: the product is the largest tensor of all."""


class MatchingPursuit:
    """Detector of at most `config.points` points per step.

    Args:
        field: response of the array.
        region: limits and grid.
        dictionary: of the same field and region.
        config: settings.
    """

    def __init__(self, field: Field, region: Region, dictionary: Dictionary, config: PursuitConfig):
        self.field, self.region, self.config = field, region, config
        self.points = dictionary.points
        # (I, C, M) for all sequences or for each; its squares serve every pick.
        self.response = dictionary.response.reshape(-1, *dictionary.response.shape[-3:])
        self.square = torch.view_as_real(self.response).square().sum(-1)

    @torch.no_grad()
    def __call__(self, measurement: Measurement) -> Points:
        """Detect the points of every step.

        Args:
            measurement: batch `(*batch,)`, or `(B, *batch)` with a field per sequence.

        Raises:
            NumericalError: where a response is not finite.
        """
        batch, Q = measurement.num_snapshots.shape[:-1], self.config.points
        position = self.points[0].expand(*batch, Q, -1)
        present = torch.zeros((*batch, Q), dtype=torch.bool, device=position.device)
        alive = torch.ones(batch, dtype=torch.bool, device=position.device)
        for pick in range(Q):
            remainder = project_out(self.field(position), present, measurement)
            score, cell = self._best_cell(remainder, measurement.present, position, present, alive)
            alive = alive & (score > self.config.pick_threshold)
            if not bool(alive.any()):
                break
            index = torch.full_like(cell, pick)
            place = self.points[torch.where(alive, cell, 0)]
            position, present = put(position, index, place), put(present, index, alive)
            if self.config.refine:
                separation = self.config.separation
                moved = polish(self.field, self.region, position, present, measurement, separation)
                # Steps that are done stay as they are, however long others of the batch go on.
                position = torch.where(alive[..., None, None], moved, position)
        points = describe(self.field(position), position, present, measurement)
        return points.above(self.config.threshold)

    def _best_cell(
        self, remainder: Remainder, sensors: Tensor, position: Tensor, present: Tensor, alive: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Best score among the cells that no point is close to, and its cell, each `(*batch,)`.

        The score is minus infinity where `alive` does not hold or no cell is left.
        """

        def grouped(tensor: Tensor) -> Tensor:
            """`(*batch, ...)` to `(fields, steps, ...)`."""
            return tensor.reshape(len(self.response), -1, *tensor.shape[alive.ndim :])

        # In units of the noise variance that is left, 1 / (J n) of the energy.
        units = (remainder.num_snapshots * remainder.free.clamp_min(0.0)).sqrt()
        parts = (remainder.residual * units[..., None, None], remainder.num_snapshots, sensors)
        inputs = [grouped(t) for t in (*parts, position, present)]
        score = torch.full_like(inputs[1][..., 0], -torch.inf)
        cell = torch.zeros_like(score, dtype=torch.int64)
        chunk = max(1, COLUMNS // remainder.residual.shape[-1])
        for group, steps in enumerate(grouped(alive)):
            for part in steps.nonzero()[:, 0].split(chunk):
                surface = self._surface(group, *(t[group, part] for t in inputs))
                score[group, part], cell[group, part] = surface.max(-1)
        return score.reshape(alive.shape), cell.reshape(alive.shape)

    def _surface(
        self, group: int, residual: Tensor, J: Tensor, sensors: Tensor, position: Tensor, present: Tensor
    ) -> Tensor:
        """Log-likelihood ratio of one more point in each cell, `(steps, C)`.

        In noise of the variance that is left, which bounds what one tone can say: as long as other sources
        are left in it, that a point explains nearly all of one tone must not outweigh the other tones.
        """
        steps, num_tones, num_sensors, num_columns = residual.shape
        columns = residual.permute(1, 2, 0, 3).reshape(num_tones, num_sensors, -1)
        # a^H R; the conjugate moves to the small factor, |.|^2 does not see it.
        product = torch.view_as_real(self.response[group] @ columns.conj().resolve_conj())
        q = product.square_().reshape(*product.shape[:2], steps, 2 * num_columns).sum(-1)
        s = self.square[group] @ sensors.permute(1, 2, 0)
        surface = peak_log_likelihood_ratio(J.mT[:, None], s, q)[0].sum(0).mT
        for x, there in zip(position.unbind(-2), present.unbind(-1), strict=True):
            near = close(
                self.region.difference(self.points, x[:, None]) / self.region.cell, self.config.separation
            )
            surface = surface.masked_fill(near & there[:, None], -torch.inf)
        return surface
