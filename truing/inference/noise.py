"""Noise level of a campaign by component, with the declared noise as prior, and dependences of the noise.

Observations have a covariance in the axes of the measurement, group by group; inputs and the survey have a factor each.
Otherwise a declared noise that is wrong by 10 % would hide causes, or simulate them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.model import CauseLike
from truing.inference.observations import Observations

Value = TypeVar("Value", float, Array)

# Number of observations for which the declared noise level counts: it is known to about 10 %.
NOISE_PRIOR_FREEDOM = 50.0
# Degrees of freedom of Student's t, by which large residuals are weighted down.
_TAIL = 5.0
_ROUNDS = 5
_LEAST_NOISE = 0.2
# Noise estimates stay within this factor of the declared noise; any larger excess counts as an effect.
_MOST_OFF = 1.5
# A residual is informative about noise if its redundancy is at least this in every direction.
_LEAST_REDUNDANCY = 0.1
# Squares below _LEAST carry no information. A single coordinate is often near zero by chance: with 1 added to its
# square, the logarithm keeps 90 % of the information on the noise, without it 40 %.
_LEAST = 1e-3
_ADDED = {1: 1.0}
# What `log_moments` returns where something is added. They are integrals; loading scipy.integrate takes 0.1 s.
_LOG_MOMENTS = {1: (0.34432045758243846, 2.263360531709506)}
_FEWEST_VALUES = 20
# A direction without any scatter was not measured, as a coordinate that is zero throughout. Its weight would
# grow with every estimate, until the normal equations are singular. In units of the declared noise, the sigma of a
# direction is at least this share of that of the noisiest one.
_LEAST_SHARE = 0.1
# Values of drivers that are compared at a time.
_AT_ONCE = 2**20
_LEAD = math.log(20.0)
# Angles whose squared cosine is the common share, with equal prior probability (Jeffreys' prior of a share). At either
# end a part keeps a thousandth of its prior sigma: invisible in data, but not zero, so a fit can still estimate it.
_END = 1e-3
_ANGLES = np.linspace(0.0, 0.5 * np.pi, 10).clip(_END, 0.5 * np.pi - _END)
_SAME = 0.02  # rad; smaller changes need no new fit


@dataclass(frozen=True)
class NoiseComponents:
    """Degrees of freedom and sums of squares of the noise of observations and of inputs, declared knowledge included.

    ``observed_total`` and ``inputs_total`` are the sums of squares, in units of the noise used for whitening; they
    equal the degrees of freedom if that noise is right.
    """

    observed: float
    inputs: float
    observed_total: float
    inputs_total: float

    def freedom(self, input_share: Value) -> Value:
        """Return the degrees of freedom of a noise estimate of which the share ``input_share`` rests on inputs
        (Satterthwaite); of several estimates from their shares (n,)."""
        return 1.0 / (input_share**2 / self.inputs + (1.0 - input_share) ** 2 / self.observed)

    def without(self, squares: Value, rank: int, input_share: Value) -> Value:
        """Return the variance of the noise, in units of the one used, without the squares that a candidate explains;
        of several candidates of a rank from arrays (n,)."""
        freedom = self.freedom(input_share)
        ratios = self.inputs_total / self.inputs, self.observed_total / self.observed
        level = input_share * ratios[0] + (1.0 - input_share) * ratios[1]
        variance: Value = np.maximum((level * freedom - squares) / np.maximum(freedom - rank, 1.0), _LEAST_NOISE)
        return variance


def components(whitened: Whitened, observed: int, inputs: slice) -> NoiseComponents:
    """Return the noise of a fit by component: the first ``observed`` rows of an epoch, and its inputs' priors."""
    squares, freedom = _by_row(whitened)
    epochs, height = len(whitened.problem.residual), observed + whitened.problem.local_value.shape[1]
    observations = np.s_[: epochs * height]
    square, free = (values[observations].reshape(epochs, height) for values in (squares, freedom))
    rows = slice(observed + inputs.start, observed + inputs.stop)
    prior = NOISE_PRIOR_FREEDOM
    others = float(np.sum(squares) - square[:, rows].sum()), float(np.sum(freedom) - free[:, rows].sum())
    return NoiseComponents(
        prior + others[1], prior + float(free[:, rows].sum()), prior + others[0], prior + float(square[:, rows].sum())
    )


