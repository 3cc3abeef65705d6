"""truing: diagnose where a mechanism and its simulation part ways, from measured points and readings.

The names below are the public face. Each is imported from its room on first use, so that `import truing` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truing.estimation.design.absorption import Absorption, absorb
    from truing.estimation.design.observability import (
        IdentifiableSet,
        Inseparable,
        Observability,
        choose_identifiable,
        inseparable,
        observe,
    )
    from truing.estimation.errors_in_variables.descent import Prior
    from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit, fit_errors_in_variables
    from truing.estimation.interferometry.quadrature import (
        EllipseFit,
        corrected_phase,
        count_fringes,
        fit_ellipse,
        length_from_phase,
    )
    from truing.estimation.labels.labelling import Labelling, LabellingStatus, label_bodies, label_points
    from truing.estimation.least_squares.solver import Solution, SolverStatus, least_squares
    from truing.estimation.response import ResponseFit, fit_response
    from truing.estimation.rigid_poses.haralick import haralick
    from truing.estimation.rigid_poses.likelihood import maximum_likelihood
    from truing.estimation.rigid_poses.line_fit import LineFit, fit_line
    from truing.estimation.rigid_poses.procrustes import ProcrustesFit, generalised_procrustes
    from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
    from truing.estimation.rigid_poses.robust import consensus
    from truing.estimation.rigid_poses.robust_pose import robust_pose
    from truing.estimation.rigid_poses.umeyama import umeyama
    from truing.estimation.rotation import exp_so3, log_so3, skew
    from truing.estimation.scans.registration import ScanFit, ScanStatus, refine_scan, register_scan
    from truing.estimation.sensor.calibrate import fit_calibration
    from truing.estimation.sensor.calibration import Calibration, CalibrationModel, calibration_matrix, wrenches
    from truing.estimation.sensor.load_table import LoadTable, load_table
    from truing.runs.recorded_run import Run, load
    from truing.simulation.air import ciddor_index, edlen_index
    from truing.simulation.bench.extended_model import ExtendedSensor, predict_readings, read_sensor
    from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres
    from truing.simulation.bench.six_upur.influence import influence_matrix, merit
    from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor
    from truing.simulation.cause import Cause, Parameter, Step
    from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
    from truing.simulation.mechanisms.extended_model import ExtendedModel, predict_poses, read_model
    from truing.simulation.mechanisms.forward_pass import simulate
    from truing.simulation.mechanisms.legs.closures import Closure, Legs, mechanism
    from truing.simulation.mechanisms.legs.kinematics import forward, inverse
    from truing.simulation.mechanisms.parameters import ParameterSet, full_set, report_set
    from truing.simulation.mechanisms.point_causes import PointCause
    from truing.simulation.mechanisms.recalibration import recalibrate
    from truing.simulation.mechanisms.recording import Conditions
    from truing.simulation.mechanisms.state import State
    from truing.simulation.mechanisms.structures.catalogue import structures
    from truing.simulation.mechanisms.structures.structure import Machine, poses_at, readings_at

__version__ = "0.1.0"

__all__ = [
    "Absorption",
    "Calibration",
    "CalibrationModel",
    "CalibrationProblem",
    "Cause",
    "Closure",
    "Conditions",
    "ElasticSensor",
    "EllipseFit",
    "ErrorsInVariablesFit",
    "ExtendedModel",
    "ExtendedSensor",
    "FitStatus",
    "IdentifiableSet",
    "Inseparable",
    "JointCentres",
    "Labelling",
    "LabellingStatus",
    "Legs",
    "LineFit",
    "LoadTable",
    "Machine",
    "Observability",
    "Parameter",
    "ParameterSet",
    "PointCause",
    "Prior",
    "ProcrustesFit",
    "ResponseFit",
    "RigidFit",
    "Run",
    "ScanFit",
    "ScanStatus",
    "Solution",
    "SolverStatus",
    "State",
    "Step",
    "absorb",
    "calibration_matrix",
    "choose_identifiable",
    "ciddor_index",
    "consensus",
    "corrected_phase",
    "count_fringes",
    "edlen_index",
    "elastic_sensor",
    "exp_so3",
    "fit_calibration",
    "fit_ellipse",
    "fit_errors_in_variables",
    "fit_line",
    "fit_response",
    "forward",
    "full_set",
    "generalised_procrustes",
    "haralick",
    "influence_matrix",
    "inseparable",
    "inverse",
    "joint_centres",
    "label_bodies",
    "label_points",
    "least_squares",
    "length_from_phase",
    "load",
    "load_table",
    "log_so3",
    "maximum_likelihood",
    "mechanism",
    "merit",
    "observe",
    "poses_at",
    "predict_poses",
    "predict_readings",
    "read_model",
    "read_sensor",
    "readings_at",
    "recalibrate",
    "refine_scan",
    "register_scan",
    "report_set",
    "robust_pose",
    "simulate",
    "skew",
    "structures",
    "umeyama",
    "wrenches",
]

_ROOMS = {
    "truing.estimation.design.absorption": ("Absorption", "absorb"),
    "truing.estimation.design.observability": (
        *("IdentifiableSet", "Inseparable", "Observability"),
        *("choose_identifiable", "inseparable", "observe"),
    ),
    "truing.estimation.errors_in_variables.descent": ("Prior",),
    "truing.estimation.errors_in_variables.fit": ("ErrorsInVariablesFit", "fit_errors_in_variables"),
    "truing.estimation.interferometry.quadrature": (
        *("EllipseFit", "corrected_phase", "count_fringes"),
        *("fit_ellipse", "length_from_phase"),
    ),
    "truing.estimation.labels.labelling": ("Labelling", "LabellingStatus", "label_bodies", "label_points"),
    "truing.estimation.least_squares.solver": ("Solution", "SolverStatus", "least_squares"),
    "truing.estimation.response": ("ResponseFit", "fit_response"),
    "truing.estimation.rigid_poses.haralick": ("haralick",),
    "truing.estimation.rigid_poses.likelihood": ("maximum_likelihood",),
    "truing.estimation.rigid_poses.line_fit": ("LineFit", "fit_line"),
    "truing.estimation.rigid_poses.procrustes": ("ProcrustesFit", "generalised_procrustes"),
    "truing.estimation.rigid_poses.rigid": ("FitStatus", "RigidFit"),
    "truing.estimation.rigid_poses.robust": ("consensus",),
    "truing.estimation.rigid_poses.robust_pose": ("robust_pose",),
    "truing.estimation.rigid_poses.umeyama": ("umeyama",),
    "truing.estimation.rotation": ("exp_so3", "log_so3", "skew"),
    "truing.estimation.scans.registration": ("ScanFit", "ScanStatus", "refine_scan", "register_scan"),
    "truing.estimation.sensor.calibrate": ("fit_calibration",),
    "truing.estimation.sensor.calibration": ("Calibration", "CalibrationModel", "calibration_matrix", "wrenches"),
    "truing.estimation.sensor.load_table": ("LoadTable", "load_table"),
    "truing.runs.recorded_run": ("Run", "load"),
    "truing.simulation.air": ("ciddor_index", "edlen_index"),
    "truing.simulation.mechanisms.calibration_problem": ("CalibrationProblem",),
    "truing.simulation.cause": ("Cause", "Parameter", "Step"),
    "truing.simulation.mechanisms.point_causes": ("PointCause",),
    "truing.simulation.mechanisms.forward_pass": ("simulate",),
    "truing.simulation.mechanisms.state": ("State",),
    "truing.simulation.mechanisms.extended_model": ("ExtendedModel", "predict_poses", "read_model"),
    "truing.simulation.bench.extended_model": ("ExtendedSensor", "predict_readings", "read_sensor"),
    "truing.simulation.mechanisms.legs.kinematics": ("forward", "inverse"),
    "truing.simulation.mechanisms.legs.closures": ("Closure", "Legs", "mechanism"),
    "truing.simulation.mechanisms.parameters": ("ParameterSet", "full_set", "report_set"),
    "truing.simulation.mechanisms.recalibration": ("recalibrate",),
    "truing.simulation.bench.six_upur.geometry": ("JointCentres", "joint_centres"),
    "truing.simulation.bench.six_upur.influence": ("influence_matrix", "merit"),
    "truing.simulation.bench.six_upur.stiffness": ("ElasticSensor", "elastic_sensor"),
    "truing.simulation.mechanisms.structures.structure": ("Machine", "poses_at", "readings_at"),
    "truing.simulation.mechanisms.structures.catalogue": ("structures",),
    "truing.simulation.mechanisms.recording": ("Conditions",),
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
