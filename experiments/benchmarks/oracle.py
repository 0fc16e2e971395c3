"""Plain formulations of the same mathematics, to run beside torchdt: those that the tests compare it with."""

import importlib.util
from pathlib import Path
from types import ModuleType

ORACLES = Path(__file__).parents[2] / "tests" / "oracles"


def load_oracle(name: str) -> ModuleType:
    """The module of that name."""
    spec = importlib.util.spec_from_file_location(name, ORACLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
