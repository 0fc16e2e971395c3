"""How weak a source each tracker finds, and how fast: `python experiments/detection.py --help`."""

from laboratory import job

main = job("detection", "studies")

if __name__ == "__main__":
    main()
