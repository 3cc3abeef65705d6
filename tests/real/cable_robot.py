"""A suspended robot on four cables: its logs, and its calibration by errors in variables, for tests and a page."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.real.pulley_cable import PulleyCable
from truing.estimation.errors_in_variables.descent import Prior
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit, fit_errors_in_variables
from truing.estimation.rotation import exp_so3, left_jacobian_so3
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem, PoseEquations
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import upper_joints
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine

RUNS = (8, 27)
CABLES = 4
# One sigma each, as the authors declare them. Where the platform hangs is not measured: 10 m about a plan say nothing.
LENGTH_M, SWIVEL_RAD, ANGLE_RAD, PLAN_M = 0.01, np.radians(1.0), np.radians(2.0), 10.0
DRIVES = 3 * CABLES + 1  # values that are not joints: ratios, pulleys' zeros, yaw, lengths at homing


@dataclass(frozen=True)
class Run:
    """One run of B poses: what was measured in each, what the controller logged, and the authors' own answer.

    lengths (B, 4) m: corrected by the authors; raw (B, 4) m: as logged, since homing; swivel (B, 4) rad; angles (B, 3)
    rad, R = Rx Ry Rz; planned, solved (B, 6): poses before and after the authors' fit; first (6,): the first pose by
    lengths and inclinometer; gains (4,): corrected over logged length; frames (4, 3, 3): rows across, beside, axis.
    """

    legs: Legs
    frames: NDArray
    lengths: NDArray
    raw: NDArray
    swivel: NDArray
    angles: NDArray
    planned: NDArray
    solved: NDArray
    first: NDArray
    position_error: float
    gains: NDArray


def load(folder: Path, poses: int) -> Run:
    """Read one of the two runs."""
    w = _matlab(folder / f"ws_selfcalibration_{poses}_final.mat")
    pulleys, joints = w["s"].Trasmission.Pulley, w["s"].EndEffector.Platform.points
    frames = np.array([list(pulley.FixedFrame) for pulley in pulleys], float)
    entered = np.array([pulley.CableEnterPosition for pulley in pulleys])
    closure = PulleyCable(float(pulleys[0].r))
    legs = Legs(entered, np.array(list(joints)), frames[:, 2], np.zeros(CABLES), np.zeros(CABLES), closure)
    raw, gains = _logged(folder, poses, w["meas_idx"] - 1)
    return Run(
        legs,
        frames,
        w["cable_length_meas"].T,
        raw,
        w["swivel_meas"].T,
        w["epsilon_meas"].T,
        w["X_guess"].reshape(-1, 6),
        w["X_sol"].reshape(-1, 6),
        w["zeta_0_real"],
        float(w["InitialPositionErrorNorm"]),
        gains,
    )


def _matlab(path: Path) -> dict[str, Any]:
    import warnings

    from scipy.io import loadmat

    with warnings.catch_warnings():  # the solver's options, which nobody needs, are stored twice without a name
        warnings.simplefilter("ignore")
        return loadmat(path, squeeze_me=True, struct_as_record=False)


def _logged(folder: Path, poses: int, chosen: NDArray) -> tuple[NDArray, NDArray]:
    """Return the controller's lengths (B, 4) since homing at chosen samples, and the authors' corrections (4,)."""
    parsed = _matlab(folder / f"sc_{poses}_final_parsed.mat")["st"]
    with gzip.open(folder / f"sc_{poses}_final.log.gz", "rt", encoding="utf-8") as lines:
        drive = np.array([[float(x) for x in line.split(",")[1:8]] for line in lines if line.startswith("3,")])
    raw, gains = [], []
    for cable in range(CABLES):
        own = drive[drive[:, 1] == cable]
        length = np.interp(parsed.t, own[:, 0], own[:, 6])
        raw.append(length[chosen] - own[0, 6])
        gains.append(np.polyfit(length, parsed.cable_length[cable], 1)[0])
    return np.array(raw).T, np.array(gains)


def rotation(angles: NDArray) -> NDArray:
    """R (B, 3, 3) = Rx Ry Rz of angles (B, 3)."""
    first, second, third = (exp_so3(angles[:, [axis]] * np.eye(3)[axis]) for axis in range(3))
    return first @ second @ third


def turning(angles: NDArray) -> NDArray:
    """The rotation vectors (B, 3, 3), base frame, in columns, that a radian of each angle makes."""
    first, second = (exp_so3(angles[:, [axis]] * np.eye(3)[axis]) for axis in range(2))
    e = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    return np.concatenate([e[..., :1], first @ e[..., 1:2], first @ second @ e[..., 2:]], axis=-1)


def swivelled(legs: Legs, frames: NDArray, upper: NDArray) -> tuple[NDArray, NDArray]:
    """Angles (..., 4) of the pulleys about their axes, and their gradients (..., 4, 3) by the platform's joints."""
    h = upper - legs.a
    x, y = np.sum(h * frames[:, 0], -1), np.sum(h * frames[:, 1], -1)
    gradient = (x[..., None] * frames[:, 1] - y[..., None] * frames[:, 0]) / (x**2 + y**2)[..., None]
    return np.arctan2(y, x), gradient


