import pytest
from oracles.interrupted import ALONE, ALWAYS, stopped


@pytest.fixture(scope="module")
def start(launch):
    """Run in a directory; the last argument of a key counts."""

    def start(directory, *overrides, small=True):
        outcome = launch(ALWAYS, f"hydra.run.dir={directory}", *overrides, small=small)
        outcome.directory = directory
        return outcome

    return start


@pytest.fixture(scope="module")
def whole(start, tmp_path_factory):
    """A run that nothing interrupts."""
    outcome = start(tmp_path_factory.mktemp("whole"), "runs=2", ALONE)
    assert outcome.status == 0, outcome.err
    return outcome


@pytest.fixture
def half(start, tmp_path):
    """The same, interrupted in its second sequence."""
    with stopped(1, 3):
        outcome = start(tmp_path, "runs=2", ALONE)
    assert outcome.status == 1
    assert "stopped" in outcome.err
    return outcome
