"""Kinematics and calibrations of a robot arm by other libraries; each factory imports its library."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

Poses = Callable[[np.ndarray], np.ndarray]  # readings (B, n), rad -> targets (B, K, 3), m
Jacobian = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # readings -> tip (B, 3), m, and (B, 6, n)
_NOISE_M = 1e-5


@dataclass(frozen=True)
class Series:
    """Readings (B, n), rad, of joints, and measured places (B, K, 3), m, of targets on the tip; from one robot."""

    urdf: Path
    joints: Sequence[str]
    tip: str
    readings: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class Calibrated:
    """A calibrated arm: places of its targets at readings, and causes in words."""

    places: Poses
    says: str


def pinocchio_kinematics(series: Series) -> Jacobian:
    """Return pose by pose the tip and its Jacobian by pinocchio, in the axes of the base."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(series.urdf))
    data, tip = model.createData(), model.getFrameId(series.tip)
    order = [model.joints[model.getJointId(name)].idx_q for name in series.joints]

    def found(readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q = np.zeros((len(readings), model.nq))
        q[:, order] = readings
        places, slopes = np.empty((len(q), 3)), np.empty((len(q), 6, model.nv))
        for k in range(len(q)):
            pin.computeJointJacobians(model, data, q[k])
            pin.updateFramePlacement(model, data, tip)
            places[k] = data.oMf[tip].translation
            slopes[k] = pin.getFrameJacobian(model, data, tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        return places, slopes[:, :, order]

    return found


def figaroh_geometry(series: Series, folder: Path) -> Callable[[], Calibrated]:
    """Return figaroh's calibration of the geometry, by maximum a posteriori with its own expected sizes."""
    return _figaroh(series, folder, False)


def figaroh_elastic(series: Series, folder: Path) -> Callable[[], Calibrated]:
    """Return figaroh's calibration of the geometry with elastic joints.

    With six joints and an unknown base figaroh 1.0.2 overwrites the names of elastic joints by those of the base. The
    list here has the geometry that it selects by excitation, and the elastic joints.
    """
    return _figaroh(series, folder, True)


def _figaroh(series: Series, folder: Path, is_elastic: bool) -> Callable[[], Calibrated]:
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.robot import Robot

    count = series.points.shape[1]
    table, settings = folder / "figaroh.csv", folder / "figaroh.yaml"
    with table.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow([*(f"{axis}{k + 1}" for k in range(count) for axis in "xyz"), *series.joints])
        writer.writerows(np.column_stack([series.points.reshape(len(series.points), -1), series.readings]).tolist())
    estimation = {"method": "excitation" if is_elastic else "map", "noise_std": _NOISE_M}
    task = {
        "enabled": True,
        "type": "kinematic_calibration",
        "kinematics": {"base_frame": "universe", "tool_frame": series.tip},
        "parameters": {"calibration_level": "full_params", "estimation": estimation},
        "measurements": {
            "markers": [{"measurable_dof": [True] * 3 + [False] * 3} for _ in range(count)],
            "poses": {"base_pose": None, "tool_pose": None},
        },
        "data": {"source_file": str(table), "number_of_samples": len(series.readings)},
    }
    # JSON is YAML too, where a power of ten has a decimal point.
    text = json.dumps({"robot": {"name": "arm"}, "tasks": {"calibration": task}}).replace("1e-05", "1.0e-5")
    settings.write_text(text, encoding="utf-8")

    def solve() -> Calibrated:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            own = BaseCalibration(Robot(str(series.urdf), str(folder)), str(settings))
            config = own.calib_config
            config["known_baseframe"] = config["known_tipframe"] = False
            own.initialize()
            if is_elastic:
                axes = [own.model.joints[own.model.getJointId(name)].shortname()[-2:] for name in series.joints]
                config["non_geom"] = True
                soft = [f"k_{axis}_{name}" for axis, name in zip(axes, series.joints, strict=True)]
                config["param_name"] = [*config["param_name"], *soft]
            result = own.solve(enable_logging=False)
        values = dict(zip(config["param_name"], result.x, strict=True))
        # Its torque is what holds the arm, ours that of weight.
        text = [f"{name[5:]} {-1e6 * size:.2f}" for name, size in values.items() if name.startswith("k_")]

        def places(readings: np.ndarray) -> np.ndarray:
            config["NbSample"] = len(readings)
            found = calc_updated_fkm(own.model, own.data, result.x, readings, config)
            return np.asarray(found.reshape(count, 3, -1).transpose(2, 0, 1))

        return Calibrated(places, f"compliance, urad/(N m): {', '.join(text)}" if text else "")

    return solve


KINEMATICS: dict[str, Callable[[Series], Jacobian]] = {"pinocchio, pose by pose": pinocchio_kinematics}
CALIBRATIONS: dict[str, Callable[[Series, Path], Callable[[], Calibrated]]] = {
    "figaroh, geometry": figaroh_geometry,
    "figaroh, geometry and elastic joints": figaroh_elastic,
}
