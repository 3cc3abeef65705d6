"""Compiled calibration of legs of fixed length: SIMD batches of sixteen draws, pose by pose.

Results are those of `truing.simulation.mechanisms.recalibration.calibrate_leg` by the trust region. Draws without
proven convergence must be solved again by the caller. Importing this module imports numba. No library solves thousands
of small problems in parallel. This code solves more than 100,000 legs a second on two cores, about 30 times as many as
a general solver (`python -m benchmarks.recalibration`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truing.compiled_code import compiled, inner
from truing.estimation import simd_arithmetic
from truing.estimation.least_squares import simd_batches
from truing.estimation.least_squares.simd_batches import (
    ARRIVED,
    COST,
    RADIUS,
    REGISTERS,
    RESIDUAL,
    ROW,
    STATE,
    STEP,
    TRIAL,
    X,
    accept_trials,
    add_row,
    clear_sums,
    covariance_column,
    prepare_covariance,
    propose,
    start,
)
from truing.estimation.rigid_poses.batched_kernel import run_in_threads
from truing.estimation.simd_arithmetic import LANES, apply, dot, get3, get9, mix, scale, transpose

_FIELDS = 13  # per pose and draw: p, R, rho
# Index of the numbers of a leg: a, b, u, l, kappa, rho0.
A, B, U, L, KAPPA, RHO0 = 0, 3, 6, 9, 10, 11
_NUMBERS = 12
# Columns of the saved state of a draw, after the values.
_COST, _RADIUS, _STATE, _ITERATIONS = range(4)
_DRAWS_PER_TASK = 512
# Steps per round: after each round, the remaining draws form new batches.
_STEPS_PER_ROUND = (5, 5, 10, 20, 40, 80)


class LegUnknowns(NamedTuple):
    """Numbers (12,) of a leg, indices (P,) of those that are unknown, and the component of u that follows from unit
    length."""

    numbers: NDArray
    slots: NDArray
    follows: int


class DrawArrays(NamedTuple):
    """Positions (D, N, 3), rotations (D, N, 3, 3) and readings (D, N) of all draws, m."""

    p: NDArray
    R: NDArray
    rho: NDArray


@inner
def load_draws(p: NDArray, R: NDArray, rho: NDArray, rows: NDArray, poses: NDArray) -> None:
    """Load up to sixteen draws into a batch; unused places repeat the last draw."""
    for j in range(LANES):
        d = rows[min(j, len(rows) - 1)]
        dp, dR, dr = min(d, p.shape[0] - 1), min(d, R.shape[0] - 1), min(d, rho.shape[0] - 1)
        for n in range(len(poses)):
            for i in range(3):
                poses[n, i * LANES + j] = p[dp, n, i]
                for k in range(3):
                    poses[n, (3 + 3 * i + k) * LANES + j] = R[dR, n, i, k]
            poses[n, 12 * LANES + j] = rho[dr, n]


@inner
def load_ends(ends: NDArray, rows: NDArray, size: int, lane: NDArray) -> None:
    """Load the state of each draw into the batch."""
    for j in range(LANES):
        d = rows[min(j, len(rows) - 1)]
        for i in range(size):
            lane[(TRIAL + i) * LANES + j] = ends[d, i]
        lane[RADIUS * LANES + j] = ends[d, size + _RADIUS]


@inner
def set_leg(lane: NDArray, slots: NDArray, follows: int, numbers: NDArray, leg: NDArray) -> None:
    """Set the leg's numbers to the trial values, with u of unit length."""
    for i in range(_NUMBERS):
        leg[i * LANES : (i + 1) * LANES] = numbers[i]
    for i in range(len(slots)):
        for j in range(LANES):
            leg[slots[i] * LANES + j] = lane[(TRIAL + i) * LANES + j]
    sign = 1.0 if numbers[U + follows] > 0.0 else -1.0
    for j in range(LANES):
        rest = 1.0
        for i in range(3):
            rest -= leg[(U + i) * LANES + j] ** 2 if i != follows else 0.0
        leg[(U + follows) * LANES + j] = sign * np.sqrt(rest)


@inner
def fill_row(pose: NDArray, leg: NDArray, full: NDArray, lane: NDArray) -> None:
    """Fill the residual l - |p + R b* - a - rho u| (eq. 30) of one pose and its derivatives by all numbers of the
    leg."""
    for j in range(LANES):
        R, rho, kappa = get9(pose, 3, j), pose[12 * LANES + j], leg[KAPPA * LANES + j]
        moved = rho - leg[RHO0 * LANES + j]
        b = get3(leg, B, j)
        upper = mix(1.0, get3(pose, 0, j), 1.0, apply(R, (b[0], b[1], b[2] + kappa * moved)))
        g = mix(1.0, upper, -1.0, mix(1.0, get3(leg, A, j), rho, get3(leg, U, j)))
        length = np.sqrt(dot(g, g))
        z = scale(1.0 / length, g)
        on_platform = apply(transpose(R), z)
        for i in range(3):
            full[(A + i) * LANES + j] = z[i]
            full[(B + i) * LANES + j] = -on_platform[i]
            full[(U + i) * LANES + j] = rho * z[i]
        full[L * LANES + j] = 1.0
        full[KAPPA * LANES + j] = -on_platform[2] * moved
        full[RHO0 * LANES + j] = on_platform[2] * kappa
        lane[RESIDUAL * LANES + j] = leg[L * LANES + j] - length


