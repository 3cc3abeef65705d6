"""Conclusions of the telescope report that its own numbers contradict, computed from the inferred geometry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import best_shape
from docs.experiments.telescope_report_machine import MODEL, flexible, stand, with_deformation
from truing.calibration.needed_configurations import NeededConfigurations, needed_configurations
from truing.estimation.design.observability import indices, observe
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.actuator_errors import QUANTITIES, actuator_errors
from truing.simulation.mechanisms.legs.kinematics import forward, inverse, leg_vectors, reference_pose, unit
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.pose_regressors import Placed
from truing.simulation.mechanisms.structures.beam_model import BETA, circle_distance
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine
from truing.simulation.mechanisms.uniqueness import Flexures, PoseBox, UniquenessProof, prove_uniqueness

AXES = ("x", "y", "z", "theta_x", "theta_y")
# What Figure 13 maximises the determinant of: section 6.3.1.
SEVEN = {"a_x": "mm", "a_y": "mm", "b_x": "mm", "b_y": "mm", "u_x": "1", "u_y": "1", "l": "mm"}


@cache
def rigid() -> Machine:
    """Return the inferred machine, its platform rigid."""
    return with_deformation(best_shape().machine, np.zeros((6, 6)))


def travel(moved: NDArray) -> NDArray:
    """Return the displacements (B, 6), m, of the actuators for moves from home (B, 6), m and rad."""
    legs = rigid().legs
    home = reference_pose(legs)
    return inverse(legs, home.p + moved[:, :3], exp_so3(moved[:, 3:]) @ home.R) - legs.rho0


def _corners(count: int) -> NDArray:
    return np.array(list(product((-1.0, 1.0), repeat=count)))


def travel_of_axis(axis: int) -> float:
    """Return the travel, m, that half the stated width of one axis takes."""
    moved = np.zeros((2, 6))
    moved[:, axis] = _corners(1)[:, 0] * published().workspace[axis]
    return float(np.abs(travel(moved)).max())


def travel_of_tilt_and_lift() -> float:
    """Return the travel, m, of half a width of tilt in any direction with half a width of z, up or down."""
    angle = np.linspace(0.0, 2 * np.pi, 721)
    _, _, z, tilt, _ = published().workspace
    moved = np.zeros((2, len(angle), 6))
    moved[..., 2] = z * _corners(1)
    moved[..., 3], moved[..., 4] = tilt * np.cos(angle), tilt * np.sin(angle)
    return float(np.abs(travel(moved.reshape(-1, 6))).max())


def corners_of_workspace() -> NDArray:
    """Return the moves (32, 6) to the corners of Table 1's workspace, theta_z = 0."""
    return np.concatenate([_corners(5) * published().workspace, np.zeros((32, 1))], 1)


def travel_of_all() -> tuple[float, float]:
    """Return the travel, m, to the worst corner of the workspace: with theta_z = 0, and with the best theta_z."""
    moved = np.repeat(corners_of_workspace()[:, None], 401, 1)
    moved[..., 5] = np.radians(np.linspace(-2.0, 2.0, 401))
    worst = np.abs(travel(moved.reshape(-1, 6))).reshape(32, 401, 6).max(-1)
    return float(worst[:, 200].max()), float(worst.min(1).max())


def reach_of_axis(axis: int) -> float:
    """Return the motion, m or rad, of one axis alone that takes the actuators' half range."""
    from scipy.optimize import brentq

    half_range = 1e-3 * published().stated["actuator_half_range"]

    def excess(far: float) -> float:
        moved = np.zeros((2, 6))
        moved[:, axis] = far, -far
        return float(np.abs(travel(moved)).max() - half_range)

    return float(brentq(excess, 0.0, 0.1 if axis > 2 else 10e-3))


@dataclass(frozen=True)
class Excursion:
    """Range of platform and joints over a set of configurations, m and rad, and the number within the workspace."""

    position: NDArray  # (3,)
    angle: NDArray  # (3,) rotation vector
    leg: float
    upper_flexure: float
    inside: int
    tilt_inside: int


