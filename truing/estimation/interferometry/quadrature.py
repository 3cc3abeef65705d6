"""Quadrature signals of an interferometer: ellipse fit, phase correction, fringe counting, and length.

Signals are ``x = x0 + a cos p, y = y0 + b sin(p + lag)``: offsets, unequal gains and a lag from quadrature cause errors
of the plain arctangent with one or two periods per fringe. P. L. M. Heydemann, Appl. Opt. 20 (1981) 3382.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.arrays import Array, Mask
from truing.estimation.least_squares.solver import SolverStatus, least_squares

PARAMETERS = ("x0", "y0", "a", "b", "lag")
_NEAREST_STEPS = 6  # Newton steps to the nearest point of the ellipse
_MOST_ITERATIONS = 40  # an arc that determines the ellipse needs about ten
_FEWEST = 10  # samples, twice the number of parameters
_ROUND = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)
_CONSTRAINT = np.array([[0.0, 0.0, 0.5], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]])  # inverse of that of 4ac - b^2 = 1
_TURN = 2.0 * np.pi


class EllipseStatus(StrEnum):
    """Status of an ellipse fit, with the remedy."""

    OK = "ok"
    SHORT_ARC = "short-arc"
    NO_ELLIPSE = "no-ellipse"
    FEW_SAMPLES = "few-samples"

    @property
    def remedy(self) -> str:
        """Advice for the reader of the status, in one sentence."""
        return _REMEDIES[self]


_REMEDIES = {
    EllipseStatus.OK: "Nothing to do.",
    EllipseStatus.SHORT_ARC: "The signals trace too little of the ellipse to fix it: move through a whole fringe, or "
    "take the correction of another run of the same channel.",
    EllipseStatus.FEW_SAMPLES: "Too few samples to estimate the noise about the ellipse: take ten or more.",
    EllipseStatus.NO_ELLIPSE: "The signals lie on no ellipse: look at the offsets, the gains and the wiring.",
}


@dataclass(frozen=True)
class EllipseFit:
    """Ellipses of B channels.

    values (B, 5): x0, y0, a, b in the unit of the signals, lag in rad; covariance (B, 5, 5), and sigma (B,): noise of
    one signal, both from the scatter about the ellipse; arc (B,) rad of the ellipse with signals; phase_sigma (B,) rad:
    largest standard error of the correction on the circle.
    """

    values: Array
    covariance: Array
    sigma: Array
    arc: Array
    phase_sigma: Array
    status: NDArray[np.str_]

    @property
    def ok(self) -> Mask:
        """Mask (B,) of channels with a reliable correction everywhere on the circle."""
        return np.asarray(self.status == str(EllipseStatus.OK), bool)


def fit_ellipse(signals: Array, used: Mask | None = None, largest_phase_sigma: float = 0.05) -> EllipseFit:
    """Return ellipses with least distances of the samples (maximum likelihood for equal noise of both signals).

    signals (B, N, 2) or (N, 2); used (B, N): by default all finite ones. The status is ``short-arc`` if the correction
    is less certain than ``largest_phase_sigma`` rad (one sigma) anywhere on the circle, or without a minimum.
    """
    signals = np.asarray(signals, float)
    signals = signals[None] if signals.ndim == 2 else signals
    finite = np.asarray(np.isfinite(signals).all(-1))
    weight = (finite if used is None else finite & np.broadcast_to(used, finite.shape)).astype(float)
    filled = np.where(finite[..., None], signals, 0.0)
    solution = least_squares(_distances, ellipse_start(filled, weight), filled, weight, max_iterations=_MOST_ITERATIONS)
    freedom = np.maximum(weight.sum(-1) - len(PARAMETERS), 1.0)
    sigma = np.sqrt(solution.cost / freedom)
    covariance = solution.covariance * sigma[:, None, None] ** 2
    values = _positive(solution.x)
    arc = traced_arc(corrected_phase(filled, values), weight > 0.0)
    spread = np.sqrt(_correction_variance(values, covariance, _ROUND).max(-1))
    few, converged = weight.sum(-1) < _FEWEST, solution.status == SolverStatus.CONVERGED
    shaped, sharp = np.isfinite(values).all(-1), converged & (spread <= largest_phase_sigma)
    words = ("FEW_SAMPLES", "NO_ELLIPSE", "SHORT_ARC", "OK")
    reported = [np.str_(EllipseStatus[word]) for word in words]
    status: NDArray[np.str_] = np.select([few, ~shaped, ~sharp], reported[:3], reported[3])
    return EllipseFit(values, covariance, sigma, arc, np.where(converged, spread, np.inf), status)


def _positive(values: Array) -> Array:
    """Return the same ellipses with positive amplitudes and the lag nearest to zero."""
    out = values.copy()
    out[:, 4] += np.pi * ((values[:, 2] < 0.0) ^ (values[:, 3] < 0.0))
    out[:, 2:4] = np.abs(values[:, 2:4])
    out[:, 4] = (out[:, 4] + np.pi) % (2.0 * np.pi) - np.pi
    return out


def _distances(values: Array, signals: Array, weight: Array) -> tuple[Array, Array]:
    """Return signed distances (B, N) of the samples from their ellipses, and the derivatives (B, N, 5)."""
    p = corrected_phase(signals, values)
    for _ in range(_NEAREST_STEPS):
        point, first, second = _curve(values, p)
        off = point - signals
        slope = np.sum(first * first + off * second, -1)
        p = p - np.sum(off * first, -1) / np.where(slope > 0.0, slope, np.sum(first * first, -1))
    point, along, _ = _curve(values, p)
    normal = np.stack([along[..., 1], -along[..., 0]], -1) / np.linalg.norm(along, axis=-1, keepdims=True)
    distance = np.sum(normal * (signals - point), -1)
    by_value = _sort_by_value(values, p)
    return weight * distance, -weight[..., None] * np.einsum("bnk,bnkp->bnp", normal, by_value)


def _curve(values: Array, p: Array) -> tuple[Array, Array, Array]:
    """Return points (B, N, 2) at phases (B, N), and their first and second derivatives."""
    x0, y0, a, b, lag = values.T[..., None]
    turn = p + lag
    point = np.stack([x0 + a * np.cos(p), y0 + b * np.sin(turn)], -1)
    first = np.stack([-a * np.sin(p), b * np.cos(turn)], -1)
    return point, first, np.stack([-a * np.cos(p), -b * np.sin(turn)], -1)


def _sort_by_value(values: Array, p: Array) -> Array:
    """Return the derivatives (B, N, 2, 5) of the points at fixed phases."""
    b, lag = values[:, 3, None], values[:, 4, None]
    out = np.zeros((*p.shape, 2, 5))
    out[..., 0, 0] = out[..., 1, 1] = 1.0
    out[..., 0, 2], out[..., 1, 3] = np.cos(p), np.sin(p + lag)
    out[..., 1, 4] = b * np.cos(p + lag)
    return out


def corrected(signals: Array, values: Array) -> Array:
    """Return cos p, sin p (..., N, 2) of signals (..., N, 2) by ellipses (..., 5): a unit circle apart from noise."""
    x0, y0, a, b, lag = np.moveaxis(np.asarray(values, float), -1, 0)[..., None]
    cosine = (signals[..., 0] - x0) / a
    sine = ((signals[..., 1] - y0) / b - cosine * np.sin(lag)) / np.cos(lag)
    return np.stack([cosine, sine], -1)


def corrected_phase(signals: Array, values: Array) -> Array:
    """Return phases (..., N) in rad, within one turn."""
    circle = corrected(signals, values)
    return np.arctan2(circle[..., 1], circle[..., 0])


def residual_radius(signals: Array, values: Array, used: Mask | None = None) -> Array:
    """Return the standard deviation (...) of the corrected radius, in the unit of the signals."""
    radius = np.linalg.norm(corrected(signals, values), axis=-1) * np.sqrt(np.prod(values[..., 2:4], -1))[..., None]
    return np.std(radius, axis=-1, where=True if used is None else used)


def phase_sigma(fit: EllipseFit, phase: Array) -> Array:
    """Return the standard deviation (B, N) in rad of corrected phases (B, N), from the noise of the sample and of the
    fit."""
    _, _, a, b, lag = fit.values.T[..., None]
    by_noise = (np.sin(phase + lag) / a) ** 2 + (np.cos(phase) / b) ** 2
    by_noise = fit.sigma[:, None] ** 2 * by_noise / np.cos(lag) ** 2
    return np.sqrt(by_noise + _correction_variance(fit.values, fit.covariance, phase))


def _correction_variance(values: Array, covariance: Array, phase: Array) -> Array:
    """Return the variance (B, N) in rad^2 of corrected phases (N,) or (B, N) due to uncertain ellipses."""
    _, _, a, b, lag = values.T[..., None]
    p = np.broadcast_to(phase, (len(values), np.shape(phase)[-1]))
    sine, cosine = np.sin(p + lag), np.cos(p)
    by_value = [sine / a, -cosine / b, sine * cosine / a, -sine * cosine / b, -cosine * np.cos(p + lag)]
    slopes = np.stack(by_value, -1) / np.cos(lag)[..., None]
    return np.einsum("bni,bij,bnj->bn", slopes, covariance, slopes)


def uncorrected_error(values: Array, phase: Array) -> Array:
    """Return the periodic error (B, N) in rad of the plain arctangent at phases (N,), about its mean."""
    point = _curve(values, np.broadcast_to(phase, (len(values), np.shape(phase)[-1])))[0]
    off = np.exp(1j * (np.arctan2(point[..., 1], point[..., 0]) - phase))
    return np.angle(off / off.mean(-1, keepdims=True))


def traced_arc(phase: Array, used: Mask) -> Array:
    """Return the part of the circle (B,) covered by phases (B, N), in rad: a turn minus the widest gap between them."""
    within = phase % (2.0 * np.pi)
    last = np.max(np.where(used, within, -np.inf), axis=-1, keepdims=True, initial=-np.inf)
    turned = np.sort(np.where(used, within, np.where(used.any(-1, keepdims=True), last, 0.0)), axis=-1)
    inner = np.max(np.diff(turned, axis=-1), axis=-1, initial=0.0)
    around = 2.0 * np.pi - (turned[:, -1] - turned[:, 0])
    return np.where(used.any(-1), 2.0 * np.pi - np.maximum(inner, around), 0.0)


def ellipse_start(signals: Array, weight: Array) -> Array:
    """Return start values (B, 5): x0, y0, a, b, lag of ``x = x0 + a cos p, y = y0 + b sin(p + lag)``; NaN without a
    fit.

    signals (B, N, 2), weight (B, N) 0 or 1. A. Fitzgibbon, M. Pilu and R. Fisher (1999), solved as R. Halíř and J.
    Flusser (1998). Biased towards small ellipses on short arcs, so it is only a start.
    """
    total = np.maximum(weight.sum(-1), 1.0)[:, None]
    centre = np.einsum("bn,bnk->bk", weight, signals) / total
    size = np.sqrt(np.einsum("bn,bnk->bk", weight, (signals - centre[:, None]) ** 2) / total)
    size = np.where(size > 0.0, size, 1.0)
    conic = _conic((signals - centre[:, None]) / size[:, None], weight)
    shape = _shape(conic)
    return np.column_stack([centre + size * shape[:, :2], size * shape[:, 2:4], shape[:, 4]])


def _conic(z: Array, weight: Array) -> Array:
    """Return the coefficients (B, 6) of x^2, xy, y^2, x, y, 1."""
    x, y = z[..., 0], z[..., 1]
    quadratic = weight[..., None] * np.stack([x * x, x * y, y * y], -1)
    linear = weight[..., None] * np.stack([x, y, np.ones_like(x)], -1)
    S1, S2, S3 = (np.swapaxes(left, 1, 2) @ right for left, right in _pairs(quadratic, linear))
    T = -np.linalg.pinv(S3, hermitian=True) @ np.swapaxes(S2, 1, 2)
    vectors = np.real(np.linalg.eig(_CONSTRAINT @ (S1 + S2 @ T))[1])
    definite = 4.0 * vectors[:, 0] * vectors[:, 2] - vectors[:, 1] ** 2
    best = np.take_along_axis(vectors, definite.argmax(1)[:, None, None], 2)[..., 0]
    return np.concatenate([best, np.einsum("bij,bj->bi", T, best)], -1)


def _pairs(quadratic: Array, linear: Array) -> tuple[tuple[Array, Array], ...]:
    return (quadratic, quadratic), (quadratic, linear), (linear, linear)


def _shape(conic: Array) -> Array:
    """Return x0, y0, a, b, lag (B, 5) of conics (B, 6)."""
    A, B, C, D, E, F = conic.T
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = 4.0 * A * C - B**2
        x0, y0 = (B * E - 2.0 * C * D) / determinant, (B * D - 2.0 * A * E) / determinant
        level = -(F + 0.5 * (D * x0 + E * y0))
        # z' Q z = 1 with Q^-1 = [[a^2, a b sin lag], [., b^2]]
        a, b = np.sqrt(4.0 * C * level / determinant), np.sqrt(4.0 * A * level / determinant)
        lag = np.arcsin(np.clip(-2.0 * B * level / determinant / (a * b), -1.0, 1.0))
    return np.column_stack([x0, y0, a, b, lag])


@dataclass(frozen=True)
class Count:
    """Phases (..., N) unwrapped to whole turns, in rad.

    risk (..., N): probability that the step to a sample is wrong by a turn, if the motion stays below half a turn per
    sample.
    """

    phase: Array
    risk: Array

    @property
    def doubtful(self) -> Mask:
        """Mask (..., N) of steps with a risk above one in a thousand."""
        return self.risk > 1e-3


def count_fringes(phase: ArrayLike, sigma: ArrayLike, *, steady: bool = False) -> Count:
    """Return phases (..., N), known within a turn to sigma rad (..., N) or one number, unwrapped to whole turns.

    Each step is taken as the shortest one; if ``steady``, as the one nearest to the step before. This follows faster
    motion while its speed changes by less than half a turn per sample. A missing sample (NaN) loses the
    count: all later ones are missing too.
    """
    phase = np.asarray(phase, float)
    sigma = np.broadcast_to(np.asarray(sigma, float), phase.shape)
    step = _minus_whole_turns(np.diff(phase, axis=-1))
    noise = np.hypot(sigma[..., 1:], sigma[..., :-1])
    left = step
    if steady:  # the changes of the step are unwrapped like a phase, and summed
        left = np.concatenate([step[..., :1], _minus_whole_turns(np.diff(step, axis=-1))], axis=-1)
        step = np.cumsum(left, axis=-1)
        noise = _noise_of_changes(sigma)
    risk = _miscount_probability(left, noise)
    followed = np.concatenate([phase[..., :1], phase[..., :1] + np.cumsum(step, axis=-1)], axis=-1)
    return Count(followed, np.concatenate([np.zeros_like(phase[..., :1]), risk], axis=-1))


def _minus_whole_turns(step: Array) -> Array:
    """Return steps minus their whole turns: from -pi to pi."""
    return step - _TURN * np.round(step / _TURN)


def _noise_of_changes(sigma: Array) -> Array:
    """Return the standard deviation (..., N - 1) of the change from one step to the next; for the first step, its
    own."""
    first = np.hypot(sigma[..., 1:2], sigma[..., :1])
    later = np.sqrt(sigma[..., 2:] ** 2 + 4.0 * sigma[..., 1:-1] ** 2 + sigma[..., :-2] ** 2)
    return np.concatenate([first, later], axis=-1)


def _miscount_probability(left: Array, noise: Array) -> Array:
    """Return the probability that noise moved a step, counted as ``left``, over half a turn. True steps up to half a
    turn are equally likely."""
    from scipy.special import ndtr

    with np.errstate(divide="ignore", invalid="ignore"):
        margin = (np.pi - np.abs(left)) / noise
    return np.asarray(ndtr(-np.where(np.isnan(margin), 0.0, margin)))


def misstep_probability(step: ArrayLike, sigma: ArrayLike) -> Array:
    """Return the probability that a true step in rad is counted wrong; sigma rad: noise of each phase."""
    from scipy.special import ndtr

    step, noise = np.asarray(step, float), np.sqrt(2.0) * np.asarray(sigma, float)
    return np.asarray(ndtr((step - np.pi) / noise) + ndtr((-step - np.pi) / noise))


def length_per_turn(wavelength_m: ArrayLike, index: ArrayLike = 1.0, passes: int = 2) -> Array:
    """Return the length in m per turn of phase.

    Light travels the way to the mirror ``passes`` times, back and forth: 2 for a plain interferometer, 4 for one with
    plane mirrors.
    """
    return np.asarray(wavelength_m, float) / np.asarray(index, float) / passes


def length_from_phase(phase: ArrayLike, wavelength_m: ArrayLike, index: ArrayLike = 1.0, passes: int = 2) -> Array:
    """Return lengths in m of unwrapped phases in rad, with the index of air of each sample."""
    return np.asarray(phase, float) / _TURN * length_per_turn(wavelength_m, index, passes)