@inner
def choose_columns(leg: NDArray, slots: NDArray, follows: int, full: NDArray, lane: NDArray) -> None:
    """Fill the derivatives by the parameters; those of u include the component that follows from unit length."""
    for i in range(len(slots)):
        of_u = (slots[i] >= U) & (slots[i] < U + 3)
        for j in range(LANES):
            slope = leg[slots[i] * LANES + j] / leg[(U + follows) * LANES + j] if of_u else 0.0
            lane[(ROW + i) * LANES + j] = full[slots[i] * LANES + j] - slope * full[(U + follows) * LANES + j]


@inner
def evaluate(
    poses: NDArray, slots: NDArray, follows: int, numbers: NDArray, leg: NDArray, full: NDArray, lane: NDArray
) -> None:
    """Fill the sums over all poses at the trial values."""
    set_leg(lane, slots, follows, numbers, leg)
    clear_sums(lane, len(slots))
    for n in range(len(poses)):
        fill_row(poses[n], leg, full, lane)
        choose_columns(leg, slots, follows, full, lane)
        add_row(lane, len(slots))


@inner
def store(lane: NDArray, rows: NDArray, size: int, ends: NDArray) -> None:
    """Save the state of each draw of the batch."""
    for j in range(len(rows)):
        for i in range(size):
            ends[rows[j], i] = lane[(X + i) * LANES + j]
        ends[rows[j], size + _COST] = lane[COST * LANES + j]
        ends[rows[j], size + _RADIUS] = lane[RADIUS * LANES + j]
        ends[rows[j], size + _STATE] = lane[STATE * LANES + j]


@inner
def store_covariance(lane: NDArray, rows: NDArray, size: int, covariance: NDArray) -> None:
    """Write the inverses of the normal matrices."""
    prepare_covariance(lane, size)
    for k in range(size):
        covariance_column(lane, size, k)
        for j in range(len(rows)):
            for i in range(size):
                covariance[rows[j], i, k] = lane[(STEP + i) * LANES + j]


@compiled(simd_arithmetic.__file__, simd_batches.__file__, __file__)
def solve_rows(
    unknowns: LegUnknowns, draws: DrawArrays, rows: NDArray, limit: int, ends: NDArray, covariance: NDArray
) -> None:
    """Take up to ``limit`` steps with some of the draws, from their saved state."""
    (numbers, slots, follows), (p, R, rho) = unknowns, draws
    poses = np.empty((rho.shape[1], _FIELDS * LANES))
    lane, leg, full = np.zeros(REGISTERS * LANES), np.empty(_NUMBERS * LANES), np.empty(_NUMBERS * LANES)
    size = len(slots)
    for first in range(0, len(rows), LANES):
        some = rows[first : first + LANES]
        load_draws(p, R, rho, some, poses)
        load_ends(ends, some, size, lane)
        evaluate(poses, slots, follows, numbers, leg, full, lane)
        start(lane, size)
        for _ in range(limit):
            propose(lane, size)
            evaluate(poses, slots, follows, numbers, leg, full, lane)
            for j in range(len(some)):
                ends[some[j], size + _ITERATIONS] += 1.0 if lane[STATE * LANES + j] < ARRIVED else 0.0
            if accept_trials(lane, size) == 0:
                break
        store_covariance(lane, some, size, covariance)
        store(lane, some, size, ends)


@dataclass(frozen=True)
class CompiledFits:
    """Calibrations of one leg from D draws; draws that have not ``arrived`` have no proven solution."""

    x: NDArray  # (D, P)
    cost: NDArray  # (D,) m^2
    covariance: NDArray  # (D, P, P)
    arrived: NDArray  # (D,) bool
    iterations: NDArray  # (D,)


def solve(
    numbers: NDArray,
    slots: NDArray,
    begin: NDArray,
    p: NDArray,
    R: NDArray,
    rho: NDArray,
    *,
    threads: int | None = None,
) -> CompiledFits:
    """Calibrate a leg in D draws of p (D, N, 3), R (D, N, 3, 3) and rho (D, N); m; arrays with D = 1 apply to all
    draws.

    numbers (12,): a, b, u, l, kappa and rho0 of the leg; slots (P,): indices of the parameters; begin (D, P): their
    start. The largest component of u follows from the others. threads as in `share_out`.
    """
    count, size = begin.shape
    ends, covariance = np.zeros((count, size + 4)), np.empty((count, size, size))
    ends[:, :size] = begin
    follows = int(np.argmax(np.abs(numbers[U : U + 3])))
    unknowns, draws = LegUnknowns(numbers, slots, follows), DrawArrays(*map(np.ascontiguousarray, (p, R, rho)))

    def part(first: int) -> None:
        rows = np.arange(first, min(first + _DRAWS_PER_TASK, count))
        for limit in _STEPS_PER_ROUND:
            solve_rows(unknowns, draws, rows, limit, ends, covariance)
            rows = rows[ends[rows, size + _STATE] < ARRIVED]
            if len(rows) == 0:
                break

    run_in_threads(part, range(0, count, _DRAWS_PER_TASK), threads)
    x, (cost, _, state, iterations) = ends[:, :size].copy(), ends[:, size:].T.copy()
    return CompiledFits(x, cost, covariance, state == ARRIVED, iterations.astype(np.int64))
