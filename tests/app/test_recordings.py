import dataclasses

import numpy as np
import pytest
import torch
from oracles.arrays import sample_covariance

from torchdt.core.errors import InputError
from torchdt.data.npz import write_npz
from torchdt.data.recording import validate

pytestmark = pytest.mark.slow


def table(outcome):
    rows = [[float(value) for value in row.values()] for row in outcome.rows("tracks.csv")]
    return np.array(rows).reshape(len(rows), -1)


@pytest.fixture(scope="module")
def track(launch, tmp_path_factory):
    """Write a recording and track it."""

    def track(recording, *overrides):
        path = tmp_path_factory.mktemp("recording", numbered=True) / "recording.npz"
        write_npz(path, recording)
        outcome = launch("data=npz", f"data.path={path}", *overrides)
        assert outcome.status == 0, outcome.err
        return outcome

    return track


@pytest.fixture(scope="module")
def nominal(track, recording):
    """The recording as it is."""
    return track(recording)


def as_covariance(recording):
    z = recording.snapshots
    return validate(
        step_s=recording.step_s,
        covariance=sample_covariance(z),
        num_snapshots=z.shape[-2],
        truth=recording.truth,
    )


def first_of(recording):
    return validate(step_s=1.0, snapshots=recording.snapshots[0], truth=recording.truth[0])


def test_file_of_a_batch_gives_the_tracks_of_the_simulation(launch, nominal):
    simulated = launch("runs=2")
    np.testing.assert_allclose(table(nominal), table(simulated), rtol=1e-4, atol=1e-4)
    assert nominal.json("metrics.json")["num_runs"] == 2
    assert nominal.values[0] == pytest.approx(simulated.values[0], abs=1e-4)


def test_file_of_one_sequence(recording, track, nominal):
    batch, single = table(nominal), table(track(first_of(recording)))
    np.testing.assert_allclose(single, batch[batch[:, 0] == 0], rtol=1e-4, atol=1e-4)


def test_covariance_stands_for_snapshots(recording, track, nominal):
    covariance = track(as_covariance(recording))
    np.testing.assert_allclose(table(covariance), table(nominal), rtol=1e-2, atol=1e-2)


def test_without_truth(recording, track, nominal):
    blind = track(dataclasses.replace(recording, truth=None))
    assert blind.values == [None]
    assert blind.json("metrics.json")["gospa"] is None
    assert not (blind.directory / "gospa.csv").exists()
    np.testing.assert_array_equal(table(blind), table(nominal))


def test_figures_without_truth(recording, track):
    blind = track(dataclasses.replace(recording, truth=None), "logging=default")
    assert {path.name for path in (blind.directory / "figures").iterdir()} == {"tracks.png", "surface.png"}


