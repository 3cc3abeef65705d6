"""Shifts of the telescope's parameters that remain when K is known (Table 7a), and causes that explain them.

Parameters of a leg stand in the order a_x a_y b_x b_y kappa l, in mm and 1e-3. What frames of base and platform the
nominal values refer to is nobody's fault and is fitted first; every other pattern is one candidate cause.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_absorption import leg_fits, shift_by_K
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import best_shape, sigma_of_K
from docs.experiments.telescope_report_machine import MODEL, Stand, flexible, stand, with_deformation
from truing.estimation.rotation import log_so3
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.structures.beam_model import BeamModel
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel
from truing.simulation.mechanisms.structures.stiffness_model import StiffnessModel
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, Structure, poses_at

ROWS = ("a_x", "a_y", "b_x", "b_y", "kappa", "l")
_SHOWN = np.array([1e3] * 6)  # mm of a m, and 1e-3
Pattern = Callable[[], NDArray]


def remainder(table: str = "7a") -> NDArray:
    """Return Table 7 as (6 rows, 6 legs), mm and 1e-3."""
    rows = published().tables[table]
    return np.array([rows[name] * (1e3 if name == "kappa" else 1.0) for name in ROWS])


@dataclass(frozen=True)
class Ignorance:
    """Sources of scatter of Table 7 without any cause, one sigma each."""

    tolerance_mm: float  # of a, b and l
    residual_mm: float = 0.005  # what the report's fits leave, its section 3.3
    K: float | None = None  # error of each entry of K; by default what the geometry's misfit says

    def covariance(self) -> NDArray:
        """Return the covariance of a leg's six parameters (6 legs, 6, 6), mm and 1e-3."""
        fits = leg_fits(best_shape().machine, "6a")
        normal = np.swapaxes(fits.jacobian, -1, -2) @ fits.jacobian
        noise = (1e-3 * self.residual_mm) ** 2 * np.linalg.inv(normal)
        by_K = (sigma_of_K() if self.K is None else self.K) * shift_by_K(best_shape().machine, "6a")
        total = (noise + by_K @ np.swapaxes(by_K, -1, -2)) * np.outer(_SHOWN, _SHOWN)
        return total + np.diag([self.tolerance_mm**2 * (name != "kappa") for name in ROWS])


@cache
def _at() -> Stand:
    return stand(best_shape().machine)


def _machine() -> Machine:
    """Return the machine as Table 7 has it, K known."""
    return best_shape().machine


def absorbed(effect: NDArray) -> NDArray:
    """Return the bias of the fit (6 rows, 6 legs), mm and 1e-3, by a closing (40, 6), m, that it does not model."""
    fit = np.linalg.pinv(leg_fits(_machine(), "6a").jacobian)
    return _SHOWN[:, None] * -np.einsum("irn,ni->ri", fit, effect)


def absorbed_change(name: str, change: NDArray) -> NDArray:
    """Return the bias of the fit by a change (6,), SI, of a parameter that it holds fixed, such as a_z or u_x."""
    parameters = ParameterSet(tuple(LegParameter(name, leg, "1", 1.0) for leg in range(6)))
    machine, at = _machine(), _at()
    closing = MODEL.close(machine, at.p, at.R, at.rho, parameters.change(machine))
    # true values off by the change leave the nominal machine's closing off by minus its effect
    return absorbed(-closing.by_parameter @ change)


def _field(a: NDArray | None = None, b: NDArray | None = None, kappa: float = 0.0, l: float = 0.0) -> NDArray:  # noqa: E741
    """Return a pattern from shifts (6, 2) in mm, and equal changes of kappa (1e-3) and l (mm)."""
    still = np.zeros((6, 2))
    flat = [still if a is None else a, still if b is None else b, np.tile([kappa, l], (6, 1))]
    return np.concatenate(flat, 1).T


def _ring(name: str) -> tuple[NDArray, NDArray]:
    """Return radial and tangential unit vectors (6, 2) of a ring's joints."""
    joints = getattr(_machine().legs, name)[:, :2]
    radial = joints / np.linalg.norm(joints, axis=1, keepdims=True)
    return radial, radial @ np.array([[0.0, 1.0], [-1.0, 0.0]])


