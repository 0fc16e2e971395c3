"""Track satellites over a TART radio array: `python experiments/tart.py data.path=FILE`."""

import hydra
from omegaconf import DictConfig

from torchdt.experiment.tart import run_tart


@hydra.main(config_path="pkg://torchdt.conf", config_name="tart", version_base="1.3")
def main(config: DictConfig) -> None:
    """Run one job in Hydra's run directory."""
    run_tart(config)


if __name__ == "__main__":
    main()
