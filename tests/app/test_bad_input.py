"""What does not fit ends the run with a message that names the key, what was found and what was expected."""

import numpy as np
import pytest
from hydra.errors import HydraException
from oracles.arrays import changed, sample_covariance

from torchdt.core.errors import InputError
from torchdt.data.npz import write_npz

pytestmark = pytest.mark.slow
FIRST = "scenario.sources.first"
PATH = "scenario.paths.first"
MISMATCH = "scenario.mismatch"


@pytest.fixture
def fails(attempt):
    def fails(override, *words):
        with pytest.raises((InputError, HydraException)) as caught:
            attempt(*([override] if isinstance(override, str) else override))
        message = f"{caught.value}\n{caught.value.__cause__}"
        for word in words:
            assert word in message

    return fails


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("scenario=nowhere", ("'scenario/nowhere'", "line_array", "swellex96")),
        ("tracker=nowhere", ("'tracker/nowhere'", "direct")),
        ("tracker.particle=5", ("'particle'", "not in 'TrackerConfig'")),
        ("tracker.particles=-3", ("key 'tracker.particles': found -3, expected a positive integer",)),
        ("field=swellex96", ("found 1 coordinates", "expected 2")),
        ("data=npz", ("data.path", "found", "expected")),
    ],
)
def test_a_job_ends_without_results(launch, override, words):
    """What the other tests here see in this process is said on the command line."""
    outcome = launch(override)
    assert outcome.status == 1
    assert outcome.values == []
    assert "Traceback" not in outcome.err
    assert not (outcome.directory / "metrics.json").exists()
    for word in words:
        assert word in outcome.err


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("colour=red", ("'colour'", "not in 'TrackSettings'")),
        ("scenario.steps=5", ("'steps'", "not in 'ScenarioSettings'")),
        (f"{FIRST}.level=5", ("'level'", "not in 'SourceSettings'")),
        ("tracker.particles=many", ("tracker.particles", "'many'", "Integer")),
        ("scenario.num_steps=2.5", ("scenario.num_steps", "'2.5'", "Integer")),
        ("scenario.snr_db=loud", ("scenario.snr_db", "'loud'", "Float")),
        (f"{FIRST}.silences=[3]", (f"{FIRST}.silences", "int is not a ListConfig")),
        (f"{FIRST}.silences=[[0.5,1.5]]", (f"{FIRST}.silences", "0.5 (float)", "'int'")),
    ],
)
def test_what_the_schema_refuses(fails, override, words):
    fails(override, *words)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("runs", "0", "a positive integer"),
        ("threads", "0", "a positive integer or null"),
        ("workers", "0", "a positive integer or null"),
        ("memory_gb", "0.0", "a positive number or null"),
        ("dtype", "float16", "float32 or float64"),
        ("data.kind", "wav", "simulated or npz"),
        ("logging.surface_step", "-1", "a step from 0 up"),
        *(
            (f"tracker.{name}", "0", "a positive integer")
            for name in ("slots", "particles", "births", "sweeps")
        ),
        *((f"tracker.proposal.{name}", "-3", "a positive integer") for name in ("rounds", "round_size")),
        *((f"tracker.{name}", "-3", "a positive integer") for name in ("power_points", "noise_points")),
        ("model.noise.noise_shape", "0.9", "a finite number of at least 1"),
        ("model.survival", "0.0", "strictly between 0 and 1"),
        ("model.survival", "1.5", "strictly between 0 and 1"),
        ("model.power.power_shape", "inf", "a finite number of at least 1"),
        ("model.birth.birth_mean", "0.0", "a positive number"),
        *((f"tracker.{name}", "0.0", "a positive number or null") for name in ("power_max", "noise_max")),
        *((f"tracker.{name}", "0.0", "strictly between 0 and 1") for name in ("declare", "prune")),
        *((f"tracker.{name}", "1.5", "strictly between 0 and 1") for name in ("declare", "prune")),
        *((f"tracker.resampler.{name}", "-0.1", "a number from 0 to 1") for name in ("roughening", "below")),
        ("tracker.resampler.roughening", "nan", "a number from 0 to 1"),
        ("tracker.evidence.samples", "0", "a positive integer"),
        ("model.likelihood_power", "0.0", "a number above 0, up to 1"),
        ("model.likelihood_power", "1.1", "a number above 0, up to 1"),
        ("tracker.schedule", "flooding", "a choice of the group tracker/schedule"),
        ("scenario.num_steps", "0", "a positive integer"),
        ("scenario.num_snapshots", "-1", "a positive integer"),
        ("scenario.step_s", "0.0", "a positive number"),
        ("scenario.step_s", "inf", "a positive number"),
        ("scenario.snr_db", "nan", "a finite number"),
        ("scenario.gospa_cutoff", "-1.0", "a positive number"),
        ("scenario.gospa_order", "0.5", "a number from 1 up"),
        ("scenario.phase_step_deg", "-1.0", "a number from 0 up"),
        ("scenario.amplitudes", "square", "gaussian or constant_modulus"),
        ("scenario.coordinates", "[]", "at least one coordinate"),
        (f"{FIRST}.path", "nowhere", "one of ['first', 'second']"),
        (f"{MISMATCH}.eof_scale", "-1.0", "a number from 0 up"),
        (f"{MISMATCH}.tilt_deg", "[2.0, 1.0]", "[smallest, largest], both from 0 up"),
        (f"{MISMATCH}.water_depth_m", "[1.0]", "[smallest, largest], both from 0 up"),
    ],
)
def test_value_out_of_range(fails, key, value, expected):
    fails(f"{key}={value}", f"key '{key}': found {value}, expected ", expected)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (f"{FIRST}.birth=-1", ("scenario.sources.", "birth'", "found -1", "a step from 0 up")),
        ("scenario.sources.second.death=5", ("death'", "found 5", "a step after birth 10")),
        (f"{FIRST}.silences=[[5,3]]", ("silences'", "found [[5, 3]]", "pairs [first, last]")),
        (f"{PATH}.times_s=[0]", ("positions'", "found [[-40], [0]]", "1 positions")),
        (f"{PATH}.times_s=[0,0]", ("times_s'", "found [0.0, 0.0]", "increasing times")),
        (f"{PATH}.positions=[[1],[2,3]]", (f"{PATH}.positions'", "found [[1], [2, 3]]", "1 coordinates")),
        ("scenario.coordinates.0.low=80", ("coordinates.bearing.low'", "found 80.0", "below high, 70.0")),
        ("scenario.coordinates.0.cell=0", ("bearing.cell'", "found 0.0", "a positive number")),
        ("scenario.coordinates.0.cell=1e-12", ("bearing.cell'", "found 1e-12", "at least 1.4e-05")),
        (f"{MISMATCH}.tilt_deg=[0,1]", (f"'{MISMATCH}'", "found a mismatch", "no environment to vary")),
    ],
)
def test_scenario_that_makes_no_sense(fails, override, words):
    fails(override, *words)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("field._target_=torchdt.nowhere", ("key 'field'", "'torchdt.nowhere'")),
        ("field._target_=builtins.dict", ("key 'field._target_'", "found dict", "torchdt.field.base.Field")),
        ("+field.speed=3", ("key 'field'", "unexpected keyword argument 'speed'")),
        ("~field.wave_speed", ("key 'field'", "missing 1 required", "'wave_speed'")),
        ("field.wave_speed=-1", ("key 'field.wave_speed'", "found -1", "expected a positive number")),
        ("field.wave_speed=nan", ("key 'field.wave_speed'", "found nan", "expected a positive number")),
        (
            "field.freqs=[100,-3]",
            ("key 'field.freqs'", "[100, -3]", "expected one positive frequency"),
        ),
        ("field.sensor_positions=[]", ("key 'field.sensor_positions'", "expected (M,): each sensor's")),
        ("scenario.coordinates.0.low=-180", ("bearing", "which the sensors cannot tell apart")),
    ],
)
def test_field_that_cannot_be_built(fails, override, words):
    fails(override, *words)


