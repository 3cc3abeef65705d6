"""truing: compare the measurements of a precision machine with its simulation and name the causes of the difference.

The names below are the public interface, in five groups. Each is imported from its module on first use, so that
`import truing` takes a few milliseconds.
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

# Public names by group and module; docs/reference/python/index.md describes each in one line.
_GROUPS: dict[str, dict[str, tuple[str, ...]]] = {
    "Poses and points": {
        "truing.estimation.rigid_poses.umeyama": ("umeyama",),
        "truing.estimation.rigid_poses.haralick": ("haralick",),
        "truing.estimation.rigid_poses.likelihood": ("maximum_likelihood",),
        "truing.estimation.rigid_poses.robust": ("consensus",),
        "truing.estimation.rigid_poses.robust_pose": ("robust_pose",),
        "truing.estimation.rigid_poses.rigid": ("RigidFit", "FitStatus"),
        "truing.estimation.rigid_poses.procrustes": ("generalised_procrustes", "ProcrustesFit"),
        "truing.estimation.rigid_poses.line_fit": ("fit_line", "LineFit"),
        "truing.estimation.labels.labelling": ("label_bodies", "label_points", "Labelling", "LabellingStatus"),
        "truing.estimation.scans.registration": ("register_scan", "refine_scan", "ScanFit", "ScanStatus"),
        "truing.estimation.rotation": ("exp_so3", "log_so3", "skew"),
    },
    "Mechanisms": {
        "truing.simulation.mechanisms.legs.closures": ("mechanism", "Legs", "Closure"),
        "truing.simulation.mechanisms.legs.kinematics": ("inverse", "forward"),
        "truing.simulation.mechanisms.structures.structure": ("Machine", "readings_at", "poses_at"),
        "truing.simulation.mechanisms.structures.catalogue": ("structures",),
    },
    "Sensors, loads and signals": {
        "truing.simulation.bench.six_upur.geometry": ("joint_centres", "JointCentres"),
        "truing.simulation.bench.six_upur.influence": ("influence_matrix", "merit"),
        "truing.simulation.bench.six_upur.stiffness": ("elastic_sensor", "ElasticSensor"),
        "truing.estimation.sensor.load_table": ("load_table", "LoadTable"),
        "truing.estimation.sensor.calibrate": ("fit_calibration",),
        "truing.estimation.sensor.calibration": ("Calibration", "CalibrationModel", "calibration_matrix", "wrenches"),
        "truing.estimation.response": ("fit_response", "ResponseFit"),
        "truing.estimation.interferometry.quadrature": (
            "fit_ellipse",
            "EllipseFit",
            "corrected_phase",
            "count_fringes",
            "length_from_phase",
        ),
        "truing.simulation.air": ("ciddor_index", "edlen_index"),
    },
    "Diagnosis and runs": {
        "truing.runs.recorded_run": ("load", "Run"),
        "truing.simulation.mechanisms.extended_model": ("read_model", "ExtendedModel", "predict_poses"),
        "truing.simulation.mechanisms.recording": ("Conditions",),
        "truing.simulation.bench.extended_model": ("read_sensor", "ExtendedSensor", "predict_readings"),
        "truing.simulation.mechanisms.forward_pass": ("simulate",),
        "truing.simulation.mechanisms.state": ("State",),
        "truing.simulation.cause": ("Step", "Cause", "Parameter"),
        "truing.simulation.mechanisms.point_causes": ("PointCause",),
    },
    "Calibration and design": {
        "truing.simulation.mechanisms.calibration_problem": ("CalibrationProblem",),
        "truing.simulation.mechanisms.parameters": ("ParameterSet", "report_set", "full_set"),
        "truing.estimation.errors_in_variables.fit": ("fit_errors_in_variables", "ErrorsInVariablesFit"),
        "truing.estimation.errors_in_variables.descent": ("Prior",),
        "truing.simulation.mechanisms.recalibration": ("recalibrate",),
        "truing.estimation.least_squares.solver": ("least_squares", "Solution", "SolverStatus"),
        "truing.estimation.design.observability": (
            "observe",
            "Observability",
            "choose_identifiable",
            "IdentifiableSet",
            "inseparable",
            "Inseparable",
        ),
        "truing.estimation.design.absorption": ("absorb", "Absorption"),
    },
}
_MODULES = {name: module for modules in _GROUPS.values() for module, names in modules.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, loaded or not."""
    return sorted({*globals(), *_MODULES})