def _pairs_apart(name: str) -> NDArray:
    """Return joints of a ring (6, 2) moving along it, 1 mm each, away from the neighbour of their close pair."""
    joints = getattr(_machine().legs, name)[:, :2]
    gap = joints[:, None] - joints
    gap[np.arange(6), np.arange(6)] = np.inf
    nearest = np.argmin(np.linalg.norm(gap, axis=-1), 1)
    tangential = _ring(name)[1]
    return tangential * np.sign(np.sum(tangential * (joints - joints[nearest]), -1))[:, None]


def _tilt_of_base(axis: int) -> NDArray:
    """Return the pattern of nominal values given in a base frame that is tilted by 1 mrad about x (0) or y (1)."""
    a = _machine().legs.a
    lift, lean = (a[:, 1], ("u_y", -1e-3)) if axis == 0 else (-a[:, 0], ("u_x", 1e-3))
    return absorbed_change("a_z", 1e-3 * lift) + absorbed_change(lean[0], np.full(6, lean[1]))


def _tilt_of_platform(axis: int) -> NDArray:
    b = _machine().legs.b
    return absorbed_change("b_z", 1e-3 * (b[:, 1] if axis == 0 else -b[:, 0]))


def _turn(name: str) -> NDArray:
    """Return joints (6, 2), mm, turned by 1 mrad about z."""
    return _ring(name)[1] * np.linalg.norm(getattr(_machine().legs, name), axis=1, keepdims=True)


_X, _Y = np.tile([1.0, 0.0], (6, 1)), np.tile([0.0, 1.0], (6, 1))
FRAMES: dict[str, tuple[str, Pattern]] = {
    "base frame, x": ("mm", lambda: _field(a=_X)),
    "base frame, y": ("mm", lambda: _field(a=_Y)),
    "base frame, about z": ("mrad", lambda: _field(a=_turn("a"))),
    "base frame, about x": ("mrad", lambda: _tilt_of_base(0)),
    "base frame, about y": ("mrad", lambda: _tilt_of_base(1)),
    "platform frame, x": ("mm", lambda: _field(b=_X)),
    "platform frame, y": ("mm", lambda: _field(b=_Y)),
    "platform frame, about z": ("mrad", lambda: _field(b=_turn("b"))),
    "platform frame, about x": ("mrad", lambda: _tilt_of_platform(0)),
    "platform frame, about y": ("mrad", lambda: _tilt_of_platform(1)),
    "height of one frame": ("mm", lambda: _field(l=1.0)),
}


def _uniform(scale: float, with_actuators: bool) -> NDArray:
    """Return the pattern of all lengths longer by a scale, and of actuators that are not."""
    legs = _machine().legs
    a, b = (1e3 * scale * getattr(legs, name)[:, :2] for name in "ab")
    return _field(a, b, kappa=0.0 if with_actuators else -1e3 * scale, l=1e3 * scale * float(legs.l[0]))


def _in_plane(share: float) -> NDArray:
    """Return the pattern of attachments that move outwards by a share of their own actuator's displacement."""
    machine, at = _machine(), _at()
    outwards = np.concatenate([_ring("b")[0], np.zeros((6, 1))], 1)
    by_joint = MODEL.close(machine, at.p, at.R, at.rho, _joints().change(machine)).by_parameter
    own = np.einsum("niid->nid", by_joint.reshape(len(at.rho), 6, 6, 3))
    return absorbed(-share * np.einsum("nid,id->ni", own, outwards) * (at.rho - machine.legs.rho0))


def _joints() -> ParameterSet:
    return ParameterSet(tuple(LegParameter(f"b_{axis}", leg, "m", 1.0) for leg in range(6) for axis in "xyz"))


def _more_of_K(share: float, whole: bool) -> NDArray:
    """Return the pattern of a true K that is larger than the published one by a share."""
    machine, K, at = _machine(), published().K, _at()
    added = share * (K if whole else K - published().own)
    values = [
        MODEL.close(with_deformation(machine, matrix), at.p, at.R, at.rho, NO_CHANGE).value for matrix in (K, K + added)
    ]
    return absorbed(values[0] - values[1])


def _other_structure(structure: Structure, like: Structure) -> NDArray:
    """Return the pattern of a truth that follows one model of the structure where another is expected."""
    machine, at = flexible(_machine()), _at()
    true, expected = (poses_at(model, machine, at.rho) for model in (structure, like))
    twist = np.concatenate([true.p - expected.p, log_so3(true.R @ np.swapaxes(expected.R, -1, -2))], -1)
    rows = MODEL.close(_machine(), at.p, at.R, at.rho, NO_CHANGE).by_twist
    return absorbed(np.einsum("nlt,nt->nl", rows, twist))