@pytest.mark.parametrize(
    "override",
    [
        "+scenario.colour=red",
        "+tracker.colour=red",
        f"{PATH}.positions=[[a],[b]]",
        f"{FIRST}.power_db=nan",
        f"{FIRST}.frozen_step=-5",
        "device=tpu",
    ],
)
def test_what_the_schema_alone_lets_through(fails, override):
    name = override.partition("=")[0].rpartition(".")[2]
    fails(override, name, "found", "expected")


@pytest.fixture
def data(tmp_path):
    """Overrides that choose a file of these arrays."""

    def data(arrays):
        path = tmp_path / "bad.npz"
        np.savez(path, **arrays)
        return "data.kind=npz", f"data.path={path}"

    return data


@pytest.fixture
def arrays(recording):
    return {
        "snapshots": recording.snapshots.numpy(),
        "truth": recording.truth.numpy(),
        "step_s": recording.step_s,
    }


@pytest.fixture
def covariance(recording):
    return {
        "covariance": sample_covariance(recording.snapshots).numpy(),
        "num_snapshots": 3,
        "step_s": recording.step_s,
    }


def test_good_arrays_are_tracked(attempt, data, arrays, covariance):
    assert not attempt(*data(arrays)).failed.any()
    assert not attempt(*data(covariance)).failed.any()


