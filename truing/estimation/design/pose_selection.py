"""Choice of configurations for calibration: those whose information has the largest determinant (O1), leg by leg.

Candidates are rows (C, L, q) of the observability Jacobian, one per leg; legs are independent, so the criterion is
sum_l log det A_l with A_l = G_l + sum_n r_nl r_nl^T, G (L, q, q) what is known already (telescope report, section 6.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.design_bound import DesignBound, sum_log_det

# A change of the log determinant below this is rounding.
_LEAST_GAIN = 1e-10
# Of the best design, that lets the first few candidates be judged.
_HINT = 1e-6


class SelectionStatus(StrEnum):
    """How a search for configurations ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration-limit"


@dataclass(frozen=True)
class Selection:
    """Chosen candidates (N,) as indices, a candidate measured twice standing twice; log_det: the criterion."""

    chosen: NDArray
    log_det: float
    status: SelectionStatus
    iterations: int


def information_of(rows: NDArray, given: NDArray | None = None) -> NDArray:
    """Return A (L, q, q) of rows (N, L, q) with what is known already."""
    own = np.einsum("nlq,nlr->lqr", rows, rows)
    return own if given is None else own + given


def rounded_design(design: DesignBound, count: int) -> NDArray:
    """Return ``count`` candidates that repeat a design's weights as nearly as whole numbers can.

    Efficient rounding (Pukelsheim and Rieder, Biometrika 79 (1992) 763); of a support larger than ``count`` the
    heaviest.
    """
    support = np.argsort(design.weights, kind="stable")[::-1][: max(1, int(np.sum(design.weights > 1e-6)))][:count]
    share = design.weights[support] / design.weights[support].sum()
    times = np.ceil((count - len(support) / 2) * share)
    while times.sum() != count:
        if times.sum() > count:
            times[np.argmax((times - 1) / share)] -= 1
        else:
            times[np.argmin(times / share)] += 1
    return np.repeat(support, times.astype(int))


def one_by_one(rows: NDArray, count: int, design: DesignBound, given: NDArray | None = None) -> NDArray:
    """Return ``count`` candidates, each the best to add to those before it: a start that determines what can be.

    Until the candidates chosen determine every parameter by themselves, a trace of the best design's information helps.
    """
    information = _HINT * design.information if given is None else given + _HINT * design.information
    chosen = np.zeros(count, np.int64)
    for n in range(count):
        chosen[n] = np.argmax(_gains(rows, information))
        information = information + information_of(rows[chosen[n : n + 1]])
    return chosen


def exchange(rows: NDArray, start: NDArray, given: NDArray | None = None, max_iterations: int = 1000) -> Selection:
    """Return the choice that no exchange of one configuration for one candidate improves.

    start (N,): candidates to begin with. Each step makes the best of all N C exchanges, whose gain follows from
    rank-one updates: det(A + x x^T - y y^T) / det A = (1 + d_xx)(1 - d_yy) + d_xy^2, d_xy = x^T A^-1 y (Fedorov, Theory
    of Optimal Experiments, 1972). Raises ValueError where the start does not determine every leg.
    """
    chosen = np.array(start)
    for iteration in range(max_iterations):
        information = _determined(rows[chosen], given)
        out, into, gain = _best_exchange(rows, chosen, information)
        if gain <= _LEAST_GAIN:
            return Selection(chosen, sum_log_det(information), SelectionStatus.CONVERGED, iteration)
        chosen[out] = into
    value = sum_log_det(information_of(rows[chosen], given))
    return Selection(chosen, value, SelectionStatus.ITERATION_LIMIT, max_iterations)


def _best_exchange(rows: NDArray, chosen: NDArray, information: NDArray) -> tuple[int, int, float]:
    """Return which of the chosen goes, which candidate comes, and by how much the log determinant grows."""
    factor = np.linalg.inv(np.linalg.cholesky(information))
    white = factor @ np.transpose(rows, (1, 2, 0))
    own = white[:, :, chosen]
    come = 1.0 + np.sum(white * white, 1)
    go = 1.0 - np.sum(own * own, 1)
    both = np.swapaxes(white, 1, 2) @ own
    ratio = np.prod(come[:, :, None] * go[:, None] + both * both, 0)
    into, out = divmod(int(np.argmax(ratio)), len(chosen))
    return out, into, float(np.log(ratio[into, out]))


def ioops(rows: NDArray, start: NDArray, given: NDArray | None = None, max_iterations: int = 1000) -> Selection:
    """Return the choice that eliminating its worst configuration and adding the best candidate leaves as it is.

    The two are judged one after the other, which is what sets it apart from `exchange` (IOOPS, the telescope report,
    section 6.3.2). Raises ValueError as `exchange`.
    """
    chosen = np.array(start)
    value = sum_log_det(_determined(rows[chosen], given))
    for iteration in range(max_iterations):
        trial = _without_worst(rows, chosen, given)
        best = int(np.argmax(_gains(rows, information_of(rows[trial], given))))
        trial = np.append(trial, best)
        reached = sum_log_det(information_of(rows[trial], given))
        if reached <= value + _LEAST_GAIN:
            return Selection(chosen, value, SelectionStatus.CONVERGED, iteration)
        chosen, value = trial, reached
    return Selection(chosen, value, SelectionStatus.ITERATION_LIMIT, max_iterations)


def _without_worst(rows: NDArray, chosen: NDArray, given: NDArray | None) -> NDArray:
    """Return the chosen less the one whose loss costs least."""
    inverse = np.linalg.inv(information_of(rows[chosen], given))
    own = np.einsum("nlq,lqr,nlr->nl", rows[chosen], inverse, rows[chosen], optimize=True)
    return np.delete(chosen, int(np.argmax(np.sum(np.log(np.maximum(1.0 - own, 1e-300)), -1))))


def _gains(rows: NDArray, information: NDArray) -> NDArray:
    """Return by how much each candidate (C,) would raise the log determinant."""
    sensitivity = np.einsum("clq,lqr,clr->cl", rows, np.linalg.pinv(information, hermitian=True), rows, optimize=True)
    return np.sum(np.log1p(sensitivity), -1)


def _determined(rows: NDArray, given: NDArray | None) -> NDArray:
    information = information_of(rows, given)
    if not np.isfinite(sum_log_det(information)):
        raise ValueError(f"a choice of {len(rows)} configurations that determines every parameter")
    return information
