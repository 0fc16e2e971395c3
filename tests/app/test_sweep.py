"""The callback by itself; real sweeps are in test_launchers.py."""

import json
import math

import pytest
from hydra.core.utils import JobReturn, JobStatus
from hydra.types import RunMode
from omegaconf import OmegaConf
from oracles.processes import at_work
from oracles.storage import full_disk

from torchdt.app.claims import RUN
from torchdt.app.sweep import SweepReport
from torchdt.core.errors import StorageError
from torchdt.run.claim import InUseError, release_all


@pytest.fixture
def config(tmp_path):
    """Of job 3, as far as the callback reads it."""
    (tmp_path / "3").mkdir()
    hydra = {
        "mode": RunMode.MULTIRUN,
        "job": {"num": 3},
        "overrides": {"task": ["seed=3"]},
        "runtime": {"output_dir": str(tmp_path / "3")},
        "sweep": {"dir": str(tmp_path)},
    }
    return OmegaConf.create({"hydra": hydra})


@pytest.fixture
def report(config):
    report = SweepReport()
    report.on_multirun_start(config)
    report.on_job_start(config)
    yield report
    release_all()


def ended(status, value):
    job = JobReturn(status=status)
    job.return_value = value
    return job


def test_a_failed_job_counts_as_nan(report, config):
    job = ended(JobStatus.FAILED, ValueError("first line\nsecond line"))
    report.on_job_end(config, job)
    assert math.isnan(job.return_value)
    with pytest.raises(SystemExit, match="1"):
        report.on_multirun_end(config)


@pytest.mark.parametrize(("value", "kept"), [(2.5, 2.5), (None, None), ([1, 2], None), (math.nan, None)])
def test_a_completed_job_keeps_its_number(report, config, tmp_path, value, kept):
    job = ended(JobStatus.COMPLETED, value)
    report.on_job_end(config, job)
    assert job.return_value is value
    report.on_multirun_end(config)
    (found,) = json.loads((tmp_path / "sweep.json").read_text())["jobs"]
    assert (found["status"], found["result"]) == ("completed", kept)


def test_a_job_whose_process_ended_is_not_lost(report, config, tmp_path, caplog):
    with pytest.raises(SystemExit):
        report.on_multirun_end(config)
    assert "job 3 failed, seed=3: its process ended" in caplog.text
    assert json.loads((tmp_path / "sweep.json").read_text())["jobs"][0]["status"] == "running"


@pytest.mark.parametrize("status", [JobStatus.COMPLETED, JobStatus.FAILED])
def test_a_job_that_cannot_be_noted_is_an_error_of_the_sweep(report, config, status):
    job = ended(status, ValueError("wrong") if status is JobStatus.FAILED else 2.5)
    with full_disk():
        report.on_job_end(config, job)
    with pytest.raises(StorageError, match=r"cannot write .*/3/job\.json: No space left on device"):
        job.return_value  # noqa: B018


def test_a_sweep_that_cannot_be_noted_fails(report, config, caplog):
    report.on_job_end(config, ended(JobStatus.COMPLETED, 2.5))
    with full_disk(), pytest.raises(SystemExit, match="1"):
        report.on_multirun_end(config)
    assert "sweep.json: No space left on device" in caplog.text


def test_jobs_are_in_order(report, config, tmp_path):
    """Job 3 is there; launchers start the others when they like."""
    for number in (10, 2):
        config.hydra.job.num = number
        config.hydra.runtime.output_dir = str(tmp_path / str(number))
        (tmp_path / str(number)).mkdir()
        report.on_job_start(config)
    with pytest.raises(SystemExit):
        report.on_multirun_end(config)
    jobs = json.loads((tmp_path / "sweep.json").read_text())["jobs"]
    assert [job["number"] for job in jobs] == [2, 3, 10]


def test_a_single_run_keeps_its_error(config, tmp_path):
    config.hydra.mode = RunMode.RUN
    report, job = SweepReport(), ended(JobStatus.FAILED, ValueError("wrong"))
    report.on_job_start(config)
    report.on_job_end(config, job)
    with pytest.raises(ValueError, match="wrong"):
        job.return_value  # noqa: B018
    assert not (tmp_path / "3" / "job.json").exists()


def test_a_job_has_its_directory_from_its_start_to_its_end(report, config, tmp_path):
    assert (tmp_path / "3" / RUN).exists()
    report.on_job_end(config, ended(JobStatus.COMPLETED, 2.5))
    assert not (tmp_path / "3" / RUN).exists()


def test_the_note_of_another_process_stays(config, tmp_path):
    """The job that is refused is an error of its sweep: nobody counts it as done."""
    (tmp_path / "3" / "job.json").write_text("of another sweep")
    report, job = SweepReport(), ended(JobStatus.FAILED, ValueError("before it looked for its directory"))
    report.on_multirun_start(config)
    with at_work(tmp_path / "3", RUN):
        report.on_job_start(config)
        report.on_job_end(config, job)
    assert (tmp_path / "3" / "job.json").read_text() == "of another sweep"
    with pytest.raises(InUseError, match="process 1 of elsewhere at work there"):
        job.return_value  # noqa: B018
