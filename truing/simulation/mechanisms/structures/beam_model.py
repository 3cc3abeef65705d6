"""Model of bending flexures: rigid legs whose joints shift as flexures bend (telescope report, eq. 10-18, 32).

A flexure is a uniform beam of length l_b whose end has the slope delta, rad. A leg has one at each joint. A flexure
adds to the leg's length the distance from the pivot in its middle to the flexure's end, l_b/2 if it is straight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import (
    ReferencePose,
    attachment_change,
    closure_rows,
    leg_vectors,
    reference_change,
    reference_pose,
)
from truing.simulation.mechanisms.structures.kinematic_model import shifting
from truing.simulation.mechanisms.structures.structure import Closing, Machine

# The circle through all ends of the flexure is centred at 3/4 l_b from the end, a quarter from the root (eq. 13).
BETA = 0.25
# Below this squared slope, closed forms lose digits to 0/0; the first omitted term of a series is under 1e-16.
_SERIES_BELOW = 0.01
_SHORTENING = (0.0, 1 / 6, -1 / 40, 1 / 112, -5 / 1152, 7 / 2816, -21 / 13312, 11 / 10240)
_SINC = (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800)
# (2 arcsin sqrt(s))^2 in 4 s, s = (1 - cos) / 2.
_SQUARED_ANGLE = (0.0, 1.0, 1 / 12, 1 / 90, 1 / 560, 1 / 3150, 1 / 16632, 1 / 84084, 1 / 411840)
# -(d(sin t / t) / dt) / t; divided by (sin t) / t it is the derivative by cos t.
_SINC_SLOPE = (1 / 3, -1 / 30, 1 / 840, -1 / 45360, 1 / 3991680, -1 / 518918400)


@dataclass(frozen=True)
class Distance:
    """Distance (...) from a flexure's pivot to its end, m, with its derivatives by cosine of the bend, l_b and beta."""

    value: NDArray
    by_cosine: NDArray
    by_length: NDArray
    by_beta: NDArray


class BendLaw(Protocol):
    """Law of a bent flexure, from its length l_b (...), m, the cosine of its bend (...), and beta."""

    def __call__(self, length: NDArray, cosine: NDArray, beta: NDArray | float = ..., /) -> Distance: ...


def deflection(length: ArrayLike, slope: ArrayLike) -> tuple[NDArray, NDArray]:
    """Return shortening and deflection (dx, dy) (...), m, of the end of a parabolic arc of length l_b (eq. 12).

    dx is measured from the straight flexure's end towards its root.
    """
    l_b, delta = np.asarray(length), np.asarray(slope)
    return l_b * _by_series(delta * delta, _SHORTENING, _parabola_shortening), l_b * delta / 2


def circle_remainder(length: ArrayLike, dx: ArrayLike, dy: ArrayLike) -> NDArray:
    """Return the residual (...), m2, of an end in the equation of the circle of radius 3/4 l_b about (3/4 l_b, 0) (eq.
    13).

    It is of fourth order in the slope: 47/720 l_b^2 for eq. 12, -1/720 l_b^2 for the circular arc.
    """
    l_b, x, y = np.asarray(length), np.asarray(dx), np.asarray(dy)
    return x * x - 1.5 * l_b * x + y * y


@dataclass(frozen=True)
class FlexurePath:
    """Displacement (along, across) (N,), m, of the end of a flexure from its straight place, along towards its root.

    slope (N,), rad; pivot: of an ideal pivot in the middle; beam: by eq. 12; circle: on that of radius (1 - beta) l_b
    (eq. 13), as far across as the beam.
    """

    slope: NDArray
    pivot: tuple[NDArray, NDArray]
    beam: tuple[NDArray, NDArray]
    circle: tuple[NDArray, NDArray]


