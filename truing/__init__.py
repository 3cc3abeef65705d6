"""truing: diagnose where a mechanism and its simulation part ways, from measured points and readings.

The names below are the public face. Each is imported from its room on first use, so that `import truing` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truing.estimation.haralick import haralick
    from truing.estimation.labelling import Labelling, LabellingStatus, label_bodies, label_points
    from truing.estimation.likelihood import maximum_likelihood
    from truing.estimation.line_fit import LineFit, fit_line
    from truing.estimation.procrustes import ProcrustesFit, generalised_procrustes
    from truing.estimation.registration import ScanFit, ScanStatus, refine_scan, register_scan
    from truing.estimation.response import ResponseFit, fit_response
    from truing.estimation.rigid import FitStatus, RigidFit, umeyama
    from truing.estimation.robust import consensus
    from truing.estimation.robust_pose import robust_pose
    from truing.estimation.rotation import exp_so3, log_so3, skew
    from truing.simulation.chain import Cause, Parameter, State, Step, simulate
    from truing.simulation.extended_model import ExtendedModel, predict_poses, read_model
    from truing.simulation.mechanisms import mechanism

__version__ = "0.1.0"

__all__ = [
    "Cause",
    "ExtendedModel",
    "FitStatus",
    "Labelling",
    "LabellingStatus",
    "LineFit",
    "Parameter",
    "ProcrustesFit",
    "ResponseFit",
    "RigidFit",
    "ScanFit",
    "ScanStatus",
    "State",
    "Step",
    "consensus",
    "exp_so3",
    "fit_line",
    "fit_response",
    "generalised_procrustes",
    "haralick",
    "label_bodies",
    "label_points",
    "log_so3",
    "maximum_likelihood",
    "mechanism",
    "predict_poses",
    "read_model",
    "refine_scan",
    "register_scan",
    "robust_pose",
    "simulate",
    "skew",
    "umeyama",
]

_ROOMS = {
    "truing.estimation.haralick": ("haralick",),
    "truing.estimation.labelling": ("Labelling", "LabellingStatus", "label_bodies", "label_points"),
    "truing.estimation.likelihood": ("maximum_likelihood",),
    "truing.estimation.line_fit": ("LineFit", "fit_line"),
    "truing.estimation.procrustes": ("ProcrustesFit", "generalised_procrustes"),
    "truing.estimation.registration": ("ScanFit", "ScanStatus", "refine_scan", "register_scan"),
    "truing.estimation.response": ("ResponseFit", "fit_response"),
    "truing.estimation.rigid": ("FitStatus", "RigidFit", "umeyama"),
    "truing.estimation.robust": ("consensus",),
    "truing.estimation.robust_pose": ("robust_pose",),
    "truing.estimation.rotation": ("exp_so3", "log_so3", "skew"),
    "truing.simulation.chain": ("Cause", "Parameter", "State", "Step", "simulate"),
    "truing.simulation.extended_model": ("ExtendedModel", "predict_poses", "read_model"),
    "truing.simulation.mechanisms": ("mechanism",),
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
