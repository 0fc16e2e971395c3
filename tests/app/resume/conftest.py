import dataclasses
import shutil

import pytest
from oracles.interrupted import ALONE, ALWAYS, stopped


@pytest.fixture(scope="session")
def start(launch):
    """Run in a directory; the last argument of a key counts."""

    def start(directory, *overrides, small=True):
        outcome = launch(ALWAYS, f"hydra.run.dir={directory}", *overrides, small=small)
        outcome.directory = directory
        return outcome

    return start


@pytest.fixture(scope="session")
def whole(start, tmp_path_factory):
    """A run that nothing interrupts; tests leave it as it is."""
    outcome = start(tmp_path_factory.mktemp("whole"), "runs=2", ALONE)
    assert outcome.status == 0, outcome.err
    return outcome


@pytest.fixture(scope="session")
def interrupted(start, tmp_path_factory):
    """The same, interrupted in its second sequence."""
    with stopped(1, 3):
        outcome = start(tmp_path_factory.mktemp("interrupted"), "runs=2", ALONE)
    assert outcome.status == 1
    assert "stopped" in outcome.err
    return outcome


@pytest.fixture
def half(interrupted, tmp_path):
    """An interrupted run to go on with."""
    return copy_of(interrupted, tmp_path)


@pytest.fixture
def finished(whole, tmp_path):
    """A finished run to spoil."""
    return copy_of(whole, tmp_path)


def copy_of(outcome, directory):
    shutil.copytree(outcome.directory, directory, dirs_exist_ok=True)
    return dataclasses.replace(outcome, directory=directory)
