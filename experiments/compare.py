"""Compare trackers on a suite of scenarios: `python experiments/compare.py --help`."""

import sys

import hydra
from omegaconf import DictConfig

from torchdt.experiment.compare import run_compare


@hydra.main(config_path="pkg://torchdt.conf", config_name="compare", version_base="1.3")
def main(config: DictConfig) -> None:
    """Run the suite in Hydra's run directory; the exit status is 1 where something failed."""
    if any(row.error for row in run_compare(config)):
        sys.exit(1)


if __name__ == "__main__":
    main()
