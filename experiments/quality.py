"""Score the tracker on a suite of scenarios: `python experiments/quality.py --help`."""

import sys

import hydra
from omegaconf import DictConfig

from torchdt.experiment.quality import run_quality


@hydra.main(config_path="pkg://torchdt.conf", config_name="quality", version_base="1.3")
def main(config: DictConfig) -> None:
    """Run the suite in Hydra's run directory; the exit status is 1 where a scenario failed."""
    if any(row.error for row in run_quality(config)):
        sys.exit(1)


if __name__ == "__main__":
    main()
