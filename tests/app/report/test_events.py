import errno
import math
from unittest import mock

import pytest
from matplotlib.figure import Figure
from oracles.events import hparams, images, layout, metric_columns, read, scalars
from torch.utils.tensorboard import SummaryWriter

from torchdt.app.report.events import EventReport
from torchdt.core.errors import StorageError

LAYOUT = {"Some": {"both": ["a", "b/.*"], "one": ["a"]}, "Others": {"c": ["c"]}}


@pytest.fixture
def figure():
    figure = Figure(figsize=(2, 1), dpi=50)
    figure.subplots().plot([0, 1])
    return figure


def write(report, figure, steps, value):
    for step in steps:
        report.add_scalar("a", value, step)
        report.add_figure("f", figure, step)
    report.flush()


def test_steps_that_a_killed_process_wrote_are_hidden(tmp_path, figure):
    killed = EventReport(tmp_path, 0, LAYOUT)
    write(killed, figure, range(6), 1.0)
    with EventReport(tmp_path, 4, LAYOUT) as report:
        write(report, figure, (4, 5, 6), 2.0)
    events = read(tmp_path)
    assert scalars(events, "a") == [(0, 1), (1, 1), (2, 1), (3, 1), (4, 2), (5, 2), (6, 2)]
    assert list(images(events, "f")) == list(range(7))
    killed.close()


def test_a_run_begun_anew_hides_an_earlier_one(tmp_path, figure):
    with EventReport(tmp_path, 0, LAYOUT) as report:
        write(report, figure, range(6), 1.0)
    with EventReport(tmp_path, 0, LAYOUT) as report:
        write(report, figure, range(2), 2.0)
    events = read(tmp_path)
    assert scalars(events, "a") == [(0, 2), (1, 2)]
    assert list(images(events, "f")) == [0, 1]
    assert layout(events) == LAYOUT


def test_numbers_that_are_not_finite_are_left_out(tmp_path):
    with EventReport(tmp_path, 0, LAYOUT) as report:
        for step, value in enumerate([1.5, math.nan, math.inf, None, -math.inf, 2.5]):
            report.add_scalar("a", value, step)
    assert scalars(read(tmp_path), "a") == [(0, 1.5), (5, 2.5)]


def test_figures_are_images(tmp_path, figure):
    with EventReport(tmp_path, 0, LAYOUT) as report:
        report.add_figure("f", figure, step=4)
    (step, image), *more = images(read(tmp_path), "f").items()
    assert (step, image.shape[:2], more) == (4, (50, 100), [])
    assert image.std() > 0.02  # of 0 to 1; a blank picture has none


def test_layout(tmp_path):
    EventReport(tmp_path, 0, LAYOUT).close()
    assert layout(read(tmp_path)) == LAYOUT


def test_one_row_of_the_run_itself(tmp_path):
    settings = {"tracker": "direct", "seed": 3, "share": 0.5}
    metrics = {"gospa": 1.5, "log_likelihood": math.nan, "declared": None}
    with EventReport(tmp_path, 0, LAYOUT) as report:
        report.add_scalar("a", 1.0, 0)
        report.add_hparams(settings, metrics, step=9)
    assert [path.is_file() for path in tmp_path.iterdir()] == [True]  # no folder, which would be a run
    events = read(tmp_path)
    assert hparams(events) == settings
    assert scalars(events, "hparam/gospa") == [(9, 1.5)]
    assert set(events.Tags()["scalars"]) == {"a", "hparam/gospa"}
    # A column for what other runs of the same table may know.
    assert metric_columns(events) == {"hparam/gospa", "hparam/log_likelihood", "hparam/declared"}


def test_on_the_disk_after_a_flush(tmp_path):
    with EventReport(tmp_path, 0, LAYOUT) as report:
        report.add_scalar("a", 1.0, 0)
        report.flush()
        assert scalars(read(tmp_path), "a") == [(0, 1.0)]


def test_closing_twice_does_no_harm(tmp_path):
    report = EventReport(tmp_path, 0, LAYOUT)
    report.close()
    report.close()
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=f"cannot write {tmp_path}/file/tensorboard: "):
        EventReport(tmp_path / "file" / "tensorboard", 0, LAYOUT)


@pytest.mark.parametrize("call", ["add_scalar", "add_figure", "add_hparams", "flush", "close"])
def test_a_full_disk(tmp_path, figure, call):
    arguments = {
        "add_scalar": ("a", 1.0, 0),
        "add_figure": ("f", figure, 0),
        "add_hparams": ({"seed": 1}, {"gospa": 1.0}, 0),
    }
    with EventReport(tmp_path, 0, LAYOUT) as report:
        methods = ("add_scalar", "add_figure", "_get_file_writer", "flush", "close")
        full = OSError(errno.ENOSPC, "No space left on device")
        refuse = {name: mock.Mock(side_effect=full) for name in methods}
        with (
            mock.patch.multiple(SummaryWriter, **refuse),
            pytest.raises(StorageError, match=f"cannot write {tmp_path}: No space left on device"),
        ):
            getattr(report, call)(*arguments.get(call, ()))
