"""The best that any choice of configurations can do: an upper bound on the determinant of the information.

A design spreads n measurements over candidates by weights w (C,). Leg l of L learns A_l = G_l + n sum_x w_x r_xl r_xl^T
from rows r (C, L, q), G what is known already; the criterion is sum_l log det A_l (O1 of the telescope report). For any
other weights v, by concavity and by the mean inequality over the P = L q eigenvalues,

    log det A(v) <= log det A(w) + P log( (sum_l trace A_l^-1 G_l + n max_x d(x)) / P ),
    d(x) = sum_l r_xl^T A_l^-1 r_xl,

with equality at the optimum (Kiefer and Wolfowitz, Canad. J. Math. 12 (1960) 363). The bound holds for n measurements
split over the candidates in whole numbers or not; no exact choice need reach it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TO_BOUNDARY = 0.95
_CENTRING = 0.05
_MAX_STEPS = 100
_ADDED = 64  # candidates taken in at a time


@dataclass(frozen=True)
class DesignBound:
    """An optimal design of n measurements on candidates, and what no design on them can exceed.

    weights (C,), sum 1; information (L, q, q) of the design with what was known before; log_det of it; upper: the
    bound; sensitivity (C,): n d(x), at most P - trace at the optimum; known: sum_l trace A_l^-1 G_l; converged: whether
    upper - log_det came below the gap asked for.
    """

    weights: NDArray
    information: NDArray
    log_det: float
    upper: float
    sensitivity: NDArray
    known: float
    count: float
    converged: bool

    def with_sensitivity(self, largest: float) -> float:
        """Return the bound where further candidates reach a sensitivity: at least ``upper``."""
        size = self.information.shape[0] * self.information.shape[1]
        return max(self.upper, self.log_det + size * float(np.log((self.known + largest) / size)))


def efficiency(log_det: float, bound: float, parameters: int) -> float:
    """Return the D-efficiency (det / det of the bound)^(1/P): the share of measurements that the best would need."""
    return float(np.exp((log_det - bound) / parameters))


def sum_log_det(information: NDArray) -> float:
    """Return sum_l log det of information (..., L, q, q); minus infinity where a leg is not determined."""
    sign, value = np.linalg.slogdet(information)
    return float(np.sum(np.where(sign > 0, value, -np.inf)))


def bound_design(rows: NDArray, count: float, given: NDArray | None = None, gap: float = 1e-6) -> DesignBound:
    """Return the optimal design of ``count`` measurements on candidates with rows (C, L, q), to a gap in log det.

    given (L, q, q): information there already. Interior point on the weights, candidates that the bound needs being
    taken in by and by. Raises ValueError where the candidates do not determine every leg.
    """
    before = np.zeros((rows.shape[1], rows.shape[2], rows.shape[2])) if given is None else given
    if not np.isfinite(sum_log_det(before + np.einsum("clq,clr->lqr", rows, rows))):
        raise ValueError("candidates that determine every parameter")
    pool = _spanning(rows)
    for _ in range(len(rows)):
        weights, converged = _interior_point(rows[pool], count, before, gap / 2)
        design = _judged(rows, pool, weights, count, before, gap)
        if design.converged or not converged:
            return design
        outside = np.setdiff1d(np.arange(len(rows)), pool)
        best = outside[np.argsort(design.sensitivity[outside])[::-1][:_ADDED]]
        pool = np.concatenate([pool[weights > 1e-9 / len(pool)], best])
    return design


def _spanning(rows: NDArray) -> NDArray:
    """Return a small pool of candidates to begin with: those most sensitive when all have the same weight."""
    flat = np.einsum("clq,clr->lqr", rows, rows)
    sensitivity = np.einsum("clq,lqr,clr->c", rows, np.linalg.inv(flat), rows)
    return np.argsort(sensitivity)[::-1][: 4 * _ADDED]


def _interior_point(rows: NDArray, count: float, before: NDArray, gap: float) -> tuple[NDArray, bool]:
    """Return the weights (C,) that maximise the log determinant, by primal-dual Newton steps, and whether they do."""
    size = rows.shape[1] * rows.shape[2]
    w = np.full(len(rows), 1.0 / len(rows))
    slack = np.zeros(0)
    for _ in range(_MAX_STEPS):
        gradient, curvature, known = _derivatives(rows, w, count, before)
        if size * np.log((known + gradient.max()) / size) <= gap:
            return w, True
        if not len(slack):
            slack = 1.1 * gradient.max() - gradient
        w, slack = _newton(w, slack, gradient, curvature)
    return w, False


def _derivatives(rows: NDArray, w: NDArray, count: float, before: NDArray) -> tuple[NDArray, NDArray, float]:
    """Return gradient (C,) and minus the Hessian (C, C) of the log determinant, and sum_l trace A_l^-1 G_l."""
    information = _information(rows, w, count, before)
    factor = np.linalg.inv(np.linalg.cholesky(information))
    white = factor @ np.transpose(rows, (1, 2, 0))
    products = count * np.swapaxes(white, 1, 2) @ white
    known = float(np.sum((factor @ before) * factor))
    return np.einsum("lcc->c", products), np.einsum("lcd,lcd->cd", products, products), known


def _information(rows: NDArray, w: NDArray, count: float, before: NDArray) -> NDArray:
    legs = np.transpose(rows, (1, 2, 0))
    return before + count * (legs * w) @ np.swapaxes(legs, 1, 2)


def _newton(w: NDArray, slack: NDArray, gradient: NDArray, curvature: NDArray) -> tuple[NDArray, NDArray]:
    """Return weights and slacks after one step towards gradient + slack = nu, w slack = mu, sum w = 1."""
    mu = _CENTRING * float(w @ slack) / len(w)
    system = curvature + np.diag(slack / w)
    pair = np.linalg.solve(system, np.column_stack([gradient + mu / w, np.ones(len(w))]))
    nu = (pair[:, 0].sum() - (1.0 - w.sum())) / pair[:, 1].sum()
    step = pair[:, 0] - nu * pair[:, 1]
    other = mu / w - slack - slack / w * step
    return w + _length(w, step) * step, slack + _length(slack, other) * other


def _length(value: NDArray, step: NDArray) -> float:
    """Return how far a step may go before a positive value would vanish, at most 1."""
    falling = step < 0
    return min(1.0, _TO_BOUNDARY * float(np.min(-value[falling] / step[falling], initial=np.inf)))


def _judged(rows: NDArray, pool: NDArray, w: NDArray, count: float, before: NDArray, gap: float) -> DesignBound:
    """Return the design of weights on a pool with the bound over all candidates."""
    weights = np.zeros(len(rows))
    weights[pool] = w / w.sum()
    information = _information(rows[pool], weights[pool], count, before)
    inverse = np.linalg.inv(information)
    sensitivity = count * np.einsum("clq,lqr,clr->c", rows, inverse, rows, optimize=True)
    known, size = float(np.sum(inverse * before)), rows.shape[1] * rows.shape[2]
    log_det = sum_log_det(information)
    upper = log_det + size * float(np.log((known + sensitivity.max()) / size))
    return DesignBound(weights, information, log_det, upper, sensitivity, known, count, upper - log_det <= gap)