def excursion(p: NDArray, R: NDArray, rho: NDArray) -> Excursion:
    """Return the extremes over poses p (B, 3), R (B, 3, 3) with readings rho (B, 6)."""
    legs = rigid().legs
    home = reference_pose(legs)
    z = unit(leg_vectors(legs, p, R, rho))
    moved, angle = np.abs(p - home.p), np.abs(log_so3(R @ np.swapaxes(home.R, -1, -2)))
    leg = _between(z, home.z)
    upper = _between(z, home.z @ np.swapaxes(R, -1, -2))
    within = np.concatenate([moved, angle[:, :2]], 1) <= published().workspace * (1 + 1e-9)
    tilt = int(np.sum(within[:, 3:].all(1)))
    counts = int(np.sum(within.all(1))), tilt
    return Excursion(moved.max(0), angle.max(0), float(leg.max()), float(upper.max()), *counts)


def _between(one: NDArray, other: NDArray) -> NDArray:
    """Return the angles between unit vectors, exact for small ones."""
    return 2 * np.arcsin(np.linalg.norm(one - other, axis=-1) / 2)


def excursion_of_table(number: int) -> Excursion:
    """Return the excursion of the configurations of Table 3 or 4."""
    tables = {3: published().calibration, 4: published().verification}
    at = stand(rigid(), tables[number])
    return excursion(at.p, at.R, at.rho)


def excursion_of_workspace() -> Excursion:
    """Return the excursion of the corners of Table 1's workspace."""
    legs, moved = rigid().legs, corners_of_workspace()
    home = reference_pose(legs)
    return excursion(home.p + moved[:, :3], exp_so3(moved[:, 3:]) @ home.R, legs.rho0 + travel(moved))


def longest_flexure(angle: float) -> float:
    """Return the length, m, up to which a flexure bent by an angle changes a leg by less than the report's bound."""
    change = float(circle_distance(np.array(1.0), np.cos(angle)).value) - 0.5
    return 1e-6 * published().stated["parasitic_variation_bound"] / change


@dataclass(frozen=True)
class Sensitivity:
    """The worst that actuators off by their accuracy do, over the workspace's corners and its centre: m, rad."""

    position: float
    tilt: float  # about x or y
    turn: float  # about z


def sensitivity() -> Sensitivity:
    """Return the worst pose error, over all signs of the actuators' errors, at home and at the workspace's corners."""
    legs = rigid().legs
    home = reference_pose(legs)
    moved = np.concatenate([np.zeros((1, 6)), corners_of_workspace()])
    p, R = home.p + moved[:, :3], exp_so3(moved[:, 3:]) @ home.R
    placed = Placed(p, R, legs.rho0 + travel(moved))
    accuracy = np.full(6, 1e-6 * published().stated["actuator_accuracy"])
    found = actuator_errors(KinematicModel("6-pus"), rigid(), placed, accuracy).worst.max(0)
    worst = dict(zip(QUANTITIES, found.tolist(), strict=True))
    return Sensitivity(worst["position"], max(worst["rx"], worst["ry"]), worst["rz"])


def uniqueness() -> tuple[UniquenessProof, UniquenessProof]:
    """Return the interval proofs of uniqueness over the workspace, for rigid legs and for flexures.

    The rotation about z is bounded by the reach of the actuators.
    """
    machine = flexible(rigid())
    home = reference_pose(machine.legs)
    half = np.append(published().workspace, reach_of_axis(5))
    readings = np.full(6, 1e-3 * published().stated["actuator_half_range"])
    box = PoseBox(home.p[0], home.R[0], half[:3], half[3:], readings)
    assert machine.flexure_length is not None
    flexures = Flexures(machine.flexure_length, np.full(6, BETA))
    return prove_uniqueness(machine.legs, box), prove_uniqueness(machine.legs, box, flexures)


def configurations_needed() -> list[NeededConfigurations]:
    """Return the least number of configurations that determine each model's separable parameters.

    Separable parameters are those that poses at the ends of the actuators' range and within it determine.
    """
    machine = flexible(rigid())
    legs, half = machine.legs, 1e-3 * published().stated["actuator_half_range"]
    inside = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 6))
    rho = legs.rho0 + half * np.concatenate([_corners(6), inside])
    reached = forward(legs, rho)
    placed = Placed(reached.p, reached.R, rho)
    found = [needed_configurations(structure, machine, placed) for structure in structures(machine)]
    return [one for one in found if one is not None]


