"""Measures of how close a set of estimates is to the truth."""

from torchdt.metrics.gospa import Gospa, gospa

__all__ = ["Gospa", "gospa"]
