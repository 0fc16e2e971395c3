"""Compare estimators of the likelihood's gradient: `python experiments/gradients.py --help`."""

from laboratory import job

main = job("gradients", "studies")

if __name__ == "__main__":
    main()
