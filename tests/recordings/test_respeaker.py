import math

import pytest
from oracles.recordings import real, tracked

pytestmark = pytest.mark.slow
TRUTH = ((-0.17293168, -0.88965636), (0.17374023, 0.45260877))


def test_two_loudspeakers_at_once(tmp_path):
    """Both, and nothing else, in the last step; 3.5 and 3 degrees off at most in five runs."""
    _, rows = tracked(tmp_path, "respeaker", real("respeaker/two_static.npz"))
    last = [row for row in rows if row["step"] == "9"]
    assert len(last) == 2
    for east, north in TRUTH:
        assert min(apart(row, east, north) for row in last) < 8


def apart(row: dict[str, str], east: float, north: float) -> float:
    """Degrees from a direction above the horizon."""
    azimuth, elevation = (math.radians(float(row[key])) for key in ("azimuth_deg", "elevation_deg"))
    level = math.cos(elevation)
    own = (level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation))
    other = (east, north, math.sqrt(1 - east**2 - north**2))
    return math.degrees(math.acos(min(1.0, sum(a * b for a, b in zip(own, other, strict=True)))))
