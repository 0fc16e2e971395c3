import math

import pytest
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchdt.report.tensorboard import TensorBoardReport


def events(path):
    accumulator = EventAccumulator(str(path), size_guidance={"scalars": 0})
    accumulator.Reload()
    return accumulator


def scalars(accumulator, tag):
    return [(event.step, event.value) for event in accumulator.Scalars(tag)]


def test_scalars(tmp_path, history, score):
    with TensorBoardReport(tmp_path / "tensorboard") as report:
        report.add_history(history.select(1), score.select(1))
    read = events(tmp_path / "tensorboard")
    labels = ("label_03", "label_12")
    expected = {f"gospa/{part}" for part in ("total", "localisation", "missed", "false")}
    expected |= {"count/declared", "count/true", "log_evidence", "noise_db/tone_1", "noise_db/tone_2"}
    expected |= {f"{kind}/{label}" for kind in ("existence", "effective_sample_size") for label in labels}
    expected |= {f"power_db/{label}/tone_{tone}" for label in labels for tone in (1, 2)}
    assert set(read.Tags()["scalars"]) == expected

    assert scalars(read, "gospa/total") == [(k, v) for k, v in enumerate([1.0, 1, 101, 101, 101, 101])]
    assert scalars(read, "gospa/false")[2] == (2, 100.0)
    assert scalars(read, "count/declared") == [(0, 1), (1, 1), (2, 2), (3, 1), (4, 1), (5, 1)]
    assert scalars(read, "count/true") == [(0, 1), (1, 1), (2, 1), (3, 2), (4, 2), (5, 2)]
    ghost = scalars(read, "existence/label_12")  # from its first step on, declared or not
    assert [step for step, _ in ghost] == [2, 3, 4, 5]
    assert [value for _, value in ghost] == pytest.approx([0.987654321, 0.01, 0.01, 0.01])
    assert scalars(read, "power_db/label_03/tone_2")[0] == (0, 30.0)
    assert scalars(read, "noise_db/tone_2")[0] == (0, pytest.approx(-20.0, abs=1e-5))
    assert scalars(read, "effective_sample_size/label_03")[0] == (0, 80.0)
    assert scalars(read, "log_evidence")[0] == (0, -2.5)


def test_one_event_file_for_many_steps(tmp_path, history):
    with TensorBoardReport(tmp_path) as report:
        for step in range(6):
            one = type(history)(*(field[step : step + 1] for field in history.select(0)))
            report.add_history(one, first_step=step)
    assert len(list(tmp_path.rglob("events.out.*"))) == 1
    read = events(tmp_path)
    assert scalars(read, "count/declared") == [(k, 1.0) for k in range(6)]
    assert not any(tag.startswith(("gospa", "count/true")) for tag in read.Tags()["scalars"])


def test_numbers_that_are_not_finite_are_left_out(tmp_path, history):
    broken = history.select(0)
    broken.noise[:, 0] = 0.0
    broken.noise[:, 1] = math.nan
    broken.log_evidence[2] = -math.inf
    with TensorBoardReport(tmp_path) as report:
        report.add_history(broken)
    read = events(tmp_path)
    assert not any(tag.startswith("noise_db") for tag in read.Tags()["scalars"])
    assert [step for step, _ in scalars(read, "log_evidence")] == [0, 1, 3, 4, 5]


def test_figure_and_config(tmp_path):
    figure = Figure(figsize=(2, 1), dpi=50)
    figure.subplots().plot([0, 1])
    report = TensorBoardReport(tmp_path)
    report.add_figure("tracks", figure, step=4)
    report.add_config({"tracker": {"num_particles": 300}, "path": tmp_path})
    report.close()
    report.close()
    read = events(tmp_path)
    (image,) = read.Images("tracks")
    assert (image.step, image.width, image.height) == (4, 100, 50)
    (text,) = read.Tensors("config/text_summary")
    assert b'"num_particles": 300' in text.tensor_proto.string_val[0]


def test_closes_after_an_error(tmp_path, history):
    def fail_midway():
        with TensorBoardReport(tmp_path) as report:
            report.add_history(history.select(0))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_midway()
    assert len(scalars(events(tmp_path), "count/declared")) == 6
