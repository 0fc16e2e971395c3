"""Score the tracker on a suite of scenarios: `python experiments/quality.py --help`."""

from laboratory import job

main = job("quality", "studies")

if __name__ == "__main__":
    main()