def test_scale_does_not_matter(recording, track, nominal):
    nominal, scale = table(nominal), 1e-7
    scaled = table(track(dataclasses.replace(recording, snapshots=scale * recording.snapshots)))
    powers = np.isin(np.arange(nominal.shape[1]), (7, 8))
    np.testing.assert_allclose(scaled[:, ~powers], nominal[:, ~powers], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(scaled[:, powers], scale**2 * nominal[:, powers], rtol=1e-3)


def test_missing_values_and_dead_channels(recording, track):
    snapshots = recording.snapshots.clone()
    snapshots[0, ..., 2] = torch.nan  # a channel of the first sequence, 5 steps * 2 tones * 3 snapshots
    snapshots[1, 3] = torch.nan  # a step of the second, 2 * 3 * 8 values
    outcome = track(dataclasses.replace(recording, snapshots=snapshots))
    assert "78 of 480 values are missing" in outcome.log
    assert "dead channels of each sequence: [[2], []]" in outcome.log
    assert np.isfinite(table(outcome)).all()
    assert outcome.values[0] < 2  # degrees


def test_nothing_but_missing_values(recording, track):
    missing = torch.full_like(recording.snapshots, torch.nan)
    outcome = track(dataclasses.replace(recording, snapshots=missing))
    assert outcome.rows("tracks.csv") == []


def test_complete_file_gives_no_warning(nominal):
    assert "WARNING" not in nominal.log


def test_step_of_the_file_counts(recording, track):
    outcome = track(dataclasses.replace(recording, step_s=0.25))
    rows = outcome.rows("tracks.csv")
    assert {float(row["time_s"]) - 0.25 * int(row["step"]) for row in rows} == {0.125}
    assert any(int(row["step"]) > 0 for row in rows)


def test_times_are_those_of_the_files(launch, recording, tmp_path):
    """One file begins half a minute after the other."""
    single = first_of(recording)
    for name, start_s in (("early", 100.0), ("late", 130.0)):
        write_npz(tmp_path / f"{name}.npz", dataclasses.replace(single, start_s=torch.tensor([start_s])))
    outcome = launch(f"data.path=[{tmp_path}/early.npz,{tmp_path}/late.npz]", "data=npz")
    assert outcome.status == 0, outcome.err
    for table in ("tracks.csv", "gospa.csv"):
        rows = outcome.rows(table)
        assert {row["run"] for row in rows} == {"0", "1"}
        for row in rows:
            assert float(row["time_s"]) == 100.0 + 30.0 * int(row["run"]) + int(row["step"]) + 0.5


def positions(along):
    along = torch.as_tensor(along, dtype=torch.float64)
    return torch.stack([along, 0 * along, 0 * along], -1)


@pytest.mark.parametrize(
    ("known", "wrong"),
    [
        ({"freqs": torch.tensor([100.0, 150.0])}, "field.freqs=[60,90]"),
        ({"sensor_positions": positions(range(0, 40, 5))}, "field.sensor_positions=[0,3,6,9,12,15,18,21]"),
    ],
    ids=["freqs", "sensor_positions"],
)
def test_array_of_the_file_replaces_the_configured_one(recording, track, nominal, known, wrong):
    right = table(nominal)
    replaced = table(track(dataclasses.replace(recording, **known), wrong))
    np.testing.assert_array_equal(replaced, right)
    misled = table(track(recording, wrong))
    assert misled.shape != right.shape or np.abs(misled[:, 5] - right[:, 5]).max() > 1


def test_own_field_target(recording, track, nominal):
    target = "field._target_=torchdt.field.plane_wave.LineArrayField"
    own = ("~field.sensor_positions", "+field.positions=[0,5,10,15,20,25,30,35]")
    np.testing.assert_allclose(table(track(recording, target, *own)), table(nominal), rtol=1e-3, atol=1e-3)


@pytest.fixture
def files(recording, tmp_path):
    """One sequence a file, changed as wanted; the second has one object more."""

    def files(**changes):
        paths = [tmp_path / name for name in ("first.npz", "second.npz")]
        more = torch.cat([recording.truth[1:], torch.full_like(recording.truth[1:, :, :1], 3.0)], 2)
        second = dataclasses.replace(recording.select(slice(1, 2)), truth=more)
        write_npz(paths[0], recording.select(slice(0, 1)))
        write_npz(paths[1], dataclasses.replace(second, **changes))
        return paths

    return files


def test_several_files_are_one_batch(launch, nominal, files):
    outcome = launch("data=npz", "data.path=[{},{}]".format(*files()))
    assert outcome.status == 0, outcome.err
    np.testing.assert_allclose(table(outcome), table(nominal), rtol=1e-4, atol=1e-4)
    assert outcome.json("metrics.json")["num_runs"] == 2
    counts = [[int(row["num_truth"]) for row in outcome.rows("gospa.csv") if row["run"] == r] for r in "01"]
    assert [b - a for a, b in zip(*counts, strict=True)] == [1] * 5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: {"snapshots": r.snapshots[1:, :4], "truth": None}, ("'steps': found 4, expected 5",)),
        (lambda r: {"truth": None}, ("'truth': found nothing, expected positions of 1 coordinates",)),
        (lambda r: {"truth": r.truth[1:].expand(-1, -1, -1, 2)}, ("'truth': found positions of 2",)),
        (lambda r: {"snapshots": r.snapshots[1:, :, :1]}, ("'snapshots': found", "(1, 3, 8)", "(2, 3, 8)")),
        (lambda r: {"snapshots": r.snapshots[1:, ..., :7]}, ("'snapshots': found", "(2, 3, 7)")),
        (lambda r: {"step_s": 2.0}, ("'step_s': found 1.0 and 2.0",)),
        (lambda r: {"freqs": torch.tensor([1.0, 2.0])}, ("'freqs': found None and [1.0, 2.0]",)),
    ],
)
def test_the_file_that_does_not_fit_is_named(attempt, recording, files, change, words):
    first, second = files(**change(recording))
    with pytest.raises(InputError) as caught:
        attempt("data.kind=npz", f"data.path=[{first},{second}]")
    for word in (f"path '{second}': key ", f"to fit '{first}'", *words):
        assert word in str(caught.value)


@pytest.mark.parametrize("path", ["[]", "[a.npz,null]", "7"])
def test_what_is_no_path_is_named(attempt, path):
    with pytest.raises(
        InputError, match=r"key 'data.path': found .*expected the path of a file or a list of paths"
    ):
        attempt("data.kind=npz", f"data.path={path}")
