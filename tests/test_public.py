"""The names that `torchdt` itself gives."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import torchdt

SLOW = ("hydra", "matplotlib", "omegaconf", "optuna", "rich", "tensorboard")
USE_ALL = f"""
import sys, torchdt
assert "torch" not in sys.modules
values = [getattr(torchdt, name) for name in torchdt.__all__]
print([name for name in {SLOW} if name in sys.modules])
"""


def test_names_are_imported_when_used_and_bring_no_more_than_they_need():
    done = subprocess.run([sys.executable, "-c", USE_ALL], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_what_a_type_checker_sees_is_what_there_is():
    tree = ast.parse(Path(torchdt.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    given = {name: f"torchdt.{place}" for place, names in torchdt._PLACES.items() for name in names}
    assert seen == given
    assert {*torchdt.__all__} == {*given, "__version__"}
    assert set(torchdt.__all__) <= set(dir(torchdt))


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="module 'torchdt' has no attribute 'Nothing'"):
        _ = torchdt.Nothing
