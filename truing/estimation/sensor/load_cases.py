"""Choice of loads for the best calibration: the design methods of poses, with wrenches as configurations.

All channels see the same loads. So the determinant of the information about the sensitivities A (V = A F) is a power of
that about one row: a candidate's row is its terms, with one "leg" for all channels. Loads are in units of their limits,
and may be limited by the capacity of each measuring leg.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.design.pose_selection import (
    bound_design,
    efficiency,
    exchange,
    information_of,
    one_by_one,
    rounded_design,
    sum_log_det,
)
from truing.estimation.sensor.calibration import Powers, Terms
from truing.estimation.sensor.load_table import LOADS

_STARTS = 5
_LEAST = 1e-9  # share of the largest eigenvalue that a start needs in every direction


@dataclass(frozen=True)
class LoadLimits:
    """Limits of the loads: each component up to limits (W,), N and N m, and the limits of legs if known.

    legs (L, W): leg forces per unit of load (G^-1), leg_limit (L,) N, both empty without limits.
    """

    limits: NDArray
    legs: NDArray | None = None
    leg_limit: NDArray | None = None

    @property
    def region(self) -> FeasibleRegion:
        """Return the region of loads in units of their limits."""
        size = len(self.limits)
        normals, half = np.eye(size), np.ones(size)
        if self.legs is not None and self.leg_limit is not None:
            normals = np.concatenate([normals, self.legs * self.limits])
            half = np.concatenate([half, self.leg_limit])
        none = np.empty((0, len(half)))

        def quantities(x: NDArray) -> tuple[NDArray, NDArray]:
            return x @ normals.T, np.broadcast_to(normals, (len(x), *normals.shape))

        return FeasibleRegion(size, quantities, half, none, none)


def corner_loads(limits: LoadLimits) -> NDArray:
    """Return the corners (C, W) of the allowed loads, which are optimal for a linear calibration."""
    return limits.region.corners() * limits.limits


def bench_loads(limits: LoadLimits, levels: NDArray, at_once: int) -> NDArray:
    """Return loads (C, W) with at most `at_once` components, each at some share of its limit with either sign.

    Loads beyond a leg's limit are scaled down. levels: shares in (0, 1].
    """
    steps, size = np.concatenate([-np.asarray(levels), levels]), len(limits.limits)
    grids = []
    for count in range(1, at_once + 1):
        shares = np.array(list(product(steps, repeat=count)))
        for axes in combinations(range(size), count):
            grids.append(shares @ np.eye(size)[list(axes)])
    return np.unique(np.round(limits.region.pulled_in(np.concatenate(grids)), 12), axis=0) * limits.limits


def verification_loads(limits: LoadLimits, count: int, at_once: int, rng: np.random.Generator) -> NDArray:
    """Return random loads (count, W) within the range, with at most `at_once` components."""
    size = len(limits.limits)
    shares = rng.uniform(-1.0, 1.0, (count, size))
    rank = rng.permuted(np.tile(np.arange(size), (count, 1)), axis=1)
    return np.where(rank < at_once, shares, 0.0) * limits.limits


@dataclass(frozen=True)
class LoadDesign:
    """Chosen loads (N, W), one row per load step, with their quality.

    log_det: of the information about one channel's terms, with loads in units of their limits; upper: bound for any
    choice among the candidates; efficiency: share of as many loads that the best choice would need.
    """

    loads: NDArray
    log_det: float
    upper: float
    efficiency: float


def choose_loads(
    candidates: NDArray,
    count: int,
    limits: LoadLimits,
    *,
    powers: Powers = "linear",
    rng: np.random.Generator,
) -> LoadDesign:
    """Return ``count`` of the candidate loads (C, W) that determine a calibration best, with repetitions.

    powers: terms of the calibration, in addition to a zero per channel. Raises ValueError if the candidates, or so few
    loads, do not determine it.
    """
    rows = load_rows(candidates, limits, powers=powers)
    if count < rows.shape[2]:
        raise ValueError(f"found {count} loads, expected at least {rows.shape[2]}, one per term of a channel")
    bound = bound_design(rows, count)
    starts = [rounded_design(bound, count), one_by_one(rows, count, bound)]
    starts += [rng.choice(len(rows), count, replace=len(rows) < count) for _ in range(_STARTS)]
    selections = [exchange(rows, s) for s in starts if _determines(rows[s])]
    best = max(selections, key=lambda selection: selection.log_det)
    share = efficiency(best.log_det, bound.upper, rows.shape[2])
    return LoadDesign(candidates[best.chosen], best.log_det, bound.upper, share)


def _determines(rows: NDArray) -> bool:
    strength = np.linalg.eigvalsh(information_of(rows))
    return bool(np.all(strength[:, 0] > _LEAST * strength[:, -1]))


def load_efficiency(
    loads: NDArray, candidates: NDArray, limits: LoadLimits, *, powers: Powers = "linear"
) -> LoadDesign:
    """Return the quality of given loads (N, W) relative to the best among candidates (C, W); efficiency 0 if
    undetermined."""
    value = sum_log_det(information_of(load_rows(loads, limits, powers=powers)))
    rows = load_rows(candidates, limits, powers=powers)
    bound = bound_design(rows, len(loads))
    return LoadDesign(loads, value, bound.upper, efficiency(value, bound.upper, rows.shape[2]))


def load_rows(loads: NDArray, limits: LoadLimits, *, powers: Powers, zero: bool = True) -> NDArray:
    """Return the rows (N, 1, Q) of loads (N, W) in the equations of one channel."""
    terms = Terms(LOADS[: loads.shape[1]], powers=powers)
    columns = terms.at(loads / limits.limits, np.empty((len(loads), 0)))
    return np.concatenate([columns, np.ones((len(loads), int(zero)))], axis=1)[:, None]


def predicted_sigma(loads: NDArray, signal_sigma: NDArray, limits: LoadLimits) -> NDArray:
    """Return the predicted standard deviation (C, W) of each sensitivity, per unit of load, after loads (N, W).

    signal_sigma (C,): of one reading of each channel.
    """
    rows = load_rows(loads, limits, powers="linear")[:, 0]
    spread = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))[: loads.shape[1]]
    return np.asarray(signal_sigma)[:, None] * (spread / limits.limits)
