"""Measure time and memory beside plain implementations: `python experiments/benchmark.py --help`."""

from laboratory import job

main = job("benchmark", "benchmarks")

if __name__ == "__main__":
    main()
