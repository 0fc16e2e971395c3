"""Tune a two-step tracker for the lowest GOSPA: `python experiments/tune_points.py --help`."""

from laboratory import job

main = job("tune_points", "studies")

if __name__ == "__main__":
    main()
