"""Choice of configurations for calibration: largest determinant (O1), its upper bound, and continuous optimisation.

A design distributes n measurements over candidates by weights w (C,). Leg l of L has rows r (C, L, q) and the prior
information G_l. Its information is A_l = G_l + n sum_x w_x r_xl r_xl^T. The criterion is sum_l log det A_l (O1 of the
telescope report, section 6.3). A bound for any other weights v follows from concavity and from the inequality of means
over the P = L q eigenvalues:

    log det A(v) <= log det A(w) + P log( (sum_l trace A_l^-1 G_l + n max_x d(x)) / P );
    d(x) = sum_l r_xl^T A_l^-1 r_xl.

Both sides are equal at the optimum (Kiefer and Wolfowitz, Canad. J. Math. 12 (1960) 363). The bound holds for whole and
fractional repetitions; an exact choice may stay below it. Legs are independent. A candidate with M measurements of one
leg has rows (C, L, M, q): its information is the sum over them, and the same inequality holds (Fedorov, Theory of
Optimal Experiments, 1972, section 5.3).

Continuous search: spectral projected gradient (Birgin, Martínez and Raydan, SIAM J. Optim. 10 (2000) 1196) in a
`FeasibleRegion`, with limits linearised at every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.feasible_region import FeasibleRegion

_TO_BOUNDARY = 0.95
_CENTRING = 0.05
_MAX_STEPS = 100
_ADDED = 64  # candidates added per iteration
# Smaller changes of the log determinant are rounding.
_LEAST_GAIN = 1e-10
# Share of the best design's information that helps to compare the first candidates.
_HINT = 1e-6
# x (N, n) -> rows (N, L, q) and their derivatives (N, L, q, n)
RowsAt = Callable[[NDArray], tuple[NDArray, NDArray]]
# x (N, n) -> a value for all of them, and its gradient (N, n)
Objective = Callable[[NDArray], tuple[float, NDArray]]
_MEMORY = 8  # earlier values that a step is compared with, so that spectral step lengths can be used
_SUFFICIENT = 1e-4
_SHORTEST = 1e-8
_FARTHEST = 3.0  # how far a step may aim beyond the limits (about 1 away); more only slows the projection
_HALVINGS = 12  # shorter moves are negligible compared with the spectral length
_LEAST_MOVE = 1e-6  # negligible move of the coordinates, whose limits are about 1 away
_GAIN = 1e-7  # negligible relative gain over the memory


@dataclass(frozen=True)
class DesignBound:
    """Optimal design of n measurements on candidates, with an upper bound for all designs on them.

    weights (C,): sum 1; information (L, q, q): of the design and prior; log_det: of the information; upper: bound;
    sensitivity (C,): n d(x), at most P - trace at the optimum; known: sum_l trace A_l^-1 G_l; converged: whether upper
    - log_det is below the requested gap.
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
        """Return the bound for further candidates with a larger sensitivity: at least ``upper``."""
        size = self.information.shape[0] * self.information.shape[1]
        return max(self.upper, self.log_det + size * float(np.log((self.known + largest) / size)))


def efficiency(log_det: float, bound: float, parameters: int) -> float:
    """Return the D-efficiency (det / det of the bound)^(1/P): the share of measurements that the best design would
    need."""
    return float(np.exp((log_det - bound) / parameters))


def sum_log_det(information: NDArray) -> float:
    """Return sum_l log det of information (..., L, q, q); minus infinity if a leg is not determined."""
    sign, value = np.linalg.slogdet(information)
    return float(np.sum(np.where(sign > 0, value, -np.inf)))


