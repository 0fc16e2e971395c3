"""Compare estimators of the likelihood's gradient: `python experiments/gradients.py --help`."""

from torchdt.app.job import job

main = job("gradients")

if __name__ == "__main__":
    main()