def test_no_such_file(fails, tmp_path):
    path = tmp_path / "nowhere.npz"
    fails(
        ("data.kind=npz", f"data.path={path}"),
        f"path '{path}'",
        "found no such file",
        "expected a complete .npz",
    )


def test_truncated_file(fails, recording, tmp_path):
    path = tmp_path / "part.npz"
    write_npz(path, recording)
    path.write_bytes(path.read_bytes()[:-100])
    fails(("data.kind=npz", f"data.path={path}"), f"path '{path}'", "found", "expected a complete .npz")


def test_file_of_another_kind(fails, tmp_path):
    path = tmp_path / "notes.npz"
    path.write_text("not an archive")
    fails(("data.kind=npz", f"data.path={path}"), f"path '{path}'", "found", "expected a complete .npz")


def test_pickled_objects(fails, data, arrays):
    arrays["truth"] = np.array([{"range": 1}], dtype=object)
    fails(data(arrays), "bad.npz", "key 'truth'", "found", "expected a numeric array")


def test_number_of_tones(fails, data, arrays):
    arrays["snapshots"] = arrays["snapshots"][:, :, :1]
    fails(data(arrays), "key 'snapshots'", "found 1 tones", "expected 2 tones")


def test_number_of_sensors(fails, data, arrays, covariance):
    arrays["snapshots"] = arrays["snapshots"][..., :7]
    fails(data(arrays), "key 'snapshots'", "found 7 sensors", "expected 8 sensors")
    covariance["covariance"] = covariance["covariance"][..., :7, :7]
    fails(data(covariance), "key 'covariance'", "found 7 sensors", "expected 8 sensors")


@pytest.mark.parametrize("step", [0.0, -1.0, np.inf, np.nan])
def test_step(fails, data, arrays, step):
    fails(
        data(arrays | {"step_s": step}),
        "key 'step_s'",
        f"found {step}",
        "expected a number of seconds above zero",
    )


def test_no_step(fails, data, arrays):
    del arrays["step_s"]
    fails(data(arrays), "key 'step_s'", "found nothing", "expected the seconds")


def test_truth_of_another_length(fails, data, arrays):
    arrays["truth"] = arrays["truth"][:, :4]
    fails(data(arrays), "key 'truth'", "found 4 steps", "expected 5 steps")


def test_truth_of_other_coordinates(fails, data, arrays):
    arrays["truth"] = np.repeat(arrays["truth"], 2, axis=-1)
    fails(data(arrays), "key 'truth'", "found 2 coordinates", "expected 1, as the scenario")


@pytest.mark.parametrize("key", ["snapshots", "truth"])
def test_infinite_values(fails, data, arrays, key):
    arrays[key] = changed(arrays[key], (0, 2, 0, 0), np.inf)
    fails(data(arrays), f"key '{key}'", "found", "infinite values, the first at (0, 2, 0, 0", "expected none")


def test_zeros_throughout(fails, data, arrays):
    arrays["snapshots"] = np.zeros_like(arrays["snapshots"])
    fails(data(arrays), "key 'snapshots'", "found only zeros", "expected")


def test_real_snapshots(fails, data, arrays):
    arrays["snapshots"] = arrays["snapshots"].real
    fails(data(arrays), "key 'snapshots'", "found torch.float64", "expected complex")


def test_covariance_that_is_not_hermitian(fails, data, covariance):
    covariance["covariance"] = changed(covariance["covariance"], (1, 2, 0, 0, 1), 50.0)
    words = ("found a matrix that is not Hermitian (run 1, step 2, tone 0", "expected Hermitian matrices")
    fails(data(covariance), "key 'covariance'", *words)


def test_covariance_without_count(fails, data, covariance):
    del covariance["num_snapshots"]
    fails(data(covariance), "key 'num_snapshots'", "found nothing", "expected")


def test_both_kinds_of_data(fails, data, arrays, covariance):
    fails(data(arrays | covariance), "key 'covariance'", "found snapshots as well", "expected either")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("freqs", np.array([100.0]), ("found shape (1,)", "expected (2,)")),
        ("freqs", np.array([100.0, 0.0]), ("found 0.0", "expected frequencies above zero")),
        ("sensor_positions", np.zeros((7, 3)), ("found shape (7, 3)", "expected (8, 3)")),
        ("sensor_positions", np.eye(8, 3), ("found sensors off a line", "expected sensors along")),
    ],
)
def test_array_that_does_not_fit(fails, data, arrays, key, value, words):
    fails(data(arrays | {key: value}), f"key '{key}'", *words)
