"""Measure time and memory beside plain implementations: `python experiments/benchmark.py --help`."""

import hydra
from omegaconf import DictConfig

from torchdt.experiment.benchmark import run_benchmark


@hydra.main(config_path="pkg://torchdt.conf", config_name="benchmark", version_base="1.3")
def main(config: DictConfig) -> None:
    """Run the benchmark in Hydra's run directory."""
    run_benchmark(config)


if __name__ == "__main__":
    main()
