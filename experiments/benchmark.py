"""Measure time and memory beside plain implementations: `python experiments/benchmark.py --help`."""

from torchdt.app.job import job

main = job("benchmark")

if __name__ == "__main__":
    main()