def _by_row(whitened: Whitened) -> tuple[Array, Array]:
    """Return the squared residual and the degrees of freedom (N,) of every row; zero for rows without information."""
    present = whitened.present
    return np.where(present, whitened.rest**2, 0.0), np.where(present, 1.0 - whitened.leverage, 0.0)


def input_squares(whitened: Whitened, observed: int, inputs: slice) -> tuple[float, float]:
    """Return the sum of squares of the inputs' residuals, in units of the noise used, and its degrees of freedom."""
    squares, freedom = _by_row(whitened)
    epochs, height = len(whitened.problem.residual), observed + whitened.problem.local_value.shape[1]
    rows = np.s_[observed + inputs.start : observed + inputs.stop]
    sums = [values[: epochs * height].reshape(epochs, height)[:, rows].sum() for values in (squares, freedom)]
    return float(sums[0]), float(sums[1])


def input_ratio(whitened: Whitened, observed: int, inputs: slice, used: float) -> float:
    """Return the inputs' noise over the declared one (Foerstner's estimate); ``used``: the ratio used in the fit."""
    return _ratio(*input_squares(whitened, observed, inputs), used)


def survey_ratio(whitened: Whitened, places: Integers, used: float) -> float:
    """Return the survey's noise over the declared one; ``places`` are its rows among all rows (N,)."""
    squares, freedom = _by_row(whitened)
    robust = np.minimum(squares[places], 9.0 * freedom[places])  # a channel that was displaced is not noise
    return _ratio(float(robust.sum()), float(freedom[places].sum()), used)


def _ratio(squares: float, freedom: float, used: float) -> float:
    """Return a noise ratio with the declared noise as prior, limited to `_MOST_OFF`: residuals of an effect are not
    noise."""
    variance = (NOISE_PRIOR_FREEDOM + squares * used**2) / (NOISE_PRIOR_FREEDOM + freedom)
    return float(np.clip(np.sqrt(variance), 1.0 / _MOST_OFF, _MOST_OFF))


def rescaled_noise(whitened: Whitened, measured: Observations, groups: Integers, declared: Array) -> Observations:
    """Return the observations with covariances as estimated from a fit, group by group, in the measurement's axes.

    ``groups`` (K,) numbers each channel's group. Large residuals, which effects cause, have little weight (Student's
    t). In units of the ``declared`` covariances (B, K, d, d), no direction falls below `_LEAST_SHARE` of another.
    """
    rest, redundancy = informative_residuals(whitened, measured.values.shape)
    axes = np.eye(measured.size)
    scatter = _scatter(rest[measured.is_observed], redundancy[measured.is_observed], axes)
    observations = []
    for group in range(groups.max() + 1):
        rows = measured.is_observed & (groups == group)
        observations.append(_scatter(rest[rows], redundancy[rows], scatter))
    used = np.linalg.inv(measured.whitener + axes * ~measured.is_observed[..., None, None])
    covariance = used @ np.stack(observations)[groups] @ np.swapaxes(used, -1, -2)
    seen = measured.is_observed
    covariance[seen] = _balanced(covariance[seen], declared[seen])
    return replace(measured, covariance=np.where(seen[..., None, None], covariance, measured.covariance))


def _balanced(covariance: Array, declared: Array) -> Array:
    """Return covariances (n, d, d) whose sigmas, in units of the declared ones, differ between directions by a
    factor of 1 / `_LEAST_SHARE` at most."""
    root = np.linalg.cholesky(declared)
    inverse = np.linalg.inv(root)
    size, axes = np.linalg.eigh(inverse @ covariance @ np.swapaxes(inverse, -1, -2))
    if (size[:, 0] >= _LEAST_SHARE**2 * size[:, -1]).all():
        return covariance
    turned = root @ axes
    least = _LEAST_SHARE**2 * size[..., -1:]
    return np.asarray(turned * np.maximum(size, least)[..., None, :] @ np.swapaxes(turned, -1, -2))


