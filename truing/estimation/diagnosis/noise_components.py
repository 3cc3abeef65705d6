"""How large the noise of a campaign really is, component by component, with what was declared as prior knowledge.

Points have a covariance in the axes of the measurement, body by body; readings and the survey a factor each. A declared
noise that is wrong by a tenth would otherwise make clean campaigns look wrong, and faulty ones clean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.point_fit import MeasuredPoints
from truing.estimation.diagnosis.whitening import Whitened

# How many observations the declared noise level counts for: known to about 10 %.
NOISE_PRIOR_FREEDOM = 50.0
# Residuals count less from here on, as those of Student's t with so many degrees of freedom do.
_TAIL = 5.0
_ROUNDS = 5
_LEAST_NOISE = 0.2
# A declared noise may be wrong by this factor before what exceeds it counts as an effect.
_MOST_OFF = 1.5


@dataclass(frozen=True)
class NoiseComponents:
    """Degrees of freedom behind the noise of points and of readings, declared knowledge included, and their totals.

    ``points_total`` and ``readings_total`` are the sums of squares found, in units of the noise used for whitening,
    declared knowledge included; they equal the degrees of freedom where that noise is right.
    """

    points: float
    readings: float
    points_total: float
    readings_total: float

    def freedom(self, reading_share: float) -> float:
        """Return the degrees of freedom of an estimate that rests on readings by a share (Satterthwaite)."""
        return 1.0 / (reading_share**2 / self.readings + (1.0 - reading_share) ** 2 / self.points)

    def without(self, squares: float, rank: int, reading_share: float) -> float:
        """Return the variance of the noise, in units of the one used, once a candidate's squares are taken out."""
        freedom = self.freedom(reading_share)
        ratios = self.readings_total / self.readings, self.points_total / self.points
        level = reading_share * ratios[0] + (1.0 - reading_share) * ratios[1]
        return max((level * freedom - squares) / max(freedom - rank, 1.0), _LEAST_NOISE)


def components(whitened: Whitened, points: int, readings: slice) -> NoiseComponents:
    """Return the noise of a fit by component: the first ``points`` rows of a pose, and its readings' priors."""
    squares, freedom = _by_row(whitened)
    poses, height = len(whitened.problem.residual), points + whitened.problem.local_value.shape[1]
    own = np.s_[: poses * height]
    square, free = (values[own].reshape(poses, height) for values in (squares, freedom))
    rows = slice(points + readings.start, points + readings.stop)
    prior = NOISE_PRIOR_FREEDOM
    others = float(np.sum(squares) - square[:, rows].sum()), float(np.sum(freedom) - free[:, rows].sum())
    return NoiseComponents(
        prior + others[1], prior + float(free[:, rows].sum()), prior + others[0], prior + float(square[:, rows].sum())
    )


def _by_row(whitened: Whitened) -> tuple[NDArray, NDArray]:
    """Return the squared residual and the degrees of freedom (N,) of every row that says something."""
    present = whitened.present
    return np.where(present, whitened.rest**2, 0.0), np.where(present, 1.0 - whitened.leverage, 0.0)


def reading_ratio(whitened: Whitened, points: int, readings: slice, used: float) -> float:
    """Return the readings' noise over the declared one (Foerstner's estimate), ``used`` times which was used."""
    squares, freedom = _by_row(whitened)
    poses, height = len(whitened.problem.residual), points + whitened.problem.local_value.shape[1]
    rows = np.s_[points + readings.start : points + readings.stop]
    own = [values[: poses * height].reshape(poses, height)[:, rows].sum() for values in (squares, freedom)]
    return _ratio(float(own[0]), float(own[1]), used)


def survey_ratio(whitened: Whitened, places: NDArray, used: float) -> float:
    """Return the survey's noise over the declared one, from its rows' places among all rows (N,)."""
    squares, freedom = _by_row(whitened)
    robust = np.minimum(squares[places], 9.0 * freedom[places])  # a target that was moved is no noise
    return _ratio(float(robust.sum()), float(freedom[places].sum()), used)


