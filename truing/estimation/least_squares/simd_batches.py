"""Compiled trust-region steps of `least_squares` for sixteen small problems at once, by normal equations.

A caller fills `ROW` and `RESIDUAL` with one observation of all lanes after the other. Normal equations lose half of
the digits. A lane whose scaled normal matrix has a pivot below `_CLEAR_PIVOT` is marked as unclear, for the QR of
`least_squares`. Importing this module imports numba. Used by `recalibration_kernel`, whose docstring compares its
speed
with a general solver.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.compiled_code import inner
from truing.estimation.simd_arithmetic import LANES

MOST = 12  # parameters
_PACKED = MOST * (MOST + 1) // 2
# Registers: values, trial values, step, column norms, gradient at the values and at the trial, one row of the Jacobian;
X, TRIAL, STEP, SCALE, GRADIENT, GRADIENT_THERE, ROW = (i * MOST for i in range(7))
# normal matrix at the values and at the trial, its root, all lower triangles, row after row;
NORMAL, NORMAL_THERE, ROOT = (7 * MOST + i * _PACKED for i in range(3))
# and one register each.
RESIDUAL, COST, COST_THERE, RADIUS, DAMPING, LENGTH, PROMISED, STATE = range(
    7 * MOST + 3 * _PACKED, 7 * MOST + 3 * _PACKED + 8
)
REGISTERS = STATE + 1
MOVING, LAST_STEP, ARRIVED, UNCLEAR = 0.0, 1.0, 2.0, 3.0

_CLEAR_PIVOT = 1e-10
# A step that promises less than this share of the sum of squares, or than its rounding, is the last one.
_LITTLE = 1e-13
# The last step is taken unless it is worse by more than rounding.
_NOT_WORSE = 1.0 + 1e-9
_ROUNDING = 10.0 * 2.220446049250313e-16
_GOOD, _POOR = 0.75, 0.25
_SECULAR_STEPS = 6


@inner
def clear_sums(lane: NDArray, size: int) -> None:
    """Set the sums at the trial to zero."""
    for i in range(size):
        lane[(GRADIENT_THERE + i) * LANES : (GRADIENT_THERE + i + 1) * LANES] = 0.0
    for i in range(size * (size + 1) // 2):
        lane[(NORMAL_THERE + i) * LANES : (NORMAL_THERE + i + 1) * LANES] = 0.0
    lane[COST_THERE * LANES : (COST_THERE + 1) * LANES] = 0.0


@inner
def add_row(lane: NDArray, size: int) -> None:
    """Add one observation of every lane to the sums at the trial."""
    at = NORMAL_THERE * LANES
    for i in range(size):
        for k in range(i + 1):
            for j in range(LANES):
                lane[at + j] += lane[(ROW + i) * LANES + j] * lane[(ROW + k) * LANES + j]
            at += LANES
        for j in range(LANES):
            lane[(GRADIENT_THERE + i) * LANES + j] += lane[(ROW + i) * LANES + j] * lane[RESIDUAL * LANES + j]
    for j in range(LANES):
        lane[COST_THERE * LANES + j] += lane[RESIDUAL * LANES + j] * lane[RESIDUAL * LANES + j]


@inner
def start(lane: NDArray, size: int) -> None:
    """Accept the sums at the first values, and initialise missing radii from the size of the parameters."""
    for j in range(LANES):
        lane[STATE * LANES + j] = MOVING if np.isfinite(lane[COST_THERE * LANES + j]) else UNCLEAR
        for i in range(size):
            lane[(SCALE + i) * LANES + j] = 0.0
        move(lane, size, j)
        square = 0.0
        for i in range(size):
            square += (lane[(SCALE + i) * LANES + j] * lane[(X + i) * LANES + j]) ** 2
        if lane[RADIUS * LANES + j] == 0.0:
            lane[RADIUS * LANES + j] = np.sqrt(square) if square > 0.0 else 1.0


@inner
def move(lane: NDArray, size: int, j: int) -> None:
    """Move one lane to its trial, and enlarge its scales to the columns there."""
    at = 0
    for i in range(size):
        lane[(X + i) * LANES + j] = lane[(TRIAL + i) * LANES + j]
        lane[(GRADIENT + i) * LANES + j] = lane[(GRADIENT_THERE + i) * LANES + j]
        for _ in range(i + 1):
            lane[(NORMAL + at) * LANES + j] = lane[(NORMAL_THERE + at) * LANES + j]
            at += 1
        column = np.sqrt(lane[(NORMAL + at - 1) * LANES + j])
        lane[(SCALE + i) * LANES + j] = max(column, lane[(SCALE + i) * LANES + j])
        if not lane[(SCALE + i) * LANES + j] > 0.0:
            lane[STATE * LANES + j] = UNCLEAR
    lane[COST * LANES + j] = lane[COST_THERE * LANES + j]


@inner
def accept_trials(lane: NDArray, size: int) -> int:
    """Accept trials with a decrease, adapt every radius, and return the number of lanes that still move."""
    moving = 0
    for j in range(LANES):
        state = lane[STATE * LANES + j]
        if state == LAST_STEP:
            if lane[COST_THERE * LANES + j] <= _NOT_WORSE * lane[COST * LANES + j]:
                move(lane, size, j)
            lane[STATE * LANES + j] = ARRIVED
        elif state == MOVING:
            gain = (lane[COST * LANES + j] - lane[COST_THERE * LANES + j]) / lane[PROMISED * LANES + j]
            length, radius = lane[LENGTH * LANES + j], lane[RADIUS * LANES + j]
            lane[RADIUS * LANES + j] = max(radius, 2.0 * length) if gain > _GOOD else radius
            if not gain >= _POOR:
                lane[RADIUS * LANES + j] = 0.25 * length
            if gain > 0.0:
                move(lane, size, j)
            moving += 1
    return moving


@inner
def take_root(lane: NDArray, size: int) -> None:
    """Fill in the Cholesky root of the damped scaled normal matrix; nearly singular lanes become unclear."""
    for i in range(size):
        for k in range(i + 1):
            at, row, column = i * (i + 1) // 2 + k, i * (i + 1) // 2, k * (k + 1) // 2
            for j in range(LANES):
                scale = lane[(SCALE + i) * LANES + j] * lane[(SCALE + k) * LANES + j]
                lane[(ROOT + at) * LANES + j] = lane[(NORMAL + at) * LANES + j] / scale
            for m in range(k):
                for j in range(LANES):
                    product = lane[(ROOT + row + m) * LANES + j] * lane[(ROOT + column + m) * LANES + j]
                    lane[(ROOT + at) * LANES + j] -= product
            if k < i:
                for j in range(LANES):
                    lane[(ROOT + at) * LANES + j] /= lane[(ROOT + column + k) * LANES + j]
        for j in range(LANES):
            pivot = lane[(ROOT + i * (i + 1) // 2 + i) * LANES + j] + lane[DAMPING * LANES + j]
            scaled = lane[(NORMAL + i * (i + 1) // 2 + i) * LANES + j] / lane[(SCALE + i) * LANES + j] ** 2
            clear = pivot > _CLEAR_PIVOT * scaled
            lane[STATE * LANES + j] = lane[STATE * LANES + j] if clear else UNCLEAR
            lane[(ROOT + i * (i + 1) // 2 + i) * LANES + j] = np.sqrt(pivot) if clear else 1.0


@inner
def substitute_down(lane: NDArray, size: int, vector: int) -> None:
    """Solve ``root y = vector`` in place."""
    for i in range(size):
        row = ROOT + i * (i + 1) // 2
        for k in range(i):
            for j in range(LANES):
                lane[(vector + i) * LANES + j] -= lane[(row + k) * LANES + j] * lane[(vector + k) * LANES + j]
        for j in range(LANES):
            lane[(vector + i) * LANES + j] /= lane[(row + i) * LANES + j]


@inner
def substitute_up(lane: NDArray, size: int, vector: int) -> None:
    """Solve ``root^T y = vector`` in place."""
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            at = ROOT + k * (k + 1) // 2 + i
            for j in range(LANES):
                lane[(vector + i) * LANES + j] -= lane[at * LANES + j] * lane[(vector + k) * LANES + j]
        for j in range(LANES):
            lane[(vector + i) * LANES + j] /= lane[(ROOT + i * (i + 1) // 2 + i) * LANES + j]


@inner
def square_of(lane: NDArray, size: int, vector: int, j: int) -> float:
    total = 0.0
    for i in range(size):
        total += lane[(vector + i) * LANES + j] ** 2
    return total


@inner
def damped_step(lane: NDArray, size: int) -> None:
    """Fill in the step in scaled parameters, and its length, for the present damping."""
    take_root(lane, size)
    for i in range(size):
        for j in range(LANES):
            lane[(STEP + i) * LANES + j] = -lane[(GRADIENT + i) * LANES + j] / lane[(SCALE + i) * LANES + j]
    substitute_down(lane, size, STEP)
    substitute_up(lane, size, STEP)
    for j in range(LANES):
        lane[LENGTH * LANES + j] = np.sqrt(square_of(lane, size, STEP, j))


@inner
def raise_damping(lane: NDArray, size: int) -> int:
    """Take a step of Hebden's method towards the damping whose step ends on the radius; return the number of lanes
    outside."""
    outside = 0
    for i in range(size):
        for j in range(LANES):
            lane[(ROW + i) * LANES + j] = lane[(STEP + i) * LANES + j]
    substitute_down(lane, size, ROW)
    for j in range(LANES):
        length, radius = lane[LENGTH * LANES + j], lane[RADIUS * LANES + j]
        if length > 1.1 * radius and lane[STATE * LANES + j] == MOVING:
            bend = square_of(lane, size, ROW, j)
            lane[DAMPING * LANES + j] += length * length * (length / radius - 1.0) / bend
            outside += 1
    return outside


@inner
def fill_promise(lane: NDArray, size: int) -> None:
    """Fill in the decrease of the sum of squares that the linear problem predicts for the step."""
    for j in range(LANES):
        promised = lane[DAMPING * LANES + j] * lane[LENGTH * LANES + j] ** 2
        for i in range(size):
            slope = lane[(GRADIENT + i) * LANES + j] / lane[(SCALE + i) * LANES + j]
            promised -= lane[(STEP + i) * LANES + j] * slope
        lane[PROMISED * LANES + j] = promised


@inner
def mark_negligible_steps(lane: NDArray, size: int) -> None:
    """Mark the lanes whose undamped step promises less than the resolution of the sum of squares."""
    fill_promise(lane, size)
    for j in range(LANES):
        effect = 0.0
        for i in range(size):
            effect += (lane[(SCALE + i) * LANES + j] * lane[(X + i) * LANES + j]) ** 2
        norm = np.sqrt(lane[COST * LANES + j])
        little = lane[PROMISED * LANES + j] <= norm * (_LITTLE * norm + _ROUNDING * np.sqrt(effect))
        if little and lane[STATE * LANES + j] == MOVING:
            lane[STATE * LANES + j] = LAST_STEP


@inner
def propose(lane: NDArray, size: int) -> None:
    """Fill in the trials: the minimum of the linear problem, within the radius."""
    lane[DAMPING * LANES : (DAMPING + 1) * LANES] = 0.0
    damped_step(lane, size)
    mark_negligible_steps(lane, size)
    for _ in range(_SECULAR_STEPS):
        if raise_damping(lane, size) == 0:
            break
        damped_step(lane, size)
    fill_promise(lane, size)
    for i in range(size):
        for j in range(LANES):
            step = lane[(STEP + i) * LANES + j] / lane[(SCALE + i) * LANES + j]
            lane[(TRIAL + i) * LANES + j] = lane[(X + i) * LANES + j] + step


@inner
def prepare_covariance(lane: NDArray, size: int) -> None:
    """Fill in the undamped root of the normal matrix of converged lanes."""
    lane[DAMPING * LANES : (DAMPING + 1) * LANES] = 0.0
    take_root(lane, size)


@inner
def covariance_column(lane: NDArray, size: int, column: int) -> None:
    """Fill in `STEP` with a column of the inverse normal matrix."""
    for i in range(size):
        for j in range(LANES):
            lane[(STEP + i) * LANES + j] = 1.0 / lane[(SCALE + i) * LANES + j] if i == column else 0.0
    substitute_down(lane, size, STEP)
    substitute_up(lane, size, STEP)
    for i in range(size):
        for j in range(LANES):
            lane[(STEP + i) * LANES + j] /= lane[(SCALE + i) * LANES + j]
