"""Score the tracker on a suite of scenarios: `python experiments/quality.py --help`."""

from torchdt.app.job import job

main = job("quality")

if __name__ == "__main__":
    main()
