"""Tune a two-step tracker for the lowest GOSPA: `python experiments/tune_points.py --help`."""

from torchdt.app.job import job

main = job("tune_points")

if __name__ == "__main__":
    main()
