"""Tune hyperparameters of the tracker: `python experiments/tune.py --help`."""

import hydra
from omegaconf import DictConfig

from torchdt.experiment.tune import run_tune


@hydra.main(config_path="pkg://torchdt.conf", config_name="tune", version_base="1.3")
def main(config: DictConfig) -> float | None:
    """Run one job in Hydra's run directory and return minus the held-out log-likelihood."""
    return run_tune(config)


if __name__ == "__main__":
    main()
