"""Compare trackers on a suite of scenarios: `python experiments/compare.py --help`."""

from laboratory import job

main = job("compare")

if __name__ == "__main__":
    main()
