"""Shapes and types on the meta device, which holds no numbers: whatever is not there is an error."""

import pytest
import torch
from oracles.devices import assert_kind
from oracles.line_array import FREQS, POSITIONS
from oracles.waveguide import make_field, make_region
from torch import Tensor

from torchdt.field.base import Field
from torchdt.field.mismatch import MismatchedField
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.bp.moments import response_moment, signal_covariance, signal_without_each
from torchdt.filter.bp.rank_one import Whitener, log_likelihood_ratio, peak_log_likelihood_ratio, statistics
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.birth import UniformBirth
from torchdt.model.existence import drop_outside, predict_log_odds
from torchdt.model.gamma_chain import (
    predict_chain,
    predicted_uniform_prior,
    uniform_prior,
    uniform_prior_around,
)
from torchdt.model.measurement import from_snapshots
from torchdt.model.model import Model
from torchdt.model.motion.constant_velocity import ConstantVelocity, predict_moments, predict_state
from torchdt.model.prior import data_priors

META = torch.device("meta")
DTYPES = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


def assert_meta(results: dict[tuple[int, ...], Tensor | tuple[Tensor, ...]], dtype: torch.dtype) -> None:
    """Every result, under the shape it should have."""
    for shape, result in results.items():
        for value in result if isinstance(result, tuple) else (result,):
            assert value.shape == shape
            assert_kind(value, dtype, "meta")


@DTYPES
def test_responses(dtype):
    state = torch.empty(2, 5, 4, dtype=dtype, device=META)
    tilt = torch.empty((), dtype=torch.float64, device=META)
    line = LineArrayField(FREQS, POSITIONS, dtype=dtype, device="meta")
    assert_meta({(2, 5, 2, 8): line(state)}, dtype)
    share = torch.empty(2, dtype=dtype, device=META)
    for field in (make_field(dtype, "meta"), make_field(dtype).to(META), make_field(dtype, "meta", tilt)):
        known_in_part = MismatchedField(field, share)
        both: tuple[Field, ...] = (field, known_in_part, StackedField([known_in_part] * 2))
        for one in both:
            assert_meta({(2, 5, 2, 11): one(state)}, dtype)
        for scattered in (field.incoherent, *(one.diffuse for one in both[1:])):
            assert_meta({(2, 5, 2, 11, 11): scattered(state)}, dtype)


@DTYPES
def test_region_and_dictionary(dtype):
    region = make_region(dtype, "meta")
    state = torch.empty(7, 4, dtype=dtype, device=META)
    dictionary = build_dictionary(make_field(dtype, "meta"), region)
    assert region.num_cells == 16 * 15
    model = Model(motion=ConstantVelocity([1.0, 2.0])).on(region)
    assert_kind((dictionary, tuple(model.known().values())), dtype, "meta")
    assert_meta(
        {
            (2,): (region.low, region.high, region.rate_low, region.rate_high, region.cell),
            (240, 2): region.cell_centres(),
            (2, 240, 11): dictionary.response,
            (7,): (region.contains(state), drop_outside(state, state[:, 0], region)),
        },
        dtype,
    )


@DTYPES
def test_priors(dtype):
    measurement = from_snapshots(torch.empty(5, 6, 2, 3, 4, dtype=dtype.to_complex(), device=META))
    priors = data_priors(measurement)
    assert_kind((measurement, priors), dtype, "meta")
    maximum = priors.noise_max
    assert_meta(
        {
            (5, 6, 2, 4, 3): measurement.factor,
            (5, 6, 2): measurement.tempered(0.5).num_snapshots,
            (5, 2): tuple(priors),
            (5, 2, 9): (
                *uniform_prior(maximum, 9),
                *uniform_prior_around(maximum, maximum, 9),
                *predicted_uniform_prior(maximum, 9, 1e2),
            ),
        },
        dtype,
    )


@DTYPES
def test_predictions(dtype):
    def blank(*shape: int) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=META)

    birth, region = UniformBirth(blank(3)), make_region(dtype, "meta")
    moments = predict_moments(blank(3, 4), blank(3, 4, 4), 2.0, blank(3, 2))
    assert_meta(
        {
            (3, 5, 4): predict_state(blank(3, 5, 4), blank(3, 5, 2), 2.0),
            (3, 4): moments[0],
            (3, 4, 4): moments[1],
            (3,): (birth.log_none(region, blank(3, 5)),),
            (3, 6): (
                birth.log_odds(region, blank(3, 6, 1)),
                predict_log_odds(blank(3, 6), 0.9),
                predict_log_odds(blank(3, 6), blank(3, 1)),
            ),
            (3, 6, 9): predict_chain(blank(3, 6, 9), blank(3, 6, 9), 1e4),
        },
        dtype,
    )


@DTYPES
def test_moments_and_statistics(dtype):
    def blank(*shape: int, kind: torch.dtype = dtype) -> Tensor:
        return torch.empty(shape, dtype=kind, device=META)

    response = blank(3, 2, 5, 4, kind=dtype.to_complex())
    whitener = Whitener(blank(3, 2, 4, 4 + 6, kind=dtype.to_complex()), blank(3, 2))
    s, q = statistics(whitener, response)
    moment, strength = blank(3, 7, 2, 4, 4, kind=dtype.to_complex()), blank(3, 7, 2)
    J = whitener.num_snapshots[..., None]
    assert_meta(
        {
            (3, 2, 4, 4): (response_moment(response, blank(3, 5)), signal_covariance(strength, moment)),
            (3, 7, 2, 4, 4): signal_without_each(strength, moment),
            (3, 2, 5): (s, q, log_likelihood_ratio(J, blank(3, 2, 1), s, q)),
            (3, 2, 5, 1): peak_log_likelihood_ratio(J[..., None], s[..., None], q[..., None]),
        },
        dtype,
    )


def test_what_is_elsewhere_is_an_error():
    """That the above can fail at all."""
    with pytest.raises(RuntimeError, match="meta"):
        make_field(torch.float32)(torch.empty(5, 4, device=META))
