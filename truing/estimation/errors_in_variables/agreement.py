"""Which poses agree with one another, on a linearised problem: all or nothing, so that good poses lose no efficiency.

A pose is judged by what the agreeing ones predict of it without it: the chi-square of its equations against their own
noise and that of the prediction (with its redundancy therefore), over the noise level of the others: exactly an F
ratio. Every set ends as a fixpoint: the poses that pass against the rest of the set. It grows from the half that is
nearest to a fit in which no pose counts for more than its distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Probability that a campaign without bad poses loses any of its poses.
FALSE_ALARM = 0.005
# Share of a pose's noise that is left in its residual where nothing else holds some value: not a test.
_REDUNDANT = 1e-6
_RESISTANT_ROUNDS = 15
_RESISTANT_SETTLED = 0.05
_FREE_ROUNDS = 10  # afterwards no pose comes back, so that it ends
_STUDENT = 2.0  # degrees of freedom of the tails that a resistant fit expects
# Mean square of the nearest half, in declared variances, from which on other halves are tried as well.
_SUSPICIOUS = 9.0
_STARTS, _CONCENTRATIONS = 40, 5
_LEAST_DAMPING = 1e-13


@dataclass(frozen=True)
class LinearPoses:
    """Whitened equations ``residual + jacobian step`` of each pose, and a prior; columns of about unit length."""

    residual: NDArray  # (B, m)
    jacobian: NDArray  # (B, m, P)
    information: NDArray  # (P, P) of the prior
    slope: NDArray  # (P,) half the gradient of its cost

    def fit(self, weight: NDArray) -> PoseFit:
        """Return the fit with weights (B,) of the poses."""
        size = len(self.slope)
        rows = (weight[:, None, None] * self.jacobian).reshape(-1, size)
        normal = rows.T @ self.jacobian.reshape(-1, size) + self.information + _LEAST_DAMPING * np.eye(size)
        step = -np.linalg.solve(normal, rows.T @ self.residual.ravel() + self.slope)
        return PoseFit(self, weight, normal, self.residual + self.jacobian @ step)

    def squares(self, weights: NDArray) -> NDArray:
        """Return the squared lengths (S, B) of the poses' residuals after fits with weights (S, B)."""
        poses, _, size = self.jacobian.shape
        turned = np.swapaxes(self.jacobian, 1, 2)
        normal = (weights @ (turned @ self.jacobian).reshape(poses, -1)).reshape(-1, size, size)
        normal += self.information + _LEAST_DAMPING * np.eye(size)
        slope = weights @ (turned @ self.residual[..., None])[..., 0] + self.slope
        step = -np.linalg.solve(normal, slope[..., None])[..., 0]
        residual = self.residual + (step @ self.jacobian.reshape(-1, size).T).reshape(-1, *self.residual.shape)
        return np.sum(residual**2, -1)


@dataclass(frozen=True)
class PoseFit:
    """A linear fit with weights of the poses."""

    problem: LinearPoses
    weight: NDArray  # (B,)
    normal: NDArray  # (P, P)
    residual: NDArray  # (B, m)

    @property
    def length(self) -> NDArray:
        """Return the length (B,) of each pose's residual."""
        return np.sqrt(np.sum(self.residual**2, -1))

    def trimmed(self, count: int) -> float:
        """Return the sum of squares of the poses of the smallest lengths."""
        return float(np.sum(np.sort(np.sum(self.residual**2, -1))[:count]))

    @property
    def distance(self) -> NDArray:
        """Return the length (B,) of each pose's residual over the middle one."""
        length = self.length
        return length / max(float(np.median(length)), np.finfo(float).tiny)

    def judged(self) -> Judgement:
        """Return how each pose stands to the others, for weights that are 0 or 1."""
        jacobian = self.problem.jacobian
        follows = jacobian @ np.linalg.inv(self.normal) @ np.swapaxes(jacobian, 1, 2)
        return judge(self.residual, follows, self.weight > 0)


@dataclass(frozen=True)
class Judgement:
    """What the poses of a set predict of each pose without it."""

    surprise: NDArray  # (B,) chi-square of the pose against the prediction, at the declared noise
    tested: NDArray  # (B,) its degrees of freedom
    redundancy: NDArray  # (B,) share of the pose's equations that its own residual keeps, summed
    p_value: NDArray  # (B,) chance of such a surprise where the pose is as good as the others
    chi_square: float  # of the set
    freedom: float  # of the set

    @property
    def passes(self) -> NDArray:
        """Return which poses (B,) agree with the set."""
        return self.p_value >= FALSE_ALARM / len(self.p_value)