def informative_residuals(whitened: Whitened, shape: tuple[int, int, int]) -> tuple[Array, Array]:
    """Return the observations' whitened residuals (B, K, d) and their redundancy matrices (B, K, d, d)."""
    epochs, count, size = shape
    height = size * count + whitened.problem.local_value.shape[1]
    rest = whitened.rest[: epochs * height].reshape(epochs, height)[:, : size * count].reshape(shape)
    return rest, np.eye(size) - whitened.taken_in_blocks(count, size)


def _scatter(residuals: Array, redundancy: Array, prior: Array) -> Array:
    """Return the robust scatter matrix of the noise behind residuals (n, d) with ``redundancy`` (n, d, d). The prior
    counts as `NOISE_PRIOR_FREEDOM` values. In directions without redundancy (as across a group of three channels), the
    noise is the average one."""
    size = residuals.shape[1]
    amount, axes = np.linalg.eigh(np.sum(redundancy, 0))
    share = np.maximum(np.trace(redundancy, axis1=1, axis2=2) / size, 0.05)
    amount, known, consistent = np.maximum(amount, 0.0), NOISE_PRIOR_FREEDOM / size, _consistent(size)
    scatter = prior
    for _ in range(_ROUNDS):
        square = np.einsum("ni,ij,nj->n", residuals, np.linalg.inv(scatter), residuals) / share
        weight = (_TAIL + size) / (_TAIL + square)
        weighted = axes.T @ np.einsum("n,ni,nj->ij", weight, residuals, residuals) @ axes / consistent
        level = (known * np.trace(prior) + np.trace(weighted)) / (size * known + amount.sum())
        prior_part = known * prior * level / np.mean(np.diag(prior))
        root = np.sqrt(known + amount)
        scatter = axes @ ((axes.T @ prior_part @ axes + weighted) / np.outer(root, root)) @ axes.T
    return scatter


@lru_cache(maxsize=8)
def _consistent(size: int) -> float:
    """Return the expected weighted scatter of unit normals along an axis: E[(5 + d) q / (5 + q)] / d, q chi-square of
    d."""
    from scipy.special import erfcx, exp1

    # E[1 / (5 + q)] = E_k(z) exp(z) / 2 with k = d / 2, z = 5 / 2, and the exponential integral E_k (DLMF 8.19).
    z, order = _TAIL / 2, 1.0 - size % 2 / 2
    integral = np.sqrt(np.pi / z) * erfcx(np.sqrt(z)) if size % 2 else np.exp(z) * exp1(z)
    while order < size / 2:
        integral, order = (1.0 - z * integral) / order, order + 1.0
    return float((_TAIL + size) * (1.0 - z * integral) / size)


@dataclass(frozen=True)
class NoiseLevel:
    """Noise found over the declared one, its standard deviation, and its p-value if the declared noise is right to 10
    %."""

    ratio: float
    sigma: float
    p_value: float


def noise_level(
    whitened: Whitened, measured: Observations, declared: Array, channels: Mask | None = None
) -> NoiseLevel:
    """Return the noise of a fit's observations over the declared covariances (B, K, d, d).

    ``channels`` (K,) or (B, K) selects observations; ``measured`` holds the covariances used in the fit. The log of the
    ratio is tested, one-sided.
    """
    epochs, count = measured.is_observed.shape
    is_observed = measured.is_observed if channels is None else measured.is_observed & channels
    size = measured.size
    height = size * count + whitened.problem.local_value.shape[1]

    def of_observations(rows: Array) -> Array:
        of_epochs = rows[: epochs * height].reshape(epochs, height)[:, : size * count]
        return np.asarray(of_epochs.reshape(epochs, count, size)[is_observed])

    used, promised = measured.covariance[is_observed], declared[is_observed]
    change = np.linalg.solve(np.linalg.cholesky(promised), np.linalg.cholesky(used))
    rest = np.einsum("nij,nj->ni", change, of_observations(whitened.rest))
    freedom = float(np.sum(1.0 - of_observations(whitened.leverage)))
    ratio = float(np.sqrt(np.sum(rest**2) / freedom))
    spread = math.sqrt(0.5 / NOISE_PRIOR_FREEDOM + 0.5 / freedom)
    p_value = 0.5 * math.erfc(math.log(ratio) / spread / math.sqrt(2.0))
    return NoiseLevel(ratio, ratio * math.sqrt(0.5 / freedom), p_value)


