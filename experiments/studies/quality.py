"""How well one tracker does on a suite of scenarios: the comparison of a single one, with any seeds."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from torchdt.app.compare import run_suite
from torchdt.app.report.compare_tables import Comparison
from torchdt.app.report.console import plain_console
from torchdt.app.report.csv_file import write_table
from torchdt.app.report.files import write_json
from torchdt.app.report.scores import Quality
from torchdt.app.suite import SuiteSettings
from torchdt.core.ranges import Seed


@dataclass
class QualitySettings(SuiteSettings):
    """Settings of `experiments/quality.py`.

    Attributes:
        seeds: of the runs, which are tracked in one batch.
    """

    seeds: list[Seed] = dataclasses.field(default_factory=lambda: [0, 1, 2, 3, 4])

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_distinct("seeds")


ConfigStore.instance().store(name="quality_schema", node=QualitySettings)


TABLES = {
    "GOSPA": {
        "gospa": "mean",
        "gospa_ci": "± 95 %",
        "localisation": "local.",
        "missed": "missed",
        "false": "false",
        "gospa_all": "all steps",
        "gospa_hidden": "hidden",
    },
    "Tracks": {
        "count_error": "count error",
        "switches": "switches",
        "false_per_100": "false/100",
        "birth_delay": "birth delay",
        "drop_delay": "drop delay",
    },
    "Speed": {
        "runs": "runs",
        "steps_per_second": "steps/s",
        "real_time": "x real time",
        "seconds": "seconds",
    },
}


def run_quality(config: DictConfig) -> list[Comparison]:
    """Track and score every scenario, see `run_suite`; tables `quality.csv` and `quality.json`.

    Returns:
        One row per scenario. A scenario that fails leaves its error in its row, and the others go on.

    Raises:
        InputError, StorageError: see `run_suite`.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, QualitySettings)
    rows = run_suite(settings, {settings.name: []}, settings.seeds, write_rows)
    print_rows(plain_console(), rows)
    return rows


def write_rows(directory: Path, rows: Sequence[Quality]) -> None:
    """Replace `quality.csv` and `quality.json`."""
    names = [field.name for field in dataclasses.fields(Quality)]
    table = [{name: getattr(row, name) for name in names} for row in rows]
    write_json(directory / "quality.json", {"scenarios": table})
    write_table(directory / "quality.csv", table)


def print_rows(console: Console, rows: Sequence[Quality]) -> None:
    """Print the tables, then what failed."""
    for title, columns in TABLES.items():
        table = Table(title=title)
        table.add_column("scenario")
        for header in columns.values():
            table.add_column(header, justify="right")
        for row in rows:
            values = (getattr(row, name) for name in columns)
            table.add_row(row.scenario, *("-" if math.isnan(v) else f"{v:.3g}" for v in values))
        console.print(table)
    for row in rows:
        if row.error:
            console.print(f"{row.scenario} failed: {row.error}", style="bold red", markup=False)
