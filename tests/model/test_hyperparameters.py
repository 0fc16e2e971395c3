import math

import pytest
import scipy.stats
import torch
from omegaconf import OmegaConf
from torch.func import functional_call

from torchdt.core.errors import InputError
from torchdt.field.mismatch import MISMATCH_SHARE
from torchdt.field.waveguide.family import ENVIRONMENT
from torchdt.model.hyperparameters import Hyperparameters, HyperparameterSettings, PriorSettings
from torchdt.model.model import Model

F64 = torch.float64
DEFAULTS = {
    "power_shape": 1e4,
    "noise_shape": torch.tensor(1e2),
    "survival": 0.95,
    "birth_mean": 1e-4,
    "driving_variance": torch.tensor([1e-2, 1e-5]),
    "likelihood_power": 1.0,
    "effective_count": 80.0,
    "mismatch_share": torch.tensor([0.03, 0.1, 0.5], dtype=F64),
    "eof_coefficients": torch.tensor([0.0, -1.5], dtype=F64),
    "tilt_deg": 0.0,
    "water_depth_m": -0.5,
}

KNOWN = Model().all_quantities() | {"mismatch_share": MISMATCH_SHARE} | ENVIRONMENT
QUANTITIES = {name: KNOWN[name]._replace(value=value) for name, value in DEFAULTS.items()}
OPEN = {name: quantity._replace(value=None) for name, quantity in KNOWN.items()}


def of(name: str, *, prior: PriorSettings | None = None, **settings) -> Hyperparameters:
    return Hyperparameters({name: HyperparameterSettings(**settings, prior=prior)}, QUANTITIES)


def of_all() -> Hyperparameters:
    settings = {name: HyperparameterSettings() for name in QUANTITIES}
    settings["likelihood_power"].start = 0.3
    settings["survival"].trainable = False
    return Hyperparameters(settings, QUANTITIES)


def test_every_quantity_starts_at_its_default():
    values = of_all().values()
    assert set(values) == set(DEFAULTS)
    assert values.pop("likelihood_power") == pytest.approx(0.3)
    for name, value in values.items():
        assert value == pytest.approx(torch.as_tensor(DEFAULTS[name]).tolist(), rel=1e-6)
        assert isinstance(value, list) == KNOWN[name].vector


def test_parameters_are_the_trainable_ones():
    module = of_all()
    named = dict(module.named_parameters())
    assert set(named) == set(module.trainable_names) == set(QUANTITIES) - {"survival"}
    assert {raw.dtype for raw in named.values()} == {F64}
    for name, value in module().items():
        assert value.dtype == F64
        assert value.requires_grad == (name != "survival")


def test_raw_values_are_unconstrained():
    raw = dict(of_all().named_parameters())
    assert raw["power_shape"].item() == pytest.approx(math.log(1e4 - 1), rel=1e-12)
    assert raw["mismatch_share"].tolist() == pytest.approx(scipy.special.logit([0.03, 0.1, 0.5]).tolist())
    assert raw["eof_coefficients"].tolist() == [0.0, -1.5]


@pytest.mark.parametrize("shift", [-300.0, 300.0])
def test_no_step_leaves_the_support(shift):
    module = of_all()
    with torch.no_grad():
        for raw in module.parameters():
            raw.add_(shift)
    for name, value in module().items():
        support = KNOWN[name].support.range
        # The smallest shape is one that the model accepts, so that rounding may reach it.
        above = value >= support.low if name.endswith("_shape") else value > support.low
        assert (above & (value < support.high)).all(), name


def test_gradients_of_the_maps():
    module = of_all()
    names = module.trainable_names

    def values(*raw):
        found = functional_call(module, dict(zip(names, raw, strict=True)), ())
        return tuple(found[name] for name in names)

    assert torch.autograd.gradcheck(values, tuple(module.parameters()))


