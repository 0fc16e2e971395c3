"""Track objects directly from array snapshots: `python experiments/track.py --help`."""

import hydra
from omegaconf import DictConfig

from torchdt.experiment.track import run_track


@hydra.main(config_path="pkg://torchdt.conf", config_name="track", version_base="1.3")
def main(config: DictConfig) -> float | None:
    """Run one job in Hydra's run directory and return the mean GOSPA."""
    return run_track(config)


if __name__ == "__main__":
    main()