@dataclass(frozen=True)
class CableProblem:
    """Values: ratio of each drive (4), zero of each pulley's angle (4), zero of the yaw, then the geometry.

    Deviations of a pose: twist of the platform off the planned place and the measured angles (6), cable lengths (4),
    pulley angles (4). Equations: closing of each cable (m), then of each pulley's angle (rad).
    """

    run: Run
    length: NDArray  # (B, 4) m, that the ratios multiply
    geometry: ParameterSet

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the values."""
        heads = [f"{name}{k + 1}" for name in ("ratio", "swivel") for k in range(CABLES)]
        return (*heads, "yaw", *self.geometry.labels)

    @property
    def units(self) -> NDArray:
        """SI value of one unit of the tables: 1, degrees, mm."""
        return np.concatenate([np.ones(CABLES), np.full(CABLES + 1, np.radians(1.0)), self.geometry.units])

    @property
    def machine(self) -> Machine:
        """The robot as its authors have it."""
        return Machine(self.run.legs, np.zeros((CABLES, CABLES)))

    @property
    def nominal(self) -> NDArray:
        """Ratios of one, no zeros, the geometry as it is."""
        return np.concatenate([np.ones(CABLES), np.zeros(CABLES + 1), self.geometry.values(self.machine)])

    @property
    def start(self) -> NDArray:
        """The same with lengths at homing that fit the plan of the first pose."""
        first = upper_joints(self.run.legs, self.run.planned[:1, :3], rotation(self.run.planned[:1, 3:]))
        values = self.nominal
        values[9:13] = self.run.legs.closure.invert(self.run.legs, first - self.run.legs.a)[0] - self.length[0]
        return values

    @property
    def covariance(self) -> NDArray:
        """Covariance (B, 14, 14) of what deviates."""
        E, out = turning(self.run.angles), np.zeros((len(self.length), 14, 14))
        out[:, range(3), range(3)] = PLAN_M**2
        out[:, 3:6, 3:6] = ANGLE_RAD**2 * E @ np.swapaxes(E, 1, 2)
        out[:, range(6, 10), range(6, 10)] = LENGTH_M**2
        out[:, range(10, 14), range(10, 14)] = SWIVEL_RAD**2
        return out

    def constrain(self, values: NDArray, deviation: NDArray) -> PoseEquations:
        """Equations (B, 8) and derivatives."""
        angles = self.run.angles + values[8] * np.eye(3)[2]
        cables = CalibrationProblem(
            KinematicModel("pulley-cable"),
            self.machine,
            self.geometry,
            self.run.planned[:, :3],
            rotation(angles),
            values[:4] * self.length,
        )
        lengths = cables.constrain(values[9:], deviation[:, :10])
        pulleys = self._pulleys(cables, values, deviation)
        none, one = np.zeros((len(angles), 4, 4)), np.broadcast_to(np.eye(4), (len(angles), 4, 4))
        by_deviation = np.block([[lengths.by_deviation, none], [pulleys.by_deviation, none, one]])
        by_ratio = np.concatenate([lengths.by_deviation[..., 6:] * self.length[:, None], none], 1)
        by_zero = np.concatenate([none, one], 1)
        theta = deviation[:, 3:6]
        about = np.linalg.solve(left_jacobian_so3(theta), exp_so3(theta) @ turning(angles)[..., 2:])
        by_yaw = by_deviation[..., 3:6] @ about
        by_geometry = np.concatenate([lengths.by_values, pulleys.by_values], 1)
        value = np.concatenate([lengths.value, pulleys.value], -1)
        return PoseEquations(value, by_deviation, np.concatenate([by_ratio, by_zero, by_yaw, by_geometry], -1))

    def _pulleys(self, cables: CalibrationProblem, values: NDArray, deviation: NDArray) -> PoseEquations:
        """Closing (B, 4) of the pulleys' angles, by deviations of the platform (B, 4, 6) and the geometry (B, 4, P)."""
        machine, theta = cables.machine(values[9:]), deviation[:, 3:6]
        p, R = cables.p + deviation[:, :3], exp_so3(theta) @ cables.R
        upper = upper_joints(machine.legs, p, R)
        turned, gradient = swivelled(machine.legs, self.run.frames, upper)
        change = self.geometry.change(machine)
        moved = R[:, None] @ change.get("b", (CABLES, 3)) - change.get("a", (CABLES, 3))
        by_twist = -np.concatenate([gradient, np.cross(upper - p[:, None], gradient)], -1)
        return PoseEquations(
            self.run.swivel + values[4:8] + deviation[:, 10:] - turned,
            np.concatenate([by_twist[..., :3], by_twist[..., 3:] @ left_jacobian_so3(theta)], -1),
            -np.einsum("bli,blip->blp", gradient, moved),
        )


def fit(problem: CableProblem, free: NDArray, values: NDArray, sigma: NDArray | None = None) -> ErrorsInVariablesFit:
    """Fit some of the values (P,), the others held; sigma (P,): prior about the present ones."""

    def constrain(some: NDArray, deviation: NDArray) -> PoseEquations:
        found = problem.constrain(filled(values, free, some), deviation)
        return PoseEquations(found.value, found.by_deviation, found.by_values[..., free])

    known = None if sigma is None else Prior(values[free], np.diag(sigma[free] ** -2.0))
    return fit_errors_in_variables(constrain, problem.covariance, values[free], known, robust=False)


def filled(values: NDArray, free: NDArray, some: NDArray) -> NDArray:
    """Values (P,) with some of them exchanged."""
    out = values.copy()
    out[free] = some
    return out


def geometry() -> ParameterSet:
    """Length at homing of every cable, place of its pulley and of its joint on the platform."""
    names = ("l", "a_x", "a_y", "a_z", "b_x", "b_y", "b_z")
    return ParameterSet(tuple(LegParameter(name, cable, "mm", 1e-3) for name in names for cable in range(CABLES)))
