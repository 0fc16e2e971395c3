import math
import re

import pytest
from oracles.events import hparams, layout, metric_columns, read, scalars

from torchdt.app.report.tuning import LAYOUT, TuningReport
from torchdt.tuning.state import Record


def record(step, objective=-10.0, heldout=None):
    values = {"survival": 0.9 + step / 100, "driving_variance": [0.1, 0.2]}
    norms = {"survival": 2.0, "driving_variance": 0.5}
    return Record(step, values, objective, norms, heldout, skipped=0, passes=3 * step + 3)


def test_curves(tmp_path):
    with TuningReport(tmp_path) as report:
        report.add_record(record(0, heldout=-11.0))
        report.add_record(record(1, objective=None))
        report.add_record(record(2, objective=math.inf, heldout=-9.0))
        report.add_gospa(4.0, 2)
        report.add_gospa(None, 3)
    events = read(tmp_path)
    assert scalars(events, "tuning/objective") == [(0, -10.0)]
    assert scalars(events, "tuning/heldout") == [(0, -11.0), (2, -9.0)]
    assert scalars(events, "tuning/passes") == [(0, 3), (1, 6), (2, 9)]
    assert scalars(events, "value/survival") == [(k, pytest.approx(0.9 + k / 100)) for k in range(3)]
    assert scalars(events, "value/driving_variance_2") == [(k, pytest.approx(0.2)) for k in range(3)]
    assert scalars(events, "gradient_norm/survival") == [(0, 2), (1, 2), (2, 2)]
    assert scalars(events, "heldout_gospa/total") == [(2, 4.0)]


def test_charts_show_every_curve_but_the_counts(tmp_path):
    with TuningReport(tmp_path) as report:
        report.add_record(record(0, heldout=-11.0))
        report.add_gospa(4.0, 0)
    events = read(tmp_path)
    assert layout(events) == LAYOUT
    patterns = [pattern for tags in LAYOUT["Tuning"].values() for pattern in tags]
    for tag in set(events.Tags()["scalars"]) - {"tuning/passes", "tuning/skipped"}:
        assert sum(bool(re.match(pattern, tag)) for pattern in patterns) == 1, tag


def test_one_row(tmp_path):
    with TuningReport(tmp_path) as report:
        report.add_record(record(0, heldout=-11.0))
        report.add_hparams(
            {"survival": 0.95, "tracker": "direct"}, {"heldout": -11.0, "heldout_gospa": None}, 0
        )
    events = read(tmp_path)
    assert hparams(events) == {"survival": 0.95, "tracker": "direct"}
    assert metric_columns(events) == {"hparam/heldout", "hparam/heldout_gospa"}
    assert scalars(events, "hparam/heldout") == [(0, -11.0)]


def test_goes_on_at_a_step(tmp_path):
    for steps in (range(4), range(2, 5)):
        with TuningReport(tmp_path, steps[0]) as report:
            for step in steps:
                report.add_record(record(step, objective=float(steps[0])))
    assert scalars(read(tmp_path), "tuning/objective") == [(0, 0), (1, 0), (2, 2), (3, 2), (4, 2)]
