"""Compare estimators of the likelihood's gradient: `python experiments/gradients.py --help`."""

import hydra
from omegaconf import DictConfig

from torchdt.experiment.gradients import run_gradients


@hydra.main(config_path="pkg://torchdt.conf", config_name="gradients", version_base="1.3")
def main(config: DictConfig) -> None:
    """Run the comparison in Hydra's run directory."""
    run_gradients(config)


if __name__ == "__main__":
    main()
