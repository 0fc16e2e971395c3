"""Direct multiobject tracking in PyTorch, batched and differentiable.

The names below are the ones to start from. Each is imported when it is first used, so that `import torchdt`
takes no time; what else there is has its place in the packages.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
    from torchdt.core.errors import InputError
    from torchdt.core.random import RandomStreams
    from torchdt.data.npz import read_npz, write_npz
    from torchdt.data.recording import Recording
    from torchdt.field import BaseField, Field, LineArrayField, NormalModeField
    from torchdt.field.plane_wave import PlaneWaveField
    from torchdt.field.spherical_wave import SphericalWaveField
    from torchdt.filter.config import TrackerConfig
    from torchdt.filter.direct import DirectTracker
    from torchdt.filter.history import StepEstimate, TrackHistory
    from torchdt.filter.likelihood import log_likelihood
    from torchdt.filter.tracker import Tracker
    from torchdt.metrics import Gospa, TGospa, gospa, tgospa
    from torchdt.model.model import Model
    from torchdt.model.region import Coordinate, Region
    from torchdt.run.track import track

__version__ = "0.1.0"

__all__ = [
    "BaseField",
    "Coordinate",
    "DirectTracker",
    "Field",
    "Gospa",
    "InputError",
    "LineArrayField",
    "Model",
    "NormalModeField",
    "PlaneWaveField",
    "RandomStreams",
    "Recording",
    "Region",
    "SphericalWaveField",
    "StepEstimate",
    "TGospa",
    "TrackHistory",
    "Tracker",
    "TrackerConfig",
    "TwoStepConfig",
    "TwoStepTracker",
    "__version__",
    "gospa",
    "log_likelihood",
    "read_npz",
    "tgospa",
    "track",
    "write_npz",
]

_PLACES = {
    "baselines.two_step": ("TwoStepConfig", "TwoStepTracker"),
    "core.errors": ("InputError",),
    "core.random": ("RandomStreams",),
    "data.npz": ("read_npz", "write_npz"),
    "data.recording": ("Recording",),
    "field": ("BaseField", "Field", "LineArrayField", "NormalModeField"),
    "field.plane_wave": ("PlaneWaveField",),
    "field.spherical_wave": ("SphericalWaveField",),
    "filter.config": ("TrackerConfig",),
    "filter.direct": ("DirectTracker",),
    "filter.history": ("StepEstimate", "TrackHistory"),
    "filter.likelihood": ("log_likelihood",),
    "filter.tracker": ("Tracker",),
    "metrics": ("Gospa", "TGospa", "gospa", "tgospa"),
    "model.model": ("Model",),
    "model.region": ("Coordinate", "Region"),
    "run.track": ("track",),
}


def __getattr__(name: str) -> Any:
    """Import one of the names."""
    for place, names in _PLACES.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"torchdt.{place}"), name)
            return value
    raise AttributeError(f"module 'torchdt' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