def test_one_number_stands_for_all_entries():
    assert of("driving_variance", start=0.25).values() == {"driving_variance": pytest.approx([0.25, 0.25])}


def test_a_start_does_without_a_default():
    settings = {
        "tilt_deg": HyperparameterSettings(start=2),
        "mismatch_share": HyperparameterSettings(start=[0.5]),
    }
    assert Hyperparameters(settings, OPEN).values() == {"tilt_deg": 2.0, "mismatch_share": [0.5]}


def test_the_default_is_not_shared():
    default = torch.tensor(2.0, dtype=F64)
    module = Hyperparameters(
        {"tilt_deg": HyperparameterSettings()}, {"tilt_deg": KNOWN["tilt_deg"]._replace(value=default)}
    )
    with torch.no_grad():
        next(module.parameters()).add_(1.0)
    assert default == 2.0


@pytest.mark.parametrize("name", QUANTITIES)
def test_frozen_values_are_exact(name):
    """Also a likelihood power of one, at the end of its support."""
    module = of(name, trainable=False)
    assert list(module.parameters()) == []
    torch.testing.assert_close(module()[name], torch.as_tensor(DEFAULTS[name], dtype=F64), rtol=0, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_moving_the_module_moves_the_values(dtype):
    prior = PriorSettings(0.9, 0.5)
    module = of("survival", prior=prior).to(dtype)
    assert module()["survival"].dtype == module.log_prior().dtype == dtype


def test_priors_agree_with_scipy():
    settings = {
        "birth_mean": HyperparameterSettings(start=3e-4, prior=PriorSettings(1e-4, 0.7)),
        "survival": HyperparameterSettings(start=0.8, prior=PriorSettings(0.95, 1.5)),
        "driving_variance": HyperparameterSettings(prior=PriorSettings([1e-2, 1e-4], 2.0)),
        "mismatch_share": HyperparameterSettings(prior=PriorSettings(0.2, 0.3)),
        "tilt_deg": HyperparameterSettings(start=0.5, prior=PriorSettings(-1, 2.0)),
        "noise_shape": HyperparameterSettings(),
        "power_shape": HyperparameterSettings(trainable=False, prior=PriorSettings(1.0, 1.0)),
    }
    found = Hyperparameters(settings, QUANTITIES).log_prior()
    log, logit, density = math.log, scipy.special.logit, scipy.stats.norm.logpdf
    expected = (
        density(log(3e-4), log(1e-4), 0.7)
        + density(logit(0.8), logit(0.95), 1.5)
        + density(log(1e-2), log(1e-2), 2.0)
        + density(log(1e-5), log(1e-4), 2.0)
        + density(logit([0.03, 0.1, 0.5]), logit(0.2), 0.3).sum()
        + density(0.5, -1.0, 2.0)
    )
    assert found.shape == ()
    assert found.item() == pytest.approx(expected, rel=1e-6)  # defaults in single precision


def test_the_prior_pulls_towards_its_median():
    module = of("birth_mean", start=1.0, prior=PriorSettings(math.e, 0.5))
    module.log_prior().backward()
    assert next(module.parameters()).grad.item() == pytest.approx(1 / 0.25)


def test_without_priors_the_log_prior_is_zero():
    assert of_all().log_prior().item() == 0.0


def test_state_round_trip():
    module, other = of_all(), of_all()
    with torch.no_grad():
        for raw in module.parameters():
            raw.add_(0.3)
    assert other.values() != module.values()
    other.load_state_dict(module.state_dict())
    assert other.values() == module.values()


def test_state_of_other_settings_is_refused():
    with pytest.raises(RuntimeError, match="frozen_survival"):
        of("survival", trainable=False).load_state_dict(of("survival").state_dict())


def test_settings_come_from_hydra():
    schema = OmegaConf.structured(HyperparameterSettings)
    given = OmegaConf.create({"start": [0.1, 0.2], "prior": {"median": 0.1, "spread": 1}})
    found = OmegaConf.to_object(OmegaConf.merge(schema, given))
    assert found == HyperparameterSettings(True, [0.1, 0.2], PriorSettings(0.1, 1.0))


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("speed", {}, r"hyperparameters.speed': found an unknown name, expected .*'survival'"),
        ("survival", {"start": 1.0}, r"hyperparameters.survival': found 1.0, expected .*between 0 and 1"),
        ("survival", {"start": 0.0}, r"hyperparameters.survival': found 0.0"),
        ("survival", {"start": 1.0, "trainable": False}, r"hyperparameters.survival': found 1.0"),
        ("survival", {"start": math.nan}, r"hyperparameters.survival': found nan"),
        (
            "power_shape",
            {"start": math.inf},
            r"hyperparameters.power_shape': found inf, expected a finite number",
        ),
        (
            "noise_shape",
            {"start": 1.0},
            r"hyperparameters.noise_shape': found 1.0, .*not 1 to be learned, or trainable",
        ),
        ("birth_mean", {"start": -1}, r"hyperparameters.birth_mean': found -1.0"),
        (
            "tilt_deg",
            {"start": -math.inf},
            r"hyperparameters.tilt_deg': found -inf, expected a finite number",
        ),
        ("tilt_deg", {"start": "steep"}, r"hyperparameters.tilt_deg': found 'steep', expected a number or a"),
        ("tilt_deg", {"start": [1.0]}, r"hyperparameters.tilt_deg': found shape \(1,\), expected one number"),
        ("driving_variance", {"start": [1.0, 0.0]}, r"hyperparameters.driving_variance': found \[1.0, 0.0\]"),
        ("driving_variance", {"start": [1.0]}, r"driving_variance': found shape \(1,\), .*list of 2 numbers"),
        ("driving_variance", {"start": [[1.0, 1.0]]}, r"driving_variance': found shape \(1, 2\)"),
        (
            "driving_variance",
            {"start": [1.0, None]},
            r"hyperparameters.driving_variance': found \[1.0, None\]",
        ),
        (
            "likelihood_power",
            {},
            r"likelihood_power': found 1.0, expected .*not 1 to be learned, or trainable: false",
        ),
        ("likelihood_power", {"start": 1.1, "trainable": False}, r"likelihood_power': found 1.1"),
        (
            "survival",
            {"prior": PriorSettings(1.5, 1.0)},
            r"hyperparameters.survival.prior.median': found 1.5",
        ),
        (
            "survival",
            {"prior": PriorSettings(0.5, 0.0)},
            r"hyperparameters.survival.prior.spread': found 0.0",
        ),
        (
            "mismatch_share",
            {"prior": PriorSettings([0.5], 1.0)},
            r"mismatch_share.prior.median': found shape",
        ),
    ],
)
def test_bad_settings_are_named(name, settings, message):
    with pytest.raises(InputError, match=message):
        of(name, **settings)


@pytest.mark.parametrize("start", [0.5, []])
def test_a_vector_of_unknown_length_needs_a_list(start):
    with pytest.raises(InputError, match=r"mismatch_share': found shape .*, expected a list of numbers"):
        Hyperparameters({"mismatch_share": HyperparameterSettings(start=start)}, OPEN)


def test_what_the_model_lacks_cannot_be_tuned():
    with pytest.raises(InputError, match=r"hyperparameters.tilt_deg': found neither .* untunable here"):
        Hyperparameters({"tilt_deg": HyperparameterSettings()}, OPEN)


def test_a_default_outside_the_support_is_named():
    with pytest.raises(InputError, match=r"hyperparameters.mismatch_share': found \[0.0, 0.1\]"):
        Hyperparameters(
            {"mismatch_share": HyperparameterSettings()},
            {"mismatch_share": MISMATCH_SHARE._replace(value=torch.tensor([0.0, 0.1], dtype=F64))},
        )