def judge(residual: NDArray, follows: NDArray, kept: NDArray) -> Judgement:
    """Return how poses stand to the set that was fitted, kept (B,).

    residual (B, m) whitened; follows (B, m, m): the covariance that the fit's values bring into each pose's equations.
    """
    sign = np.where(kept, -1.0, 1.0)[:, None, None]
    spread, axes = np.linalg.eigh(np.eye(residual.shape[1]) + sign * follows)
    along = np.einsum("bmk,bm->bk", axes, residual) ** 2
    seen = spread > _REDUNDANT
    surprise = np.sum(np.divide(along, spread, out=np.zeros_like(along), where=seen), -1)
    redundancy = residual.shape[1] - np.einsum("bmm->b", follows) * kept
    chi_square, freedom = float(np.sum(residual[kept] ** 2)), float(redundancy[kept].sum())
    tested = seen.sum(-1)
    return Judgement(
        surprise,
        tested,
        redundancy,
        _p_values(surprise, tested, kept, chi_square, freedom),
        chi_square,
        freedom,
    )


def _p_values(surprise: NDArray, tested: NDArray, kept: NDArray, chi_square: float, freedom: float) -> NDArray:
    """Return the chances (B,) of surprises against the noise level of the set without the pose itself."""
    from scipy.special import fdtrc

    others = np.maximum(chi_square - kept * surprise, np.finfo(float).tiny)
    left = freedom - kept * tested
    open_to_test = (left > 0.5) & (tested > 0)
    left, count = np.where(open_to_test, left, 1.0), np.maximum(tested, 1)
    with np.errstate(over="ignore"):  # nothing is left of the others: the ratio has no end
        ratio = surprise / count / (others / left)
    return np.where(open_to_test, fdtrc(count, left, ratio), 1.0)


def agreeing(problem: LinearPoses) -> NDArray:
    """Return which poses (B,) agree."""
    kept = _nearest_half(problem)
    for k in range(2 * _FREE_ROUNDS + len(kept)):
        passes = problem.fit(kept.astype(float)).judged().passes
        found = passes if k < _FREE_ROUNDS else passes & kept
        if np.array_equal(found, kept):
            break
        kept = found
    return kept


def _nearest_half(problem: LinearPoses) -> NDArray:
    """Return the half of the poses (B,) nearest to a fit of it, with those that are within the noise which it shows."""
    from scipy.special import chdtrc, chdtri

    poses, equations, size = problem.jacobian.shape
    enough = min(poses, (poses + -(-size // equations) + 1) // 2)
    core = _nearest(_resistant(problem).length, enough)
    if problem.fit(core).trimmed(enough) > _SUSPICIOUS * enough * equations:
        core = _nearest_of_many(problem, core, enough)
    judged = problem.fit(core).judged()
    tested = np.maximum(judged.tested, 1)
    level = np.median(judged.surprise / chdtri(tested, 0.5))
    return (core > 0) | (chdtrc(tested, judged.surprise / level) >= FALSE_ALARM / poses)


def _nearest(length: NDArray, count: int) -> NDArray:
    """Return weights (..., B) that keep the poses of the smallest lengths."""
    weight = np.zeros_like(length)
    np.put_along_axis(weight, np.argsort(length, -1, kind="stable")[..., :count], 1.0, -1)
    return weight


def _nearest_of_many(problem: LinearPoses, core: NDArray, enough: int) -> NDArray:
    """Return the half (B,) that fits itself best of those that fits to few poses lead to.

    Rousseeuw and Van Driessen (1999).
    """
    poses, equations, size = problem.jacobian.shape
    few = min(poses, -(-size // equations) + 1)
    drawn = _nearest(np.random.default_rng(0).random((_STARTS, poses)), few)
    weights = np.concatenate([core[None], drawn])
    for _ in range(_CONCENTRATIONS):
        weights = _nearest(problem.squares(weights), enough)
    trimmed = np.sort(problem.squares(weights), -1)[:, :enough].sum(-1)
    return np.asarray(weights[np.argmin(trimmed)])


def _resistant(problem: LinearPoses) -> PoseFit:
    """Return a fit in which a pose pulls no harder for being further off, and then one in which it pulls less."""
    fit = problem.fit(np.ones(len(problem.residual)))
    for weights in (_no_harder, _less):
        for _ in range(_RESISTANT_ROUNDS):
            fit, before = problem.fit(weights(fit)), fit.weight
            if np.all(np.abs(fit.weight - before) <= _RESISTANT_SETTLED * fit.weight):
                break
    return fit


def _no_harder(fit: PoseFit) -> NDArray:
    """Return the weights (B,) whose fit has the least sum of lengths of the residuals."""
    return 1 / np.maximum(fit.distance, 0.1)


def _less(fit: PoseFit) -> NDArray:
    """Return the weights (B,) of Student's t in as many dimensions as there are equations."""
    equations = fit.residual.shape[1]
    return (_STUDENT + equations) / (_STUDENT + equations * fit.distance**2)
