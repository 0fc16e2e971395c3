"""Tune a two-step tracker for the lowest GOSPA: `python experiments/tune_points.py --help`."""

import hydra
from omegaconf import DictConfig

from torchdt.experiment.tune_points import run_tune_points


@hydra.main(config_path="pkg://torchdt.conf", config_name="tune_points", version_base="1.3")
def main(config: DictConfig) -> float:
    """Search in Hydra's run directory and return the lowest mean GOSPA."""
    return run_tune_points(config)


if __name__ == "__main__":
    main()