@dataclass(frozen=True)
class Driver:
    """A quantity on which the noise may depend: values (B, K), name, and its column of the configurations.

    ``within`` (K,) numbers groups whose mean is removed: single channels for what varies over epochs, groups of
    channels for what varies over channels. ``channels`` are set where the noise of single channels is tested, ``cause``
    where a cause makes the noise larger where values are 1.
    """

    name: str
    values: Array | Mask
    within: Integers
    column: str = ""
    channels: tuple[int, ...] = ()
    cause: CauseLike | None = None

    @property
    def is_one_sided(self) -> bool:
        """True if the noise can only be larger where values are larger."""
        return bool(self.channels) or self.cause is not None


@dataclass(frozen=True)
class NoiseDependence:
    """A dependence of the noise on a driver, with a p-value corrected for all drivers tried.

    ``ratio``, with ``sigma``: the largest noise over the smallest. ``factor`` (B, K): each observation's noise over the
    typical one. ``doubt``: the reason why a cause of it is only suspected (a value of ``Reason``), empty where it is
    found.
    """

    driver: Driver
    p_value: float
    ratio: float
    sigma: float
    factor: Array
    doubt: str = ""


def standardised(residuals: Array, redundancy: Array) -> Array:
    """Return residuals (B, K, d) scaled to unit noise, NaN where the redundancy is too small.

    ``redundancy`` (B, K, d, d) is the covariance of the whitened residuals ``residuals`` if the noise is unit noise.
    """
    amount, axes = np.linalg.eigh(redundancy)
    enough = amount[..., 0] > _LEAST_REDUNDANCY
    scaled = np.einsum("bkij,bki->bkj", axes, residuals) / np.sqrt(np.maximum(amount, _LEAST_REDUNDANCY))
    return np.where(enough[..., None], scaled, np.nan)


def drivers(covariates: Mapping[str, Array], shape: Array, groups: Integers) -> list[Driver]:
    """Return the quantities on which the noise may depend: columns (B,) and their squares, the place on the group, a
    channel.

    shape (K, 3) in m, groups (K,) numbers of the channels' groups.
    """
    channels = np.arange(len(shape))
    epochs = next((len(values) for values in covariates.values()), 0)
    possible = []
    for name, values in covariates.items():
        if values.ndim == 1 and np.isfinite(values).all() and np.ptp(values) > 0:
            x = 2 * (values - values.min()) / np.ptp(values) - 1
            for power in (x, x**2 - np.mean(x**2)):
                possible.append(Driver(name, np.broadcast_to(power[:, None], (len(power), len(shape))), channels, name))
    for axis, values in zip("xyz", shape.T, strict=False):  # numbers have no place
        possible.append(Driver(f"the place along {axis}", np.broadcast_to(values, (epochs, len(shape))), groups))
    for channel in channels:
        values = np.broadcast_to(channels == channel, (epochs, len(shape)))
        possible.append(Driver("", values, np.zeros(len(shape), int), "", (int(channel),)))
    return possible


def noise_dependence(residuals: Array, candidates: Sequence[Driver], level: float) -> NoiseDependence | None:
    """Return the strongest dependence of the noise behind standardised residuals (B, K, d); None where p exceeds the
    level.

    NaN marks observations that were not seen. p-values are corrected for the number of candidates (Bonferroni).
    """
    square = np.sum(residuals**2, -1)
    known = np.isfinite(square)
    if known.sum() < _FEWEST_VALUES or not candidates:
        return None
    size = residuals.shape[-1]
    squares = np.maximum(np.nan_to_num(square) + _ADDED.get(size, 0.0), _LEAST)
    follows, spread = log_moments(size)
    logs = np.where(known, np.log(squares) / follows, 0.0)
    within = {driver.within.tobytes(): driver.within for driver in candidates}
    centred = {key: _minus_group_means(logs, known, groups) for key, groups in within.items()}
    scores = _slopes(centred, known, candidates, spread)
    # By the log likelihood. A cause must be clearly likelier than a column, because a column may be correlated with it.
    gains = [_gain(score, driver) for score, driver in zip(scores, candidates, strict=True)]
    best = int(np.argmax(gains))
    strength = _strength(scores[best], candidates[best])
    tails = 1.0 if candidates[best].is_one_sided else 2.0
    p_value = min(1.0, tails * 0.5 * math.erfc(max(strength, 0.0) / math.sqrt(2.0)) * len(candidates))
    if p_value > level:
        return None
    if candidates[best].cause is not None:  # squares locate the epochs better than their logarithms
        squares = np.where(known, square, np.nan)
        likely = [
            0.0 if candidate.cause is None else variance_gain(squares, candidate.values > 0.5)
            for candidate in candidates
        ]
        return larger_where(candidates[int(np.argmax(likely))], residuals, p_value)
    return _noise_dependence(candidates[best], scores[best], known, p_value)