def flexure_path(length: float, slope: NDArray, beta: float = BETA) -> FlexurePath:
    """Return the paths of the end of a flexure of length l_b, m, at slopes (N,), rad (telescope report, figure 9)."""
    along, across = deflection(length, slope)
    radius = (1.0 - beta) * length
    pivot = 0.5 * length * (1.0 - np.cos(slope)), 0.5 * length * np.sin(slope)
    # the difference of two nearly equal lengths, without cancellation
    circle = across**2 / (radius + np.sqrt(radius**2 - across**2))
    return FlexurePath(slope, pivot, (along, across), (circle, across))


def circle_distance(length: NDArray, cosine: NDArray, beta: NDArray | float = BETA) -> Distance:
    """Return the distance for a flexure whose end moves on the circle of radius (1 - beta) l_b (eq. 15-17).

    length l_b and cosine of the bend (...); beta below 3/4, beyond which eq. 15 has no positive root or two.
    """
    lean = (1 - 2 * beta) * cosine
    root = np.sqrt(3 - 4 * beta + lean * lean)
    share = (root - lean) / 2
    by_beta = length * (cosine - (1 + cosine * lean) / root)
    return Distance(length * share, -length * (1 - 2 * beta) * share / root, share + 0.0 * length, by_beta)


def arc_distance(length: NDArray, cosine: NDArray, beta: NDArray | float = BETA) -> Distance:
    """Return the distance for a flexure bent to a circular arc, without approximation: l_b (sin t / t - cos t / 2).

    It is measured along the leg, the arc's tangent, which misses the pivot by l_b t^3 / 24: no elongation to first
    order. It does not depend on beta.
    """
    squared = _squared_angle(cosine)
    sinc = _by_series(squared, _SINC, lambda t: np.sin(t) / t)
    slope = _by_series(squared, _SINC_SLOPE, lambda t: (np.sin(t) - t * np.cos(t)) / t**3) / sinc
    share = sinc - cosine / 2
    return Distance(length * share, length * (slope - 0.5), share + 0.0 * length, 0.0 * share * length * beta)


def _parabola_shortening(t: NDArray) -> NDArray:
    return (np.sqrt(1 + t * t) + np.arcsinh(t) / t) / 2 - 1


def _squared_angle(cosine: NDArray) -> NDArray:
    """Return the squared angle of a cosine; smooth at 1, where the angle itself is not."""
    gap = 2 - 2 * cosine
    return _by_series(gap, _SQUARED_ANGLE, lambda t: 4 * np.arcsin(t / 2) ** 2)


def _by_series(x: NDArray, series: tuple[float, ...], closed: Callable[[NDArray], NDArray]) -> NDArray:
    """Evaluate a function of sqrt(x) by its series in x if x is small, otherwise in closed form."""
    small = np.abs(x) < _SERIES_BELOW
    near, total = np.where(small, x, 0.0), np.zeros_like(x)
    for coefficient in reversed(series):
        total = total * near + coefficient
    return np.where(small, total, closed(np.sqrt(np.where(small, 1.0, x))))


@dataclass(frozen=True)
class LegBending:
    """Legs between flexures A, on the base, and B, on the platform, at B poses; base frame, m.

    value: closure residual (B, L) of the legs (eq. 32); z: their directions (B, L, 3); turned: directions at the
    reference, rotated with the platform, R R0' z0; a, b: distances from pivot to end; pull: derivative (B, L, 3) of the
    residual by the lower joints.
    """

    value: NDArray
    z: NDArray
    turned: NDArray
    a: Distance
    b: Distance
    pull: NDArray


