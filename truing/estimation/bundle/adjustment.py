"""Bundle adjustment: minimise the weighted sum of squares over all rays, distances and known points.

Levenberg-Marquardt with the gain control of Nielsen (1999), on normal equations reduced pose by pose. Iterations run
without a datum; the result is then transformed into the chosen one.

This is our own code because no library offers inner constraints, rigid distances and the covariance between all points:
pycolmap gives each point alone, with all else fixed. `python -m benchmarks.bundle` compares them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.bundle_covariance import BundleCovariance, covariance
from truing.estimation.bundle.datum import Datum, Freedom, conditions, freedoms, in_datum
from truing.estimation.bundle.determinable import UndeterminedNetworkError, check_determined
from truing.estimation.bundle.elimination import Reduced, eliminate_poses, solve, tie_variances, tie_weights
from truing.estimation.bundle.network import Network, NetworkState, project
from truing.estimation.bundle.normal_equations import (
    ArrayPool,
    EquationLayout,
    NormalEquations,
    Observed,
    UnknownsStep,
    distances_at,
    equation_layout,
    normal_equations,
    observe,
    residuals,
    stepped_state,
    sum_of_squares,
)
from truing.estimation.one_thread import on_one_thread

_START_DAMPING = 1e-6
_LEAST_DAMPING = 1e-11  # smaller damping counts as zero
_MOST_DAMPING = 1e12
_CONVERGED_STEP = 1e-10  # squared length of the remaining step in standard deviations, for convergence
_DATUM_STEP = 1.0  # same measure, below which the state is moved into the datum: the next step may be the last
_REUSED_STEP = 1e-4  # same measure of the last step, below which its equations serve for the covariance
_ROUNDING = 1e-15  # relative to the sum of squares


@dataclass(frozen=True)
class Adjustment:
    """An adjusted network: state, residuals and statistics.

    residuals_px (N, 2): measured minus computed, NaN for points that are not in front of the camera. used (N,): rays in
    the adjustment, with their weights (N,). defect (S,): datum defect per pose, with the constraints B (3 p, d)
    per pose. chi2: weighted sum of squares. before: state and reduced equations of the last step, if they are accurate
    enough for the covariance.
    """

    network: Network
    state: NetworkState
    datum: Datum
    residuals_px: Array
    used: Mask
    weights: Array
    iterations: int
    converged: bool
    redundancy: int
    defect: Index
    constraints: tuple[Array, ...]
    chi2: float
    observed: Observed
    before: tuple[NetworkState, Reduced] | None

    @property
    def variance_factor(self) -> float:
        """Weighted sum of squares over the redundancy, sigma0^2: near one if all stated standard deviations are
        true."""
        return self.chi2 / self.redundancy if self.redundancy > 0 else np.nan

    @property
    def layout(self) -> EquationLayout:
        """Places of the unknowns in the equations."""
        return self.observed.layout

    @cached_property
    def covariance(self) -> BundleCovariance:
        """Covariance of all unknowns for sigma0 = 1; multiply by `variance_factor` to scale it by the residuals."""
        state, reduced = self.before or (self.state, None)
        return covariance(self.observed, state, self.constraints, reduced)


@on_one_thread
def adjust(
    network: Network,
    start: NetworkState,
    datum: Datum = "free",
    *,
    used: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    variance_factor: ArrayLike | None = None,
    max_iterations: int = 50,
    decrease_tolerance: float = 0.0,
) -> Adjustment:
    """Return the adjusted network.

    used (N,): rays to adjust, by default all. Images and points without a used ray keep their start values. weights
    (N,) in [0, 1] multiply the information of rays, variance_factor (N,) their covariance. datum: "free" and "minimal"
    ignore known points; with "known" they are observations, and freedoms that they leave are treated as in "free". A
    bar length with uncertainty 0 keeps its stated value. decrease_tolerance: from a start near the minimum, stop after
    the first undamped step that lowers the sum of squares as predicted, up to so much; the result then counts as not
    converged, and 0 asks for full convergence. Raises `UndeterminedNetworkError` for points and images with too few
    rays, points behind cameras at the start, and networks with free directions.
    """
    bars = network.bars
    start = replace(start, bar_length_m=np.where(bars.sigma_m > 0, start.bar_length_m, bars.length_m))
    is_used, weight, observed = _observed(network, datum == "known", used, weights, variance_factor)
    layout = observed.layout
    start_freedoms = freedoms(layout, start)
    constraints = tuple(conditions(free, datum) for free in start_freedoms)
    converged_state = _minimise(observed, start, start_freedoms, constraints, max_iterations, decrease_tolerance)
    state = in_datum(layout, converged_state.state, start, constraints)
    if datum != "minimal":  # inner constraints are those of the adjusted network
        constraints = tuple(conditions(free, datum) for free in freedoms(layout, state))
    defect = np.array([constraint.shape[1] for constraint in constraints])
    observations = 2 * len(layout.rays) + 3 * len(layout.known) + len(layout.distances) + int(np.sum(layout.bar >= 0))
    unknowns = 6 * len(layout.images) + 3 * len(layout.points) + len(layout.common)
    chi2 = _total(observed, state)
    return Adjustment(
        network,
        state,
        datum,
        residuals(network, state),
        is_used,
        weight,
        converged_state.iterations,
        converged_state.converged,
        observations - unknowns + int(defect.sum()),
        defect,
        constraints,
        chi2,
        observed,
        converged_state.before,
    )


def _observed(
    network: Network,
    known: bool,
    used: ArrayLike | None,
    weights: ArrayLike | None,
    variance_factor: ArrayLike | None,
) -> tuple[Mask, Array, Observed]:
    """Mask (N,) of the rays to adjust, their weights (N,), and the observations; ``known``: known points are observed.

    Raises `UndeterminedNetworkError` for points and images with too few rays.
    """
    count = network.rays.count
    weight = np.ones(count) if weights is None else np.asarray(weights, float)
    factor = np.ones(count) if variance_factor is None else np.asarray(variance_factor, float)
    is_used = (np.ones(count, bool) if used is None else np.asarray(used, bool)) & (weight > 0)
    check_determined(network, is_used, known)
    return is_used, weight, observe(network, equation_layout(network, is_used, known), weight, factor)


def _total(observed: Observed, state: NetworkState) -> float:
    """Return the weighted sum of squares of all observations; a rigid distance contributes nothing."""
    misclosure, variance = distances_at(observed, state).misclosure, observed.distance_variance
    is_uncertain = variance > 0
    return sum_of_squares(observed, state) + float(np.sum(misclosure[is_uncertain] ** 2 / variance[is_uncertain]))


@dataclass(frozen=True)
class _ConvergedState:
    """Result of the iterations: state, count, convergence, and `before` as in `Adjustment`."""

    state: NetworkState
    iterations: int
    converged: bool
    before: tuple[NetworkState, Reduced] | None


@dataclass
class _StepDamping:
    """Damping of the steps: it grows after each failure and shrinks with the gain (Nielsen 1999).

    least: damping below which a direction is free. last_length: squared length of the step before, 0 after a failure.
    """

    value: float
    growth: float = 2.0
    least: float = 0.0
    last_length: float = 0.0

    def increase(self) -> None:
        """Raise the damping after a failed step."""
        self.value, self.growth, self.last_length = max(self.value, _LEAST_DAMPING) * self.growth, self.growth * 2, 0.0

    def increase_beyond_singular(self) -> None:
        """Raise the damping after singular equations."""
        is_free = self.value < _START_DAMPING  # a direction is free; the iteration still reaches the minimum
        self.increase()
        self.least = self.value if is_free else self.least

    def decrease(self, length: float, factor: float) -> None:
        """Lower the damping by a factor after a step of a squared length."""
        self.growth, self.last_length = 2.0, length
        self.value *= factor
        self.value = self.value if self.value >= _LEAST_DAMPING else self.least

    def remaining(self, length: float) -> float:
        """Return the squared length of the way after a step, for the contraction of the last two steps."""
        return length * (min(length / self.last_length, 1.0) if self.last_length else 1.0)


def _minimise(
    observed: Observed,
    start: NetworkState,
    start_freedoms: tuple[Freedom, ...],
    constraints: tuple[Array, ...],
    max_iterations: int,
    decrease_tolerance: float,
) -> _ConvergedState:
    """Return the state with the least sum of squares. start_freedoms: freedoms at the start; constraints: conditions B
    (3 p, d) of the datum per pose; decrease_tolerance: as in `adjust`. The last steps are undamped, because a damped
    step underestimates the remaining way along a weak direction."""
    layout, state, is_in_datum, workspace = observed.layout, start, True, ArrayPool()
    equations = normal_equations(observed, state, workspace)
    if not np.isfinite(equations.chi2):
        raise UndeterminedNetworkError(_behind_cameras(observed, state))
    weight, iteration = tie_weights(observed, equations), 0
    damping = _StepDamping(0.0 if decrease_tolerance else _START_DAMPING)
    for iteration in range(1, max_iterations + 1):
        try:
            reduced = eliminate_poses(observed, equations, start_freedoms, weight, damping.value, workspace)
            step = solve(layout, reduced)
        except np.linalg.LinAlgError:
            damping.increase_beyond_singular()
            continue
        trial = stepped_state(layout, state, step)
        merit, predicted, length = _predicted(observed, equations, weight, step, damping.value)
        gain = merit - _merit(observed, trial, weight, step.multipliers)
        if not damping.value and abs(gain - predicted) < decrease_tolerance:
            return _ConvergedState(trial, iteration, False, (state, reduced))
        remaining_length = damping.remaining(length)
        is_converged = remaining_length <= _CONVERGED_STEP + _ROUNDING * merit
        if is_converged and damping.value <= damping.least:
            is_reusable = is_in_datum and not damping.value and length <= _REUSED_STEP
            before = (state, reduced) if is_reusable else None
            return _ConvergedState(trial if gain > 0 else state, iteration, True, before)
        if is_converged or gain > 1e-4 * predicted:
            if gain > 0:
                is_in_datum = remaining_length <= _DATUM_STEP
                state = in_datum(layout, trial, start, constraints) if is_in_datum else trial
                equations = normal_equations(observed, state, workspace)
            damping.decrease(length, 0.0 if is_converged else max(1e-3, 1 - (2 * min(gain / predicted, 1.0) - 1) ** 3))
            continue
        damping.increase()
        if damping.value > _MOST_DAMPING:
            break
    return _ConvergedState(state, iteration, False, None)


def _merit(observed: Observed, state: NetworkState, weight: Array, multipliers: Array) -> float:
    """Return the sum of squares with distances entering by weight and multiplier; it has the minimum of the full
    problem."""
    misclosure = distances_at(observed, state).misclosure
    return sum_of_squares(observed, state) + _distance_merit(observed, misclosure, weight, multipliers)


def _distance_merit(observed: Observed, misclosure: Array, weight: Array, multipliers: Array) -> float:
    variance = tie_variances(observed, weight)
    variance = np.where(np.isfinite(variance), variance, 0.0)
    return float(np.sum(weight * misclosure**2 - 2 * multipliers * misclosure - variance * multipliers**2))


def _predicted(
    observed: Observed, equations: NormalEquations, weight: Array, step: UnknownsStep, damping: float
) -> tuple[float, float, float]:
    """Return the merit before a step, its predicted decrease, and the squared length of the step in standard
    deviations."""
    misclosure = equations.distances.misclosure
    merit = equations.chi2 + _distance_merit(observed, misclosure, weight, step.multipliers)
    layout = observed.layout
    gradient_step = np.sum(step.images * equations.image_sides[..., -1]) + step.common @ equations.common[:, -1]
    gradient_step += np.sum(step.points * equations.point_sides[..., -1])
    distance_change = np.einsum(
        "qi,qi->q", equations.distances.direction, step.points[layout.second] - step.points[layout.first]
    )
    column = layout.bar[observed.network.bars.bar[layout.distances]]
    distance_change[column >= 0] -= step.common[column[column >= 0]]
    gradient_step += np.sum(distance_change * (weight * misclosure - step.multipliers))
    damped = damping * (
        np.einsum("nii,ni,ni", equations.images, step.images, step.images)
        + np.einsum("nii,ni,ni", equations.points, step.points, step.points)
        + np.diagonal(equations.common) @ step.common**2
    )
    return merit, float(gradient_step + damped), float(gradient_step - damped)


def _behind_cameras(observed: Observed, state: NetworkState) -> str:
    """Return the error message that lists the rays whose point is not in front of the camera."""
    rays, rows = observed.network.rays, observed.layout.rays
    xy = project(observed.network, state, rays.image[rows], rays.point[rows])
    behind = rows[~np.isfinite(xy).all(-1)]
    text = ", ".join(f"ray {ray} (image {rays.image[ray]}, point {rays.point[ray]})" for ray in behind[:20])
    return f"the start has {len(behind)} points behind their cameras, expected none: {text}"