def _ratio(squares: float, freedom: float, used: float) -> float:
    """Return a noise level, with the declared one as prior; held near it, since what an effect leaves is no noise."""
    variance = (NOISE_PRIOR_FREEDOM + squares * used**2) / (NOISE_PRIOR_FREEDOM + freedom)
    return float(np.clip(np.sqrt(variance), 1.0 / _MOST_OFF, _MOST_OFF))


def rescaled_points(whitened: Whitened, measured: MeasuredPoints, bodies: NDArray) -> MeasuredPoints:
    """Return the points with their covariances brought to what a fit found, body by body, in the measurement's axes.

    ``bodies`` (K,) numbers each target's body. Residuals of an effect count little (Student's t).
    """
    rest, told = told_points(whitened, measured.points.shape)
    axes = np.eye(measured.size)
    whole = _scatter(rest[measured.seen], told[measured.seen], axes)
    own = []
    for body in range(bodies.max() + 1):
        rows = measured.seen & (bodies == body)
        own.append(_scatter(rest[rows], told[rows], whole))
    declared = np.linalg.inv(measured.whitener + axes * ~measured.seen[..., None, None])
    covariance = declared @ np.stack(own)[bodies] @ np.swapaxes(declared, -1, -2)
    return replace(measured, covariance=np.where(measured.seen[..., None, None], covariance, measured.covariance))


def told_points(whitened: Whitened, shape: tuple[int, int, int]) -> tuple[NDArray, NDArray]:
    """Return the points' whitened residuals, of shape (B, K, d), and how much of each point's noise they tell
    (B, K, d, d)."""
    poses, count, size = shape
    height, width = size * count + whitened.problem.local_value.shape[1], whitened.basis.shape[1]

    def of_points(rows: NDArray, width: int) -> NDArray:
        own = rows[: poses * height].reshape(poses, height, width)[:, : size * count]
        return own.reshape(poses, count, size, width)

    basis = of_points(whitened.basis, width)
    local = whitened.local_basis[:, : size * count].reshape(*shape, whitened.local_basis.shape[-1])
    told = np.eye(size) - local @ np.swapaxes(local, -1, -2) - basis @ np.swapaxes(basis, -1, -2)
    return of_points(whitened.rest, 1)[..., 0], told


def _scatter(rest: NDArray, told: NDArray, prior: NDArray) -> NDArray:
    """Return the scatter matrix of the noise behind residuals (n, d), of which they tell ``told`` (n, d, d); robust.

    The prior counts as `NOISE_PRIOR_FREEDOM` values. Where residuals tell nothing (across a body of three targets), the
    noise is taken to be what it is on average.
    """
    size = rest.shape[1]
    amount, axes = np.linalg.eigh(np.sum(told, 0))
    share = np.maximum(np.trace(told, axis1=1, axis2=2) / size, 0.05)
    amount, known, consistent = np.maximum(amount, 0.0), NOISE_PRIOR_FREEDOM / size, _consistent(size)
    found = prior
    for _ in range(_ROUNDS):
        square = np.einsum("ni,ij,nj->n", rest, np.linalg.inv(found), rest) / share
        weight = (_TAIL + size) / (_TAIL + square)
        own = axes.T @ np.einsum("n,ni,nj->ij", weight, rest, rest) @ axes / consistent
        level = (known * np.trace(prior) + np.trace(own)) / (size * known + amount.sum())
        held = known * prior * level / np.mean(np.diag(prior))
        root = np.sqrt(known + amount)
        found = axes @ ((axes.T @ held @ axes + own) / np.outer(root, root)) @ axes.T
    return found


@lru_cache(maxsize=8)
def _consistent(size: int) -> float:
    """Return what the weighted scatter of so many unit normals comes to along an axis: E[(5 + d) q / (5 + q)] / d, q
    the sum of their squares."""
    from scipy.integrate import quad
    from scipy.special import gammaln

    def weighed(q: float) -> float:
        density = np.exp((size / 2 - 1) * np.log(q) - q / 2 - size / 2 * np.log(2.0) - gammaln(size / 2))
        return float(density * (_TAIL + size) * q / (_TAIL + q))

    return float(quad(weighed, 0.0, np.inf)[0] / size)
