"""What becomes of the jobs of a sweep: one that fails leaves the others alone, the end says which failed."""

import json
import logging
import math
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from torchdt.atomic import check_writable
from torchdt.endings import end, wants_traceback
from torchdt.errors import StorageError
from torchdt.experiment.quality import one_line
from torchdt.report.files import write_json

log = logging.getLogger(__name__)


class SweepReport(Callback):
    """Hydra's callback of all jobs. Of a single run it makes the directory alone, and its error is its own.

    Under `-m` each job keeps a `job.json` in its directory: `sweep` (its start), `number`, `overrides`,
    `status` (running, completed or failed), and from its end on `error` (one line or None), `seconds` and
    `result` (the number it returned, else None). One that fails logs its error and counts as NaN for the
    sweeper, so that the others go on. At the end `sweep.json` holds `failed`, the number of jobs that are not
    completed, and `jobs`, the content of `job.json` for each job in order; what failed is logged, and the
    exit status is 1.

    Launchers send the callback to the processes of the jobs, so that what it knows of the sweep goes with it.
    """

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the directory, of which Hydra would say in a traceback that it cannot be written.

        Raises:
            SystemExit: with status 1, where that is so.
        """
        _make(config.hydra.run.dir)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the directory, and note the start: it may hold jobs of an earlier sweep.

        Raises:
            SystemExit: with status 1, where the directory cannot be written.
        """
        _make(config.hydra.sweep.dir)
        self._sweep = datetime.now(UTC).isoformat()

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Leave a note that outlives the job's process."""
        if _is_sweep(config):
            self._start = time.perf_counter()
            self._write(config, status="running")

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Note what became of the job; a failed one returns NaN, one that cannot be noted an error."""
        if not _is_sweep(config):
            return
        result, error = job_return._return_value, None  # the property would raise the error
        if job_return.status is JobStatus.FAILED:
            log.error("job %d failed", config.hydra.job.num, exc_info=result)
            error = one_line(result)
            job_return.return_value, job_return.status = math.nan, JobStatus.COMPLETED
        try:
            self._write(
                config,
                status="failed" if error else "completed",
                error=error,
                seconds=time.perf_counter() - self._start,
                result=result if isinstance(result, int | float) else None,
            )
        except StorageError as unknown:  # to the end of the sweep; the sweeper raises it after the last job
            job_return.return_value, job_return.status = unknown, JobStatus.FAILED

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write `sweep.json` and name the jobs that failed.

        Raises:
            SystemExit: with status 1, where a job failed or `sweep.json` cannot be written.
        """
        directory = Path(config.hydra.sweep.dir)
        found = [json.loads(path.read_text()) for path in directory.rglob("job.json")]
        jobs = sorted((job for job in found if job["sweep"] == self._sweep), key=lambda job: job["number"])
        failed = [job for job in jobs if job["status"] != "completed"]
        for job in failed:
            error = job.get("error", "its process ended")
            log.error("job %d failed, %s: %s", job["number"], " ".join(job["overrides"]), error)
        log.info("%d of %d jobs completed, results in %s", len(jobs) - len(failed), len(jobs), directory)
        try:
            write_json(directory / "sweep.json", {"failed": len(failed), "jobs": jobs})
        except StorageError as error:  # of which Hydra would only warn
            log.error("%s", error)
            raise SystemExit(1) from error
        if failed:
            raise SystemExit(1)

    def _write(self, config: DictConfig, **content: object) -> None:
        job: Mapping[str, object] = {
            "sweep": self._sweep,
            "number": config.hydra.job.num,
            "overrides": list(config.hydra.overrides.task),
            **content,
        }
        write_json(Path(config.hydra.runtime.output_dir) / "job.json", job)


def _is_sweep(config: DictConfig) -> bool:
    return config.hydra.mode is RunMode.MULTIRUN


def _make(directory: str) -> None:
    try:
        check_writable(directory)
    except StorageError as error:
        if not wants_traceback():  # else it is Hydra's turn to find out
            end(1, error)
