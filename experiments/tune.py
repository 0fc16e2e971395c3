"""Tune hyperparameters of the tracker: `python experiments/tune.py --help`."""

from laboratory import job

main = job("tune")

if __name__ == "__main__":
    main()
