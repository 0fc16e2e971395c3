import io
import math

import torch
from rich.console import Console

from torchdt.app.report.tables import print_summary


def printed(*arguments, **options):
    console = Console(file=io.StringIO(), width=120)
    print_summary(console, *arguments, **options)
    return console.file.getvalue()


def cells(text, row):
    line = next(line for line in text.splitlines() if line.strip("│┃ ").startswith(row))
    return [cell.strip() for cell in line.strip("│ ").split("│")[1:]]


def numbers(text, row):
    return [float(cell) for cell in cells(text, row)]


def test_several_runs(history, score):
    text = printed(history, score, seconds=2.0, title="Two sources")
    assert "Two sources" in text
    for word in ("declared", "true", "GOSPA", "localisation", "missed", "false", "log-lik."):
        assert word in text
    assert numbers(text, "0") == [1.0, 1.5, 51.0, 1.0, 50.0, 0.0, -9.0]
    assert numbers(text, "1") == [1.17, 1.5, 67.67, 1.0, 50.0, 16.67, -15.0]
    assert numbers(text, "mean") == [1.08, 1.5, 59.33, 1.0, 50.0, 8.33, -12.0]
    assert "2 runs of 6 steps in 2.0 s: 6 steps/s" in text
    assert "broke down" not in text
    history.failed[1, 2:4] = True
    assert "6 steps/s; 2 broke down and count as missing" in printed(history, score, seconds=2.0)


def test_one_run_without_truth(history):
    one = history._make(field[:1] for field in history)
    text = printed(one, None, seconds=0.0)
    assert numbers(text, "0") == [1.0, -9.0]
    assert "GOSPA" not in text
    assert "mean" not in text
    assert "1 run of 6 steps" in text


def test_unknown_log_likelihood(history, score):
    """Of one run, and so of the mean; then of all."""
    evidence = history.log_evidence.clone()
    evidence[1, 3] = math.nan
    text = printed(history._replace(log_evidence=evidence), score, seconds=2.0)
    assert [cells(text, row)[-1] for row in ("0", "1", "mean")] == ["-9.0", "-", "-"]
    assert cells(text, "1")[:-1] == ["1.17", "1.50", "67.67", "1.00", "50.00", "16.67"]
    unknown = history._replace(log_evidence=torch.full_like(evidence, math.nan))
    assert "nan" not in printed(unknown, score, seconds=2.0)
