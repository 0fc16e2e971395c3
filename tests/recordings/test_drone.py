import pytest
from oracles.recordings import real, tracked

pytestmark = pytest.mark.slow


def test_one_loudspeaker_around_a_turning_array(tmp_path):
    """The half of the recording on which nothing was chosen: 2.6 to 3.3 degrees, nothing reported is 15."""
    metrics, _ = tracked(tmp_path, "drone", real("drone/one_a.npz"), "data.first_step=36")
    assert metrics["gospa"]["mean"] < 4
    assert metrics["gospa"]["missed"] < 0.5