def bound_design(
    rows: NDArray, count: float, prior_information: NDArray | None = None, gap: float = 1e-6
) -> DesignBound:
    """Return the optimal design of ``count`` measurements on candidates with rows (C, L, q) or (C, L, M, q), to a gap
    in log det.

    prior_information (L, q, q). Interior point method on the weights; candidates are added as the bound requires.
    Raises ValueError if the candidates do not determine every leg.
    """
    rows = _measurements(rows)
    before = np.zeros((rows.shape[1], rows.shape[3], rows.shape[3])) if prior_information is None else prior_information
    if not np.isfinite(sum_log_det(before + np.einsum("clmq,clmr->lqr", rows, rows))):
        raise ValueError("candidates that determine every parameter")
    pool = _spanning(rows, before)
    for _ in range(len(rows)):
        weights, converged = _interior_point(rows[pool], count, before, gap / 2)
        design = _design_with_bound(rows, pool, weights, count, before, gap)
        if design.converged or not converged:
            return design
        outside = np.setdiff1d(np.arange(len(rows)), pool)
        best = outside[np.argsort(design.sensitivity[outside])[::-1][:_ADDED]]
        pool = np.concatenate([pool[weights > 1e-9 / len(pool)], best])
    return design


def _measurements(rows: NDArray) -> NDArray:
    """Return rows (C, L, M, q) of candidates, each with M measurements of a leg: one of rows (C, L, q)."""
    return rows if rows.ndim == 4 else rows[:, :, None]


