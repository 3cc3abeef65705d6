"""truing: diagnose where a mechanism and its simulation part ways, from measured points and readings.

The names below are the public face. Each is imported from its room on first use, so that `import truing` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truing.estimation.haralick import haralick
    from truing.estimation.labelling import label_points
    from truing.estimation.response import ResponseFit, fit_response
    from truing.estimation.rigid import FitStatus, RigidFit, umeyama
    from truing.estimation.rotation import exp_so3, log_so3, skew

__version__ = "0.1.0"

__all__ = [
    "FitStatus",
    "ResponseFit",
    "RigidFit",
    "exp_so3",
    "fit_response",
    "haralick",
    "label_points",
    "log_so3",
    "skew",
    "umeyama",
]

_ROOMS = {
    "truing.estimation.haralick": ("haralick",),
    "truing.estimation.labelling": ("label_points",),
    "truing.estimation.response": ("ResponseFit", "fit_response"),
    "truing.estimation.rigid": ("FitStatus", "RigidFit", "umeyama"),
    "truing.estimation.rotation": ("exp_so3", "log_so3", "skew"),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name from its room when it is first asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted({*globals(), *_HOME})
