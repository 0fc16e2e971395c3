"""Track satellites over a TART radio array: `python experiments/tart.py data.path=FILE`."""

from torchdt.app.job import job

main = job("tart")

if __name__ == "__main__":
    main()
