import math

import pytest
from oracles.recordings import real, tracked

pytestmark = pytest.mark.slow
SKY = {
    "Cas A": (-0.314, 0.179),
    "Cyg A": (-0.757, 0.370),
    "Sun": (0.809, -0.111),
    "Cygnus X": (-0.743, 0.295),
}


def test_three_sources_in_one_covariance(tmp_path):
    """All three, and of the rest one at most that is not in the sky."""
    _, rows = tracked(tmp_path, "lofar", real("lofar/rs509.npz"))
    found = [(float(row["east_cos"]), float(row["north_cos"])) for row in rows]
    near = {name for name, place in SKY.items() if any(math.dist(place, one) < 0.02 for one in found)}
    assert near >= {"Cas A", "Cyg A", "Sun"}
    assert sum(all(math.dist(place, one) > 0.02 for place in SKY.values()) for one in found) <= 1
