"""Motor encoders against the readings of joints: parts of their difference, joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.simulation.mechanisms.chains.conditions import ChainInputs

DIFFERENCE, REMAINDER = "difference", "remainder"
# A term is determined if this share of its rms size is independent of the terms before it.
_INDEPENDENT = 0.05
_SPARE = 6  # fewest poses beyond the number of terms


@dataclass(frozen=True)
class MotorTerm:
    """A number of the relation between motor and joint, SI; ``value`` is None if the campaign does not determine it.

    ``difference`` and ``remainder`` are rms of motor minus joint, after ratio and zero, and after all terms.
    """

    joint: str
    parameter: str
    unit: str
    value: float | None
    sigma: float | None


def motor_terms(machine: ChainInputs, reading: int, motor: NDArray) -> list[MotorTerm]:
    """Return the terms of motor readings (B,), rad or m, by least squares on one joint's readings.

    motor / ratio = reading + zero + lost_motion x direction + wind_up x torque + waves of the turn; in units of the
    joint. The ratio is that of a motor before a gear; 1 if its readings are those of the joint already. Returns none
    if there are too few readings.
    """
    joint, is_known = machine.tree.readings[reading], np.isfinite(motor)
    is_angle = bool(machine.tree.is_revolute[reading])
    unit, torque = ("rad", "rad/(N m)") if is_angle else ("m", "m/N")
    names, columns = zip(*_columns(machine, reading, is_angle), strict=True)
    if is_known.sum() < len(names) + 2 + _SPARE or not np.ptp(machine.readings[is_known, reading]) > 0.0:
        return []
    q, target = machine.readings[is_known, reading], motor[is_known]
    plain = np.column_stack([np.ones(len(q)), q])
    chosen = _independent(plain, [column[is_known] for column in columns])
    design = np.column_stack([plain, *(columns[k][is_known] for k in chosen)])
    found, cov, residual = _fitted(design, target)
    _, _, residual_of_ratio = _fitted(plain, target)
    ratio, size = float(found[1]), abs(float(found[1]))
    terms = [MotorTerm(joint, "ratio", "1", ratio, float(np.sqrt(cov[1, 1])))]
    for k, name in enumerate(names):
        unit_of = torque if name == "wind_up" else unit
        if k in chosen:
            index = 2 + chosen.index(k)
            value = found[index] / ratio
            by = np.eye(len(found))[index] / ratio - np.eye(len(found))[1] * value / ratio
            terms.append(MotorTerm(joint, name, unit_of, float(value), float(np.sqrt(by @ cov @ by))))
        else:
            terms.append(MotorTerm(joint, name, unit_of, None, None))
    sizes = ((DIFFERENCE, residual_of_ratio), (REMAINDER, residual))
    return terms + [
        MotorTerm(joint, name, unit, float(np.sqrt(np.mean(values**2))) / size, None) for name, values in sizes
    ]


def _columns(machine: ChainInputs, reading: int, is_angle: bool) -> Iterator[tuple[str, Array]]:
    """Yield the name and values (B,) of each term of the difference."""
    q, came = machine.readings[:, reading], machine.approach
    yield "lost_motion", np.zeros(len(q)) if came is None else came[:, reading].astype(float)
    yield "wind_up", machine.torque(reading)
    if is_angle:
        for order in (1.0, *machine.gear_orders.get(machine.tree.readings[reading], ())):
            yield f"sine {order:g}", np.sin(order * q)
            yield f"cosine {order:g}", np.cos(order * q)


def _independent(plain: NDArray, columns: Sequence[NDArray]) -> list[int]:
    """Return the columns (B,) that differ enough from those of ``plain`` (B, 2) and from the others before them."""
    basis, chosen = np.linalg.qr(plain)[0], list[int]()
    for k, column in enumerate(columns):
        remainder = column - basis @ (basis.T @ column)
        size = np.sqrt(np.sum(remainder**2))
        if size > _INDEPENDENT * np.sqrt(np.sum(column**2)) > 0.0:
            basis = np.column_stack([basis, remainder / size])
            chosen.append(k)
    return chosen


def _fitted(design: NDArray, target: NDArray) -> tuple[Array, Array, Array]:
    """Return the least-squares solution (P,), its covariance (P, P) by the residuals' scatter, and the residuals."""
    scale = np.sqrt(np.sum(design**2, 0))
    found = np.linalg.lstsq(design / scale, target, rcond=None)[0]
    residual = target - design / scale @ found
    variance = float(residual @ residual) / max(len(target) - len(found), 1)
    inverse = np.linalg.inv((design / scale).T @ (design / scale))
    return found / scale, variance * inverse / np.outer(scale, scale), residual
