"""Track objects directly from array snapshots: `python experiments/track.py --help`."""

from laboratory import job

main = job("track")

if __name__ == "__main__":
    main()