@dataclass(frozen=True)
class BeamModel:
    """Closure residual of a leg: length - l_b + dl_A + dl_B - |p + R b* - c| (eq. 32), for any closure.

    Flexures are straight in the reference pose, which follows from the reference readings; needs at least six legs.
    ``distance`` is the law of a bent flexure's length, from l_b and the cosine of the bend.
    """

    name: str = "beam"
    distance: BendLaw = circle_distance

    def fits(self, machine: Machine) -> bool:
        """True if the joints are flexures of known length and the reference pose follows from the readings."""
        return machine.flexure_length is not None and machine.legs.count >= 6

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closure residuals at poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m.

        Raises ValueError if the model does not fit the machine.
        """
        reference, legs = reference_pose(machine.legs), machine.legs
        bend = flexure_bending(self.distance, machine, reference, p, R, rho)
        by_twist = -closure_rows(legs, R, bend.pull, machine.delta_bz(rho))
        by_twist[..., 3:] += bend.b.by_cosine[..., None] * np.cross(bend.turned, bend.z)
        driven = Change({"rho": np.eye(legs.count), "delta_bz": machine.deformation}, legs.count)
        by_rho = _joint_derivative(legs, R, rho, bend, driven)
        by_parameter = _joint_derivative(legs, R, rho, bend, shifting(machine, rho, change))
        by_parameter = by_parameter + _by_nominal_flexures(legs, reference, R, bend, change)
        return Closing(bend.value, by_twist, by_rho, by_parameter)


def flexure_bending(
    distance: BendLaw, machine: Machine, reference: ReferencePose, p: NDArray, R: NDArray, rho: NDArray
) -> LegBending:
    """Return the bending of the flexures at poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m.

    The cosine of a bend is z z0 on the base (eq. 16) and z R R0' z0 on the platform (eq. 17, any reference rotation).
    Raises ValueError for a machine without flexure_length.
    """
    legs, l_b = machine.legs, _flexure_length(machine)
    g = leg_vectors(legs, p, R, rho, machine.delta_bz(rho))
    bend_angle = np.sqrt(np.sum(g * g, -1))
    z, turned = g / bend_angle[..., None], reference.z @ reference.R @ np.swapaxes(R, -1, -2)
    cos_a, cos_b = np.sum(z * reference.z, -1), np.sum(z * turned, -1)
    beta = BETA if machine.beta is None else machine.beta
    a, b = distance(l_b, cos_a, beta), distance(l_b, cos_b, beta)
    sideways = _times(a.by_cosine, reference.z - _times(cos_a, z)) + _times(b.by_cosine, turned - _times(cos_b, z))
    value = legs.closure.length(legs, rho) - l_b + a.value + b.value - bend_angle
    return LegBending(value, z, turned, a, b, z - sideways / bend_angle[..., None])


def _joint_derivative(legs: Legs, R: NDArray, rho: NDArray, bend: LegBending, change: Change) -> NDArray:
    """Return the derivative (B, L, P) of the residual by joints and lengths, at fixed directions of straight
    flexures."""
    change_of_span = attachment_change(legs, R, change) - legs.closure.lower_change(legs, rho, change)
    return legs.closure.length_change(legs, change) - np.einsum("...li,...lip->...lp", bend.pull, change_of_span)


def _by_nominal_flexures(legs: Legs, reference: ReferencePose, R: NDArray, bend: LegBending, change: Change) -> NDArray:
    """Return the derivative (B, L, P) of the residual by directions and lengths of the straight flexures."""
    moved = reference_change(legs, reference, change)
    on_platform = moved.z - np.cross(moved.twist[..., None, 3:, :], reference.z[..., None], axis=-2)
    seen = bend.z @ R @ np.swapaxes(reference.R, -1, -2)  # direction without the rotation of the platform
    a = np.einsum("...li,...lip->...lp", _times(bend.a.by_cosine, bend.z), moved.z)
    b = np.einsum("...li,...lip->...lp", _times(bend.b.by_cosine, seen), on_platform)
    longer = (bend.a.by_length + bend.b.by_length - 1)[..., None]
    rounder = (bend.a.by_beta + bend.b.by_beta)[..., None] * change.get("beta", (legs.count,))
    return a + b + longer * change.get("flexure_length", (legs.count,)) + rounder


def _times(scalars: NDArray, vectors: NDArray) -> NDArray:
    return scalars[..., None] * vectors


def _flexure_length(machine: Machine) -> NDArray:
    if machine.flexure_length is None:
        raise ValueError("beam model: found a machine without flexure_length, expected one per leg")
    return machine.flexure_length
