import math
import re

import pytest
import torch
from oracles.events import images, layout, read, scalars

from torchdt.app.report.clouds import Frame
from torchdt.app.report.figures import WAVEGUIDE_AXES
from torchdt.app.report.tensorboard import LAYOUT, TensorBoardReport
from torchdt.baselines.mot.tracker import PointObjects, PointState
from torchdt.model.region import Coordinate, Region


def write(report, history, score=None, state=None, truth=None):
    """All steps of run 1."""
    history, score = history.select(1), score and score.select(1)
    for step in range(6):
        truths = None if truth is None else truth[1, step]
        own, found = score and score.select(step), history.select(step)
        report.add_step(step, 4.0 * step, state, found, own, truths)


@pytest.fixture
def frame():
    coordinates = [
        Coordinate("range", "m", 0, 5000, 50, -3, 3, 1e-3),
        Coordinate("depth", "m", 0, 200, 5, -1, 1, 1e-3),
    ]
    return Frame.of_region(Region(coordinates), WAVEGUIDE_AXES)


def test_scalars(tmp_path, history, score):
    with TensorBoardReport(tmp_path / "tensorboard") as report:
        write(report, history, score)
    events = read(tmp_path / "tensorboard")
    labels = ("label_03", "label_12")
    expected = {f"gospa/{part}" for part in ("total", "localisation", "missed", "false")}
    expected |= {f"energy/{part}" for part in ("objects", "interferers", "noise", "unexplained")}
    expected |= {"count/declared", "count/true", "log_evidence", "noise_db/tone_1", "noise_db/tone_2"}
    expected |= {
        f"{kind}/{label}"
        for kind in ("existence", "transmission", "effective_sample_size")
        for label in labels
    }
    expected |= {f"power_db/{label}/tone_{tone}" for label in labels for tone in (1, 2)}
    assert set(events.Tags()["scalars"]) == expected

    assert scalars(events, "gospa/total") == [(k, v) for k, v in enumerate([1.0, 1, 101, 101, 101, 101])]
    assert scalars(events, "gospa/false")[2] == (2, 100.0)
    assert scalars(events, "count/declared") == [(0, 1), (1, 1), (2, 2), (3, 1), (4, 1), (5, 1)]
    assert scalars(events, "count/true") == [(0, 1), (1, 1), (2, 1), (3, 2), (4, 2), (5, 2)]
    ghost = scalars(events, "existence/label_12")  # from its first step on, declared or not
    assert [step for step, _ in ghost] == [2, 3, 4, 5]
    assert [value for _, value in ghost] == pytest.approx([0.987654321, 0.01, 0.01, 0.01])
    assert scalars(events, "power_db/label_03/tone_2")[0] == (0, 30.0)
    assert scalars(events, "noise_db/tone_2")[0] == (0, pytest.approx(-20.0, abs=1e-5))
    assert scalars(events, "effective_sample_size/label_03")[0] == (0, 80.0)
    assert scalars(events, "log_evidence")[0] == (0, -2.5)


def test_without_truth(tmp_path, history):
    with TensorBoardReport(tmp_path) as report:
        write(report, history)
    tags = read(tmp_path).Tags()
    assert "count/declared" in tags["scalars"]
    assert not any(tag.startswith(("gospa", "count/true")) for tag in tags["scalars"])


def test_numbers_that_are_not_finite_are_left_out(tmp_path, history):
    history.noise[..., 0] = 0.0
    history.noise[..., 1] = math.nan
    history.log_evidence[1, 2] = -math.inf
    with TensorBoardReport(tmp_path) as report:
        write(report, history)
    events = read(tmp_path)
    assert not any(tag.startswith("noise_db") for tag in events.Tags()["scalars"])
    assert [step for step, _ in scalars(events, "log_evidence")] == [0, 1, 3, 4, 5]


@pytest.fixture
def points(state):
    known = state.objects
    objects = PointObjects(known.state, known.log_weight, known.log_odds, known.label, known.mean_power)
    return PointState(objects, torch.tensor(13))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["state", "points"])
def test_beliefs_at_an_interval(tmp_path, history, truth, frame, kind, request):
    state = request.getfixturevalue(kind)
    with TensorBoardReport(tmp_path, interval=2, frame=frame) as report:
        write(report, history, state=state, truth=truth)
    events = read(tmp_path)
    tags = events.Tags()
    labels = ("label_03", "label_12")
    assert set(tags["histograms"]) == {"belief/existence", *(f"belief/power_db/{name}" for name in labels)}
    assert tags["images"] == ["belief/particles"]
    assert [event.step for event in events.Histograms("belief/existence")] == [0, 2, 4]
    assert [event.step for event in events.Histograms("belief/power_db/label_12")] == [2, 4]
    drawn = images(events, "belief/particles")
    assert list(drawn) == [0, 2, 4]
    assert all(image[..., :3].std() > 0.02 for image in drawn.values())


