"""Where a platform stands on legs with errors, without linearising: many sensors at once, for Monte Carlo.

Each leg keeps its length, `|P + R b' - B'| = L'`, with the radii and the length that it has got. Solved by Newton's
method with the unloaded sensor's matrix throughout: errors of 1e-4 of a leg shrink by that factor with every step.
Everything is held as one array per number, over samples, so that NumPy runs along memory.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.geometry import JointCentres, outward
from truing.simulation.bench.six_upur.influence import influence_matrix

_MAX_ITERATIONS = 30
# What is left after a step, of a leg's length, once it no longer matters.
_ROUNDING = 1e-16
Three = tuple[NDArray, NDArray, NDArray]


@dataclass(frozen=True)
class _Plan:
    """What all samples share: (3, 6, 1) legs, arms and outward directions below and above; 1 / G; (6, 1) lengths."""

    leg: NDArray
    arm: NDArray
    below: NDArray
    above: NDArray
    inverse: NDArray
    length: NDArray


def plan_of(joints: JointCentres) -> _Plan:
    """Return what `stand` needs of one sensor; raises LinAlgError where six legs do not hold the platform."""
    arrays = (joints.leg, joints.arm, outward(joints.lower), outward(joints.arm))
    leg, arm, below, above = (array.T[..., None] for array in arrays)
    return _Plan(leg, arm, below, above, np.linalg.inv(influence_matrix(joints)), joints.length[:, None])


def assembled(joints: JointCentres, errors: NDArray) -> NDArray:
    """Return platform errors (N, 6), m and rotation vector in rad, of sensors with errors (N, 6, 5) of the sources, m.

    NaN where the legs do not close.
    """
    return stand(plan_of(joints), np.ascontiguousarray(np.transpose(errors, (2, 1, 0)))).T


def stand(plan: _Plan, errors: NDArray) -> NDArray:
    """Return platform errors (6, N) of sensors with errors (5, 6, N), m, in the order of `assembly.SOURCES`."""
    above, below, low, middle, installed = errors
    wanted = plan.length + low - middle + installed
    wider = [direction * above for direction in plan.above]
    arm = _three(old + more for old, more in zip(plan.arm, wider, strict=True))
    base = (direction * below for direction in plan.below)
    leg = _three(old + more - moved for old, more, moved in zip(plan.leg, wider, base, strict=True))
    square, per_length = wanted * wanted, 0.5 / plan.length
    step = _combined(plan.inverse, (_squared(leg) - square) * per_length)
    x, lost = -step, np.zeros(errors.shape[-1], bool)
    shortest = before = float(plan.length.min())
    for _ in range(_MAX_ITERATIONS):
        reach = np.abs(step).max(0)
        if reach.max() > shortest:
            lost |= reach > shortest
        size = float(reach.max(where=~lost, initial=0.0))
        if size * size <= before * _ROUNDING * shortest:  # steps shrink by size / before
            break
        before = size
        step = _combined(plan.inverse, (_squared(_moved(leg, arm, x)) - square) * per_length)
        if lost.any():
            step[:, lost] = 0.0
        x -= step
    else:
        lost |= reach > np.sqrt(_ROUNDING) * shortest
    x[:, lost] = np.nan
    return _with_rotation_vector(x)


def _moved(leg: Three, arm: Three, x: NDArray) -> Three:
    """Return the legs (3 of (6, N)) with the platform moved by x: a shift, and half a rotation in Cayley's form.

    R = I + 2 ([c]x + [c]x^2) / (1 + c^2), one matrix per sample and not one product per leg.
    """
    a, b, c = 0.5 * x[3], 0.5 * x[4], 0.5 * x[5]
    aa, bb, cc = a * a, b * b, c * c
    scale = 2.0 / (1.0 + aa + bb + cc)
    rows = (
        (-scale * (bb + cc), scale * (a * b - c), scale * (a * c + b)),
        (scale * (a * b + c), -scale * (aa + cc), scale * (b * c - a)),
        (scale * (a * c - b), scale * (b * c + a), -scale * (aa + bb)),
    )
    room = np.empty_like(arm[0])
    return _three(_turned(row, arm, leg[i] + x[i], room) for i, row in enumerate(rows))


def _turned(row: Three, arm: Three, total: NDArray, room: NDArray) -> NDArray:
    """Return total (6, N) with a row of a matrix times the arms added in its place; room for one product."""
    for number, part in zip(row, arm, strict=True):
        total += np.multiply(number, part, out=room)
    return total


def _with_rotation_vector(x: NDArray) -> NDArray:
    """Return x (6, N) with the rotation vector in place of twice the tangent of its half."""
    tangent = 0.5 * np.sqrt(_squared((x[3], x[4], x[5])))
    still = tangent == 0.0
    x[3:] *= np.where(still, 1.0, np.arctan(tangent) / np.where(still, 1.0, tangent))
    return x


def _combined(inverse: NDArray, long: NDArray) -> NDArray:
    """Return inverse' long (6, N), leg by leg: products of libraries may add up in another order on other machines."""
    step, room = inverse[0][:, None] * long[0], np.empty_like(long)
    for row, values in zip(inverse[1:], long[1:], strict=True):
        step += np.multiply(row[:, None], values, out=room)
    return step


def _three(parts: Iterable[NDArray]) -> Three:
    x, y, z = parts
    return x, y, z


def _squared(v: Three) -> NDArray:
    total, room = v[0] * v[0], np.empty_like(v[0])
    for part in v[1:]:
        total += np.multiply(part, part, out=room)
    return total
