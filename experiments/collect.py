"""Many runs in one table and one figure: `python experiments/collect.py DIR --figure=runs.png`."""

from torchdt.app.collect import main

if __name__ == "__main__":
    main()