@lru_cache(maxsize=8)
def log_moments(size: int) -> tuple[float, float]:
    """Return the slope of E[log(q + added)] by the log of the noise variance, and the variance of the log over that
    slope squared. q is chi-square of ``size`` degrees of freedom."""
    from scipy.special import polygamma

    return _LOG_MOMENTS[size] if size in _LOG_MOMENTS else (1.0, float(polygamma(1, size / 2)))


def _slopes(
    centred: Mapping[bytes, Array], known: Mask, candidates: Sequence[Driver], spread: float
) -> list[tuple[float, float]]:
    """Return the slope of logarithms along each driver, and its standard deviation. ``centred``: logarithms (B, K)
    less their group means, by groups. The variance of the logarithms is taken to be at least ``spread``."""
    scores = [(0.0, math.inf)] * len(candidates)
    alike: dict[bytes, list[int]] = {}
    for number, driver in enumerate(candidates):
        alike.setdefault(driver.within.tobytes(), []).append(number)
    for key, numbers in alike.items():
        y, groups = centred[key], candidates[numbers[0]].within
        variance = max(float(np.sum(y**2) / max(known.sum() - len(np.unique(groups)), 1)), spread)
        at_once = max(_AT_ONCE // y.size, 1)
        for first in range(0, len(numbers), at_once):
            chunk = numbers[first : first + at_once]
            values = np.array([candidates[number].values for number in chunk], float)
            x = _minus_group_means(values, known, groups).reshape(len(chunk), -1)
            least = 1e-12 * np.maximum(np.sum(values**2, (1, 2), where=known), 1e-300)
            along, sizes = x @ y.ravel(), np.sum(x**2, 1)
            for number, product, size, lowest in zip(chunk, along, sizes, least, strict=True):
                if size > lowest:
                    scores[number] = float(product / size), math.sqrt(variance / size)
    return scores


def _strength(score: tuple[float, float], driver: Driver) -> float:
    """Return a slope over its standard deviation, without its sign for two-sided drivers."""
    ratio = score[0] / score[1]
    return ratio if driver.is_one_sided else abs(ratio)


def variance_gain(square: Array, selected: Mask) -> float:
    """Return the gain in log likelihood of squares (B, H) by a separate, larger variance for ``selected`` (B, H)."""
    known = np.isfinite(square)
    inside, outside = square[known & selected], square[known & ~selected]
    if not len(inside) or not len(outside) or inside.mean() <= outside.mean():
        return 0.0
    parts = (np.concatenate([inside, outside]), 1.0), (inside, -1.0), (outside, -1.0)
    return float(sum(sign * len(part) / 2.0 * math.log(max(part.mean(), 1e-12)) for part, sign in parts))


def scale_gain(square: Array, selected: Mask) -> float:
    """Return the gain in log likelihood of squares (B, H) of unit variance by a larger variance of ``selected`` (B,
    H)."""
    inside = square[np.isfinite(square) & selected]
    ratio = max(float(inside.mean()), 1.0) if len(inside) else 1.0
    return len(inside) / 2.0 * (ratio - 1.0 - math.log(ratio))


def _gain(score: tuple[float, float], driver: Driver) -> float:
    """Return the gain in log likelihood by a slope, less the lead that a cause must have."""
    strength = _strength(score, driver)
    return math.copysign(strength**2 / 2.0, strength) - (_LEAD if driver.cause is not None else 0.0)


def _minus_group_means(values: Array | Mask, known: Mask, groups: Integers) -> Array:
    """Return values (..., B, K) without the mean of their group of channels; zero where not known."""
    known_values = np.where(known, values, 0.0)
    number = np.unique(groups, return_inverse=True)[1]
    members = np.eye(number.max(initial=0) + 1)[number]
    mean = (known_values.sum(-2) @ members) / np.maximum(known.sum(0) @ members, 1)
    return np.where(known, known_values - mean[..., None, number], 0.0)


def larger_where(driver: Driver, residuals: Array, p_value: float) -> NoiseDependence:
    """Return the ratio of standardised residuals (B, K, d) where a driver is 1 to those elsewhere of the same
    ``within``."""
    selected, known = driver.values > 0.5, np.isfinite(residuals).all(-1)
    compared = ~selected & np.isin(driver.within, driver.within[selected.any(0)])
    inside, outside = residuals[selected & known], residuals[compared & known]
    ratio = math.sqrt(float(np.mean(inside**2)) / max(float(np.mean(outside**2)), _LEAST**2))
    share = math.sqrt(0.5 / inside.size + 0.5 / outside.size)
    return NoiseDependence(driver, p_value, ratio, ratio * share, np.where(selected, ratio, 1.0))


def _noise_dependence(driver: Driver, score: tuple[float, float], known: Mask, p_value: float) -> NoiseDependence:
    x = _minus_group_means(driver.values, known, driver.within)
    away = np.where(np.isfinite(driver.values), driver.values, 0.0) - driver.values[known].mean()
    reach = 0.5 * float(np.ptp(x[known]))
    ratio = math.exp(abs(score[0]) * reach)
    factor = np.exp(0.5 * score[0] * away)
    return NoiseDependence(driver, p_value, ratio, ratio * score[1] * reach, factor)


def merged_by_driver(dependences: Sequence[NoiseDependence]) -> list[NoiseDependence]:
    """Return one dependence for each driver: those found later on the same quantity multiply the earlier ones."""
    merged: dict[tuple[object, ...], NoiseDependence] = {}
    for single_dependence in dependences:
        key = (single_dependence.driver.name, single_dependence.driver.channels, single_dependence.driver.cause)
        merged[key] = _product(merged[key], single_dependence) if key in merged else single_dependence
    return list(merged.values())


def _product(first: NoiseDependence, second: NoiseDependence) -> NoiseDependence:
    factor = first.factor * second.factor
    ratio = float(factor.max() / factor.min())
    share = math.hypot(first.sigma / first.ratio, second.sigma / second.ratio)
    p_value = min(first.p_value, second.p_value)
    return replace(first, p_value=p_value, ratio=ratio, sigma=ratio * share, factor=factor)


def estimated_share(shift: Array, covariance: Array, common: Mask, share: float) -> float:
    """Return the common share of the variance of like parts, averaged over its posterior; the present one if nearly
    equal.

    Parameters, of which ``common`` (P,) belong to all parts; moved by shift (P,) and have covariance (P, P), both in
    prior sigmas at the present share.
    """
    precision = np.linalg.inv(covariance)
    information, moved = precision - np.eye(len(shift)), precision @ shift
    present = _angle(share)
    evidence = np.array([_log_evidence(information, moved, _widths(common, value, present)) for value in _ANGLES])
    weights = np.exp(evidence - evidence.max())
    angle = float(weights @ _ANGLES / weights.sum())
    return share if abs(angle - present) < _SAME else float(np.cos(angle) ** 2)


def _angle(share: float) -> float:
    return float(np.arccos(np.sqrt(share)))


def _widths(common: Mask, angle: float, present: float) -> Array:
    """Return the ratio of the prior sigmas (P,) at an angle to those at the present one."""
    return np.asarray(np.where(common, np.cos(angle) / np.cos(present), np.sin(angle) / np.sin(present)))


def _log_evidence(information: Array, moved: Array, width: Array) -> float:
    """Return the log evidence for prior sigmas (P,) from data with ``information`` (P, P) and score ``moved``."""
    posterior = np.eye(len(width)) + width[:, None] * information * width
    score = width * moved
    return float(0.5 * (score @ np.linalg.solve(posterior, score) - np.linalg.slogdet(posterior)[1]))