def _spanning(rows: NDArray, before: NDArray) -> NDArray:
    """Return a small pool of candidates to begin with: the most sensitive ones at equal weights."""
    flat = before + np.einsum("clmq,clmr->lqr", rows, rows)
    sensitivity = np.einsum("clmq,lqr,clmr->c", rows, np.linalg.inv(flat), rows, optimize=True)
    return np.argsort(sensitivity)[::-1][: max(1, 4 * _ADDED // rows.shape[2])]


def _interior_point(rows: NDArray, count: float, before: NDArray, gap: float) -> tuple[NDArray, bool]:
    """Return the weights (C,) that maximise the log determinant, by primal-dual Newton steps, and whether they
    converged."""
    size = rows.shape[1] * rows.shape[3]
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
    known = float(np.sum((factor @ before) * factor))
    if rows.shape[2] > 1:  # a matrix for each candidate: curvature tr(W_c W_d), with W = X'X of whitened rows X
        white = rows @ np.swapaxes(factor, 1, 2)
        derivative = count * np.swapaxes(white, 2, 3) @ white
        flat = derivative.reshape(len(rows), -1)
        return np.einsum("clqq->c", derivative), flat @ flat.T, known
    white = factor @ _columns(rows)
    products = count * np.swapaxes(white, 1, 2) @ white
    return np.einsum("lcc->c", products), np.einsum("lcd,lcd->cd", products, products), known


def _columns(rows: NDArray) -> NDArray:
    """Return the measurements of all candidates as columns (L, q, C M)."""
    return np.transpose(rows, (1, 3, 0, 2)).reshape(rows.shape[1], rows.shape[3], -1)


def _information(rows: NDArray, w: NDArray, count: float, before: NDArray) -> NDArray:
    legs = _columns(rows)
    return before + count * (legs * np.repeat(w, rows.shape[2])) @ np.swapaxes(legs, 1, 2)


def _newton(w: NDArray, slack: NDArray, gradient: NDArray, curvature: NDArray) -> tuple[NDArray, NDArray]:
    """Return weights and slacks after one step towards gradient + slack = nu, w slack = mu, sum w = 1."""
    mu = _CENTRING * float(w @ slack) / len(w)
    system = curvature + np.diag(slack / w)
    pair = np.linalg.solve(system, np.column_stack([gradient + mu / w, np.ones(len(w))]))
    nu = (pair[:, 0].sum() - (1.0 - w.sum())) / pair[:, 1].sum()
    step = pair[:, 0] - nu * pair[:, 1]
    other = mu / w - slack - slack / w * step
    return w + _step_length(w, step) * step, slack + _step_length(slack, other) * other


def _step_length(value: NDArray, step: NDArray) -> float:
    """Return the largest step, at most 1, that keeps positive values positive."""
    falling = step < 0
    return min(1.0, _TO_BOUNDARY * float(np.min(-value[falling] / step[falling], initial=np.inf)))


def _design_with_bound(
    rows: NDArray, pool: NDArray, w: NDArray, count: float, before: NDArray, gap: float
) -> DesignBound:
    """Return the design of weights on a pool, with the bound over all candidates."""
    weights = np.zeros(len(rows))
    weights[pool] = w / w.sum()
    information = _information(rows[pool], weights[pool], count, before)
    inverse = np.linalg.inv(information)
    sensitivity = count * np.einsum("clmq,lqr,clmr->c", rows, inverse, rows, optimize=True)
    known, size = float(np.sum(inverse * before)), rows.shape[1] * rows.shape[3]
    log_det = sum_log_det(information)
    upper = log_det + size * float(np.log((known + sensitivity.max()) / size))
    return DesignBound(weights, information, log_det, upper, sensitivity, known, count, upper - log_det <= gap)


class SelectionStatus(StrEnum):
    """Final status of a search for configurations."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration-limit"


@dataclass(frozen=True)
class PoseSelection:
    """Chosen candidates (N,) as indices, repeated for repeated measurements; log_det: the criterion."""

    chosen: NDArray
    log_det: float
    status: SelectionStatus
    iterations: int


def information_of(rows: NDArray, prior_information: NDArray | None = None) -> NDArray:
    """Return A (L, q, q) of rows (N, L, q) or (N, L, M, q) and prior information."""
    information = np.einsum("nlmq,nlmr->lqr", _measurements(rows), _measurements(rows))
    return information if prior_information is None else information + prior_information


def rounded_design(design: DesignBound, count: int) -> NDArray:
    """Return ``count`` candidates with repetitions closest to a design's weights.

    Efficient rounding (Pukelsheim and Rieder, Biometrika 79 (1992) 763); of a support larger than ``count`` the
    candidates of largest weight.
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


def one_by_one(rows: NDArray, count: int, design: DesignBound, prior_information: NDArray | None = None) -> NDArray:
    """Return ``count`` candidates by greedy choice, each the best addition to those before it.

    Until the chosen candidates determine every parameter, a small share of the best design's information is added.
    """
    information = (
        _HINT * design.information if prior_information is None else prior_information + _HINT * design.information
    )
    chosen = np.zeros(count, np.int64)
    for n in range(count):
        chosen[n] = np.argmax(_gains(rows, information))
        information = information + information_of(rows[chosen[n : n + 1]])
    return chosen


def exchange(
    rows: NDArray, start: NDArray, prior_information: NDArray | None = None, max_iterations: int = 1000
) -> PoseSelection:
    """Return a choice that no exchange of one configuration for one candidate improves.

    start (N,): initial candidates. Each step makes the best of all N C exchanges. The gain follows from rank-one
    updates: det(A + x x^T - y y^T) / det A = (1 + d_xx)(1 - d_yy) + d_xy^2; d_xy = x^T A^-1 y (Fedorov, Theory of
    Optimal Experiments, 1972). Raises ValueError if the start does not determine every leg.
    """
    chosen = np.array(start)
    for iteration in range(max_iterations):
        information = _determined(rows[chosen], prior_information)
        out, into, gain = _best_exchange(rows, chosen, information)
        if gain <= _LEAST_GAIN:
            return PoseSelection(chosen, sum_log_det(information), SelectionStatus.CONVERGED, iteration)
        chosen[out] = into
    value = sum_log_det(information_of(rows[chosen], prior_information))
    return PoseSelection(chosen, value, SelectionStatus.ITERATION_LIMIT, max_iterations)


def _best_exchange(rows: NDArray, chosen: NDArray, information: NDArray) -> tuple[int, int, float]:
    """Return the configuration to remove, the candidate to add, and the gain of the log determinant."""
    factor = np.linalg.inv(np.linalg.cholesky(information))
    if rows.ndim == 4:
        ratio = _block_exchanges(_measurements(rows) @ np.swapaxes(factor, 1, 2), chosen)
        into, out = divmod(int(np.argmax(ratio)), len(chosen))
        return out, into, float(ratio[into, out])
    white = factor @ np.transpose(rows, (1, 2, 0))
    chosen_rows = white[:, :, chosen]
    come = 1.0 + np.sum(white * white, 1)
    go = 1.0 - np.sum(chosen_rows * chosen_rows, 1)
    both = np.swapaxes(white, 1, 2) @ chosen_rows
    ratio = np.prod(come[:, :, None] * go[:, None] + both * both, 0)
    into, out = divmod(int(np.argmax(ratio)), len(chosen))
    return out, into, float(np.log(ratio[into, out]))


def _block_exchanges(white: NDArray, chosen: NDArray) -> NDArray:
    """Return the gain (C, N) of the log determinant by every exchange, from whitened rows (C, L, M, q).

    A -> A - Y'Y + X'X: log det (1 - Y Y') + log det (1 + X (1 - Y'Y)^-1 X').
    """
    log_det_change = np.empty((len(white), len(chosen)))
    identity, unit = np.eye(white.shape[2]), np.eye(white.shape[3])
    for index, out in enumerate(chosen):
        Y = white[out]
        turned = np.swapaxes(Y, 1, 2)
        lost = sum_log_det(identity - Y @ turned)
        if not np.isfinite(lost):  # the others do not determine everything
            log_det_change[:, index] = -np.inf
            continue
        X = white @ np.linalg.cholesky(np.linalg.inv(unit - turned @ Y))
        log_det_change[:, index] = lost + np.linalg.slogdet(identity + X @ np.swapaxes(X, 2, 3))[1].sum(1)
    return log_det_change


def ioops(
    rows: NDArray, start: NDArray, prior_information: NDArray | None = None, max_iterations: int = 1000
) -> PoseSelection:
    """Return a choice that is stable under removing its worst configuration and adding the best candidate.

    Removal and addition are decided one after the other, unlike in `exchange` (IOOPS, telescope report, section 6.3.2).
    Raises ValueError as `exchange`.
    """
    chosen = np.array(start)
    value = sum_log_det(_determined(rows[chosen], prior_information))
    for iteration in range(max_iterations):
        trial = _without_worst(rows, chosen, prior_information)
        best = int(np.argmax(_gains(rows, information_of(rows[trial], prior_information))))
        trial = np.append(trial, best)
        reached = sum_log_det(information_of(rows[trial], prior_information))
        if reached <= value + _LEAST_GAIN:
            return PoseSelection(chosen, value, SelectionStatus.CONVERGED, iteration)
        chosen, value = trial, reached
    return PoseSelection(chosen, value, SelectionStatus.ITERATION_LIMIT, max_iterations)


def _without_worst(rows: NDArray, chosen: NDArray, prior_information: NDArray | None) -> NDArray:
    """Return the chosen candidates without the one whose loss costs least."""
    inverse = np.linalg.inv(information_of(rows[chosen], prior_information))
    measurements = _measurements(rows[chosen])
    residual = np.eye(measurements.shape[2]) - measurements @ inverse @ np.swapaxes(measurements, 2, 3)
    return np.delete(chosen, int(np.argmax(np.sum(np.log(np.maximum(np.linalg.det(residual), 1e-300)), -1))))


def _gains(rows: NDArray, information: NDArray) -> NDArray:
    """Return the gain (C,) of the log determinant by each candidate."""
    measurements, inverse = _measurements(rows), np.linalg.pinv(information, hermitian=True)
    return np.linalg.slogdet(np.eye(measurements.shape[2]) + measurements @ inverse @ np.swapaxes(measurements, 2, 3))[
        1
    ].sum(-1)


def _determined(rows: NDArray, prior_information: NDArray | None) -> NDArray:
    information = information_of(rows, prior_information)
    if not np.isfinite(sum_log_det(information)):
        raise ValueError(f"a choice of {len(rows)} configurations that determines every parameter")
    return information


@dataclass(frozen=True)
class AscentResult:
    """Result of a climb: points (N, n) in the region, the objective there, and the final status."""

    x: NDArray
    value: float
    status: SelectionStatus
    iterations: int


def optimise_directly(
    region: FeasibleRegion,
    rows_at: RowsAt,
    start: NDArray,
    prior_information: NDArray | None = None,
    max_iterations: int = 1000,
) -> AscentResult:
    """Return N configurations that no small move within the region improves, from a start (N, n) in it.

    Maximises sum_l log det A_l with prior_information (L, q, q). Raises ValueError if the start does not
    determine every leg.
    """

    def objective(x: NDArray) -> tuple[float, NDArray]:
        rows, changes = rows_at(x)
        information = information_of(rows, prior_information)
        value = sum_log_det(information)
        if not np.isfinite(value):
            return -np.inf, np.zeros_like(x)
        return value, 2.0 * np.einsum("nlq,nlqi->ni", _solved(rows, information), changes)

    if not np.isfinite(objective(start)[0]):
        raise ValueError(f"a start of {len(start)} configurations that determines every parameter")
    return ascend(region, objective, start, max_iterations)


def largest_sensitivity(
    region: FeasibleRegion, rows_at: RowsAt, design: DesignBound, start: NDArray, max_iterations: int = 40
) -> AscentResult:
    """Return the most sensitive points that climbs from a start (N, n) reach; value: the largest sensitivity.

    It covers points between the candidates: `DesignBound.with_sensitivity` turns it into a bound for the whole region.
    """

    def each(x: NDArray) -> tuple[NDArray, NDArray]:
        rows, changes = rows_at(x)
        solved = _solved(rows, design.information)
        gradient = 2.0 * design.count * np.einsum("nlq,nlqi->ni", solved, changes)
        return design.count * np.sum(rows * solved, (1, 2)), gradient

    def objective(x: NDArray) -> tuple[float, NDArray]:
        value, gradient = each(x)
        return float(value.sum()), gradient

    ascent = ascend(region, objective, start, max_iterations)
    return AscentResult(ascent.x, float(each(ascent.x)[0].max()), ascent.status, ascent.iterations)


def _solved(rows: NDArray, information: NDArray) -> NDArray:
    """Return A_l^-1 r_nl (N, L, q)."""
    return np.einsum("lqr,nlr->nlq", np.linalg.inv(information), rows)


def ascend(region: FeasibleRegion, objective: Objective, start: NDArray, max_iterations: int) -> AscentResult:
    """Return the local maximum of the objective reached from a start (N, n) within the region."""
    x, status = start, SelectionStatus.ITERATION_LIMIT
    value, gradient = objective(x)
    length, past, best = np.inf, [value], (x, value)
    while len(past) <= max_iterations:
        steepest = max(float(np.abs(gradient).max()), 1e-300)
        move = region.project(x + min(length, _FARTHEST / steepest) * gradient, x) - x
        trial, reached, slope = _step(region, objective, x, move, gradient, min(past[-_MEMORY:]))
        if trial is None or np.abs(move).max() <= _LEAST_MOVE or _has_converged(past):
            status = SelectionStatus.CONVERGED
            break
        length = _spectral_length(trial - x, slope - gradient)
        x, value, gradient = trial, reached, slope
        past.append(value)
        best = (x, value) if value > best[1] else best
    inside = region.pulled_in(best[0])
    return AscentResult(inside, objective(inside)[0], status, len(past) - 1)


def _has_converged(past: list[float]) -> bool:
    """True if the best value has hardly grown over the memory."""
    if len(past) <= 2 * _MEMORY:
        return False
    return max(past[-_MEMORY:]) - max(past[:-_MEMORY]) <= _GAIN * max(1.0, abs(past[-1]))


def _step(
    region: FeasibleRegion, objective: Objective, x: NDArray, move: NDArray, gradient: NDArray, least: float
) -> tuple[NDArray | None, float, NDArray]:
    """Return the first point of successively halved moves with sufficient gain; moves that end in a forbidden box are
    not made."""
    rise, share = float(np.sum(gradient * move)), 1.0
    for _ in range(_HALVINGS):
        trial = region.pulled_in(x + share * move)
        trial = np.where(region.allowed(trial)[:, None], trial, x)
        value, slope = objective(trial)
        if value >= least + _SUFFICIENT * share * rise and np.any(trial != x):
            return trial, value, slope
        share /= 2.0
    return None, least, gradient


def _spectral_length(moved: NDArray, turned: NDArray) -> float:
    """Return the step length that fits the last change of the gradient; infinite if the gradient grew along the
    move."""
    bend = -float(np.sum(moved * turned))
    return np.inf if bend <= 0 else max(float(np.sum(moved**2)) / bend, _SHORTEST)