def test_histogram_of_existence(tmp_path, history):
    history.existence[1, 2] = torch.tensor([1.0, 0.97, 0.0])  # the last one is an empty slot
    with TensorBoardReport(tmp_path, interval=2) as report:
        write(report, history)
    _, event, _ = read(tmp_path).Histograms("belief/existence")
    found = event.histogram_value
    assert (found.num, found.max) == (2, 1)
    assert (found.sum, found.min) == (pytest.approx(1.97), pytest.approx(0.97))
    assert found.bucket_limit == pytest.approx([i / 20 for i in range(1, 21)])
    assert found.bucket == [0] * 19 + [2]


def test_histogram_of_powers(tmp_path, history, state):
    """Two tones of 10 and 30 dB on three support points each: 3 dB below, at and 3 dB above the mean."""
    with TensorBoardReport(tmp_path, interval=2) as report:
        write(report, history, state=state)
    event, *_ = read(tmp_path).Histograms("belief/power_db/label_03")
    found = event.histogram_value
    assert found.num == pytest.approx(2)  # tones
    assert found.sum == pytest.approx(40 + 2 * 0.4 * -3.0103 + 2 * 0.2 * 3.0103)
    assert (found.min, found.max) == pytest.approx((10 - 3.0103, 30 + 3.0103))
    weight = {limit: count for limit, count in zip(found.bucket_limit, found.bucket, strict=True) if count}
    # Decibels are rounded down, but for rounding at 10 and 30.
    assert weight == {
        limit: pytest.approx(w) for limit, w in {7: 0.4, 11: 0.4, 14: 0.2, 27: 0.4, 31: 0.4, 34: 0.2}.items()
    }


def test_support_points_without_weight_do_not_widen_a_histogram(tmp_path, history, state):
    objects = state.objects
    power = objects.power.clone()
    power[..., 0] = 1e-9
    weight = torch.tensor([1e-5, 0.99999, 0.0]).log()
    far = state._replace(objects=objects._replace(power=power, log_power_weight=weight.expand_as(power)))
    with TensorBoardReport(tmp_path, interval=2) as report:
        write(report, history, state=far)
    event, *_ = read(tmp_path).Histograms("belief/power_db/label_03")
    assert event.histogram_value.min == pytest.approx(10, abs=0.01)
    assert event.histogram_value.bucket_limit == list(range(11, 32))


def test_without_an_interval_no_beliefs(tmp_path, history, state, frame):
    with TensorBoardReport(tmp_path, frame=frame) as report:
        write(report, history, state=state)
    tags = read(tmp_path).Tags()
    assert (tags["histograms"], tags["images"]) == ([], [])


def test_unknown_states_show_existence_alone(tmp_path, history, frame):
    with TensorBoardReport(tmp_path, interval=2, frame=frame) as report:
        write(report, history, state=("a", "state", "of", "one's", "own"))
    tags = read(tmp_path).Tags()
    assert (tags["histograms"], tags["images"]) == (["belief/existence"], [])


@pytest.mark.slow
def test_goes_on_at_a_step(tmp_path, history, score, state, frame):
    killed = TensorBoardReport(tmp_path, interval=2, frame=frame)
    write(killed, history, score, state)
    killed.flush()
    with TensorBoardReport(tmp_path, first_step=3, interval=2, frame=frame) as report:
        for step in (3, 4):
            estimate, own = (parts.select(1).select(step) for parts in (history, score))
            report.add_step(step, 4.0 * step, state, estimate, own)
    events = read(tmp_path)
    assert [step for step, _ in scalars(events, "gospa/total")] == [0, 1, 2, 3, 4]
    assert [event.step for event in events.Histograms("belief/existence")] == [0, 2, 4]
    assert list(images(events, "belief/particles")) == [0, 2, 4]
    killed.close()


def test_layout_has_every_scalar_of_every_step_in_one_chart(tmp_path, history, score):
    with TensorBoardReport(tmp_path) as report:
        write(report, history, score)
    events = read(tmp_path)
    charts = layout(events)
    assert charts == LAYOUT
    patterns = [pattern for category in charts.values() for tags in category.values() for pattern in tags]
    for tag in events.Tags()["scalars"]:
        assert sum(bool(re.match(pattern, tag)) for pattern in patterns) == 1, tag


def test_config(tmp_path):
    with TensorBoardReport(tmp_path) as report:
        report.add_config({"tracker": {"num_particles": 300}, "path": tmp_path})
    (text,) = read(tmp_path).Tensors("config/text_summary")
    assert b'"num_particles": 300' in text.tensor_proto.string_val[0]


def test_closes_after_an_error(tmp_path, history):
    def fail_midway():
        with TensorBoardReport(tmp_path) as report:
            write(report, history)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_midway()
    assert len(scalars(read(tmp_path), "count/declared")) == 6