@cache
def _seven() -> ParameterSet:
    scale = {"mm": 1e-3, "1": 1.0}
    return ParameterSet(
        tuple(LegParameter(name, leg, unit, scale[unit]) for leg in range(6) for name, unit in SEVEN.items())
    )


def log_determinant(displacement: NDArray) -> float:
    """Return log det J'J of seven parameters per leg, mm, at displacements (N, 6), m: the report's O1."""
    machine, at = rigid(), stand(rigid(), displacement)
    rows = MODEL.close(machine, at.p, at.R, at.rho, _seven().change(machine)).by_parameter
    own = np.einsum("niiq->inq", rows.reshape(len(at.rho), 6, 6, 7)) * _seven().units[:7]
    labels = tuple(SEVEN)
    return sum(indices(observe(leg * 1e3, np.ones(7), labels).singular_values, len(leg)).log_determinant for leg in own)


@dataclass(frozen=True)
class Choices:
    """Log determinants of Table 3 and of random sets of as many configurations."""

    table: float
    corners: NDArray  # (draws,) all six actuators at one end or the other
    levels: NDArray  # -1, 0 or 1, as Table 3
    uniform: NDArray  # anywhere in the actuators' range


def choices(draws: int = 150) -> Choices:
    """Return the log determinants of Table 3 and of random sets, which are the same on every call."""
    rng = np.random.default_rng(3)
    table = published().calibration
    reach = 1e-3 * published().stated["actuator_half_range"]

    def drawn(level: NDArray) -> NDArray:
        return np.array([log_determinant(reach * one) for one in level])

    shape = (draws, *table.shape)
    return Choices(
        log_determinant(table),
        drawn(rng.choice([-1.0, 1.0], shape)),
        drawn(rng.choice([-1.0, 0.0, 1.0], shape)),
        drawn(rng.uniform(-1.0, 1.0, shape)),
    )


@dataclass(frozen=True)
class Deformation:
    """Values of kappa and of the shifts by eq. 4."""

    kappa_by_regression: float  # of K drho on drho alone, all legs
    kappa_by_calibration: float  # mean of the simulated Table 6a
    largest_shift: float  # m, over Table 3
    row_sum: float
    rigid_share: float  # of K's squares: heave, tip and tilt of the six attachments


def deformation(kappa_by_calibration: float) -> Deformation:
    """Return kappa and the attachments' shifts by the printed K at the printed configurations."""
    K, moves, b = published().K, published().calibration, rigid().legs.b
    shift = moves @ K.T
    plane = np.linalg.qr(np.stack([np.ones(6), b[:, 0], b[:, 1]], 1))[0]
    return Deformation(
        float(np.mean(np.sum(shift * moves, 0) / np.sum(moves**2, 0))),
        kappa_by_calibration,
        float(np.abs(shift).max()),
        float(np.abs(K.sum(1)).max()),
        float(np.sum((plane.T @ K) ** 2) / np.sum(K**2)),
    )


def distance_from_nominal(table: str) -> float:
    """Return the rms of a table over a_x a_y b_x b_y, mm."""
    rows = published().tables[table]
    return float(np.sqrt(np.mean([rows[name] ** 2 for name in ("a_x", "a_y", "b_x", "b_y")])))


def pairs_on_base(table: str) -> NDArray:
    """Return the decreases from nominal, mm, of the distances of the close pairs on the base, (2, 3) (4, 5) (6, 1)."""
    a, rows = rigid().legs.a[:, :2], published().tables[table]
    found = a * 1e3 + np.stack([rows["a_x"], rows["a_y"]], 1)
    first, second = np.array([1, 3, 5]), np.array([2, 4, 0])
    return np.linalg.norm((a[first] - a[second]) * 1e3, axis=1) - np.linalg.norm(found[first] - found[second], axis=1)
