"""Each room of the package imports from those below it alone, and the package from nothing around it."""

import ast
from pathlib import Path

import pytest

import torchdt

ROOT = Path(torchdt.__file__).parent
FLOORS = (
    {"core"},
    {"field"},
    {"model"},
    {"data", "simulation"},
    {"filter"},
    {"baselines", "calibration", "metrics", "run"},
    {"tuning"},
    {"app"},
)
LEVEL = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
ROOMS = sorted(LEVEL)


def imported(path: Path) -> set[str]:
    """Modules that a file imports, also where only type checkers look."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def test_the_floors_name_all_rooms():
    assert {path.name for path in ROOT.iterdir() if (path / "__init__.py").is_file()} == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_from_below(room):
    for path in (ROOT / room).rglob("*.py"):
        for module in imported(path):
            first, *rest = module.split(".")
            assert first not in ("oracles", "benchmarks", "recordings", "studies", "laboratory"), path
            if first == "torchdt" and rest and rest[0] in LEVEL and rest[0] != room:
                assert LEVEL[rest[0]] < LEVEL[room], f"{path}: {module}"
