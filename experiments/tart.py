"""Track satellites over a TART radio array: `python experiments/tart.py data.path=FILE`."""

from laboratory import job

main = job("tart", "recordings")

if __name__ == "__main__":
    main()
