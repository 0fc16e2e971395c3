"""Measures of how close estimates, and the tracks they form, are to the truth."""

from torchdt.metrics.delays import TrackDelays, track_delays
from torchdt.metrics.gospa import Gospa, gospa
from torchdt.metrics.tgospa import TGospa, tgospa, trajectories

__all__ = ["Gospa", "TGospa", "TrackDelays", "gospa", "tgospa", "track_delays", "trajectories"]