CAUSES: dict[str, tuple[str, Pattern]] = {
    "all actuators move less than read, or all K_ii are short": ("1e-3", lambda: _field(kappa=1.0)),
    "base radius": ("mm", lambda: _field(a=_ring("a")[0])),
    "platform radius": ("mm", lambda: _field(b=_ring("b")[0])),
    "close pairs on the base farther apart": ("mm each", lambda: _field(a=_pairs_apart("a"))),
    "close pairs on the platform farther apart": ("mm each", lambda: _field(b=_pairs_apart("b"))),
    "scale of the photogrammetry": ("1e-3", lambda: _uniform(1e-3, with_actuators=False)),
    "everything but heights larger": ("1e-3", lambda: _uniform(1e-3, with_actuators=True)),
    "actuators lean, all along x": ("mrad", lambda: absorbed_change("u_x", np.full(6, 1e-3))),
    "actuators lean, all along y": ("mrad", lambda: absorbed_change("u_y", np.full(6, 1e-3))),
    "K larger, all of it": ("%", lambda: _more_of_K(0.01, whole=True)),
    "K larger except its diagonal": ("%", lambda: _more_of_K(0.01, whole=False)),
    "attachments move outwards with their actuator": ("1e-3", lambda: _in_plane(1e-3)),
    "flexures' parasitic shift, as 10 mm long": ("times", lambda: _other_structure(BeamModel(), MODEL)),
    "elastic legs, as assumed": ("times", lambda: _other_structure(StiffnessModel(), JacobianModel())),
}


@dataclass(frozen=True)
class Finding:
    """One candidate: size with its standard deviation, and what it takes off chi-square.

    p: probability of that much by chance if the scatter is as assumed; p_any: whatever the scatter's size (F test).
    """

    name: str
    unit: str
    size: float
    sigma: float
    gain: float
    p: float
    p_any: float


@dataclass(frozen=True)
class Explanation:
    """A fit of frames and causes to what is left over."""

    names: tuple[str, ...]
    sizes: NDArray
    sigma: NDArray
    chi_square: float
    residual: NDArray  # (6 rows, 6 legs), mm and 1e-3

    @property
    def freedom(self) -> int:
        """Return the degrees of freedom that the fit leaves."""
        return self.residual.size - len(self.names)

    @property
    def p(self) -> float:
        """Return the probability of a larger chi-square by chance."""
        from scipy.stats import chi2

        return float(chi2.sf(self.chi_square, self.freedom))

    def rms(self, *rows: str) -> float:
        """Return the rms of what remains in some rows, mm or 1e-3."""
        return float(np.sqrt(np.mean(self.residual[[ROWS.index(row) for row in rows]] ** 2)))


@cache
def pattern(name: str) -> NDArray:
    """Return the pattern (6 rows, 6 legs) of a frame or a cause at unit size."""
    return (FRAMES | CAUSES)[name][1]()


def explain(causes: Sequence[str], by: Ignorance, of: NDArray | None = None) -> Explanation:
    """Return the least-squares fit of all frames and some causes to the remainder."""
    names = (*FRAMES, *causes)
    values, columns = remainder() if of is None else of, np.stack([pattern(name) for name in names], -1)
    white = np.linalg.inv(np.linalg.cholesky(by.covariance()))
    X = np.einsum("iwr,rip->iwp", white, columns).reshape(36, -1)
    y = np.einsum("iwr,ri->iw", white, values).ravel()
    sizes, *_ = np.linalg.lstsq(X, y)
    left = y - X @ sizes
    sigma = np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
    return Explanation(names, sizes, sigma, float(left @ left), values - columns @ sizes)


def findings(by: Ignorance, given: Sequence[str] = ()) -> list[Finding]:
    """Return every single cause in addition to the frames and the given causes, the most significant first."""
    from scipy.stats import chi2, f

    before, found = explain(given, by).chi_square, []
    for name in [name for name in CAUSES if name not in given]:
        with_it = explain((*given, name), by)
        gain = before - with_it.chi_square
        ratio = gain / (with_it.chi_square / with_it.freedom)
        p = float(chi2.sf(gain, 1)), float(f.sf(ratio, 1, with_it.freedom))
        found.append(Finding(name, CAUSES[name][0], with_it.sizes[-1], with_it.sigma[-1], gain, *p))
    return sorted(found, key=lambda finding: -finding.gain)


# The machine's own numbers, and the one thing next to them that all legs share.
TOGETHER = tuple(CAUSES)[:5]
