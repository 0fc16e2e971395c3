"""Beliefs about objects close together against exact ones: `python experiments/neighbours.py --help`.

Random scenes of two and three objects, summed over everything that may be there; a table for each method, by
separation and by level.
"""

import argparse
from collections.abc import Callable

import torch
from rich.table import Table

from studies.neighbours import Errors, Scene, all_errors, draw_scene, summary
from torchdt.app.report.console import plain_console

COLUMNS = ("scenes", "mean error", "rms", "wrong side", "states", "evidence", "rms")
GROUPS: dict[str, Callable[[Scene], bool]] = {
    "all": lambda scene: True,
    "0 to 5 degrees": lambda scene: scene.separation < 5,
    "5 to 10 degrees": lambda scene: 5 <= scene.separation < 10,
    "10 to 15 degrees": lambda scene: scene.separation >= 10,
    "0 to -8 dB": lambda scene: scene.level > -8,
    "-8 to -16 dB": lambda scene: -16 < scene.level <= -8,
    "-16 to -25 dB": lambda scene: scene.level <= -16,
}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    given = parser.parse_args()
    torch.set_num_threads(1)
    scenes = [draw_scene(given.seed + b) for b in range(given.scenes)]
    found: list[dict[str, Errors]] = [all_errors(s, given.seed + b) for b, s in enumerate(scenes)]
    table = Table("method", "", *COLUMNS, title="Existence, states and evidence, less those of enumeration")
    for method in found[0]:
        for name, belongs in GROUPS.items():
            rows = [f[method] for f, scene in zip(found, scenes, strict=True) if belongs(scene)]
            if rows:
                table.add_row(method, name, str(len(rows)), *(f"{x:.3f}" for x in summary(rows)))
    plain_console().print(table)


if __name__ == "__main__":
    main()
