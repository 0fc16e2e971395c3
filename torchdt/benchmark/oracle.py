"""Plain formulations of the same mathematics, to run beside torchdt."""

import importlib.util
from pathlib import Path
from types import ModuleType

import torchdt

ORACLES = Path(torchdt.__file__).parents[1] / "tests" / "oracles"
"""Where they are; part of a checkout, not of an installed copy."""


def load_oracle(path: Path) -> ModuleType | None:
    """The module of one file; None where this is no checkout."""
    if not path.exists():
        return None
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
