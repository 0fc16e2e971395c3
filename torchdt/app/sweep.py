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

from torchdt.app.claims import claim_run, release_run
from torchdt.app.report.files import write_json
from torchdt.core.errors import StorageError, one_line
from torchdt.run.claim import InUseError

log = logging.getLogger(__name__)


class SweepReport(Callback):
    """Hydra's callback of all jobs. A single run it leaves alone: that fails with its own error.

    Under `-m` each job keeps a `job.json` in its directory: `sweep` (its start), `number`, `overrides`,
    `status` (running, completed or failed), and from its end on `error` (one line or None), `seconds` and
    `result` (the number it returned, else None). One that fails logs its error and counts as NaN for the
    sweeper, so that the others go on. At the end `sweep.json` holds `failed`, the number of jobs that are not
    completed, and `jobs`, the content of `job.json` for each job in order; what failed is logged, and the
    exit status is 1.

    A job has its directory to itself from its start to its end. One that finds another process at work there
    writes nothing and is an error of the sweep, which the sweeper raises after the last job.

    Launchers send the callback to the processes of the jobs, so that what it knows of the sweep goes with it.
    """

    _refused: InUseError | None = None

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the start: the directory may hold jobs of an earlier sweep."""
        self._sweep = datetime.now(UTC).isoformat()

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Leave a note that outlives the job's process."""
        if _is_sweep(config):
            self._start = time.perf_counter()
            try:
                claim_run(config.hydra.runtime.output_dir)
                self._refused = None
                self._write(config, status="running")
            except InUseError as error:  # of which Hydra would only warn
                self._refused = error

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Note what became of the job; a failed one returns NaN, one that cannot be noted an error."""
        if not _is_sweep(config):
            return
        if self._refused is not None:
            job_return.return_value, job_return.status = self._refused, JobStatus.FAILED
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
        release_run(config.hydra.runtime.output_dir)

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
