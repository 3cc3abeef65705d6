"""Error of predictions from inputs alone, and the part of it that noise alone explains.

Only three things are removed from measured minus predicted: one motion per epoch common to all groups; local unknowns
that the model does not claim to predict, such as the free rotation of a part about its axis; and the zero that inputs
of one run share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.fit import Fit, linearise
from truing.inference.linear_problem import Whitened
from truing.inference.linearised_model import LinearisedModel
from truing.inference.model import CauseT, Model
from truing.inference.noise import NOISE_PRIOR_FREEDOM
from truing.inference.observations import Frames, Observations

# Newton steps on frames and local unknowns; from the fit of an epoch, two converge.
_ROUNDS = 2
_FLOOR_DRAWS = 24
# p-value at which a cause is rejected because it predicts held-out epochs worse. The variance of this test comes from
# the epochs (or runs) and from the noise, which counts as this many epochs.
_WORSE, _EPOCHS_OF_NOISE = 0.006, 10
# Regularisation of the fit to an epoch that lacks channels, in units of the noise.
_HELD = 1e-3
# Ratio of an error to its noise floor, and probability by chance, from which a model is incomplete; and the fewest
# epochs from which this is decided.
_CLEARLY, _RARE, _FEWEST_EPOCHS = 1.1, 1e-2, 8
_MOST_SENSITIVITIES = 5e7  # numbers, of predicted coordinates to shared unknowns


@dataclass(frozen=True)
class PredictionError(Generic[CauseT]):
    """Measured minus predicted observations (B, K, d), SI, in the measurement's axes, zero where unseen.

    ``frames`` and ``local`` (B, H) are those at the prediction. ``by_fitted`` (B, M, h) are whitened derivatives by
    what is fitted to each epoch. ``model`` predicted, with ``shared`` unknowns (G,).
    """

    gap: Array
    measured: Observations
    whitened: Array  # (B, K, d) the same in units of the noise
    frames: Frames
    local: Array
    by_fitted: Array
    model: Model[CauseT]
    shared: Array

    @cached_property
    def pathways(self) -> Mapping[str, Array]:
        """Derivatives (B, K, d, C) of the observations by each pathway at the prediction."""
        return self.model.pathways(self.shared, self.local)

    @cached_property
    def design_matrix(self) -> Callable[[CauseT], Mapping[str, Array]]:
        """Function that returns a cause's change of each pathway at the prediction."""
        return self.model.design_matrix(self.shared, self.local)

    @cached_property
    def linearised(self) -> LinearisedModel:
        """Model linearised at the prediction; few predictions need it, and it is large."""
        return linearise(self.model.predict, self.measured, self.frames, self.shared, self.local, compact=True)

    def release(self) -> None:
        """Free arrays that few predictions need."""
        for name in ("linearised", "pathways", "design_matrix"):
            self.__dict__.pop(name, None)

    @property
    def is_observed(self) -> Mask:
        """True for observations (B, K) that were measured."""
        return self.measured.is_observed

    def after_step(self, columns: Array) -> PredictionError[CauseT]:
        """Return the error after the prediction moves by whitened columns (B, M) and each epoch is fitted anew."""
        moved = self.whitened.reshape(columns.shape) - columns
        left = without_epoch_unknowns(moved[..., None], self.by_fitted, self.measured, self.model.zero_groups)[..., 0]
        return replace(self, gap=_unwhitened(self.measured, left), whitened=left.reshape(self.whitened.shape))

    def growth_over(self, other: PredictionError[CauseT]) -> float:
        """Return the ratio of the rms of this error to that of another one, over observations seen by both.

        Both are weighted by the other error's noise, because the noise estimate changes with the model.
        """
        weights = other.measured.whitener * (self.is_observed & other.is_observed)[..., None, None]
        squares, squares_before = (float(np.sum((weights @ error.gap[..., None]) ** 2)) for error in (self, other))
        return float(np.sqrt(squares / squares_before)) if squares_before > 0.0 else 1.0

    def log_odds_over(self, other: PredictionError[CauseT]) -> float:
        """Return the log likelihood ratio of this error to another one, over observations seen by both, each with a
        noise of its own."""
        count = self.measured.size * int(np.sum(self.is_observed & other.is_observed))
        return -count * float(np.log(max(self.growth_over(other), 1e-300)))

    @property
    def squares(self) -> Array:
        """Whitened sum of squares of each epoch (B,)."""
        return np.asarray(np.sum(self.whitened**2, (1, 2)))

    @property
    def rms_by_epoch(self) -> Array:
        """Root mean square per coordinate of each epoch (B,), SI, zero where nothing was seen."""
        return np.asarray(
            np.sqrt(np.sum(self.gap**2, (1, 2)) / np.maximum(self.measured.size * self.is_observed.sum(1), 1))
        )

    @property
    def largest_by_epoch(self) -> Array:
        """Length of the largest error in each epoch (B,), SI."""
        return np.asarray(np.sqrt(np.max(np.sum(self.gap**2, -1), 1)))

    @property
    def rms(self) -> float | None:
        """Root mean square per coordinate, SI; None where nothing was seen."""
        return self.rms_of(slice(None))

    def rms_of(self, channels: Integers | slice) -> float | None:
        """Return the root mean square per coordinate of some channels; None where none of them was seen."""
        count = self.measured.size * int(self.is_observed[:, channels].sum())
        return float(np.sqrt(np.sum(self.gap[:, channels] ** 2) / count)) if count else None

    @property
    def largest(self) -> float | None:
        """Length of the largest error, SI; None where nothing was seen."""
        return float(self.largest_by_epoch.max()) if self.is_observed.any() else None


def merged(
    errors: Sequence[PredictionError[CauseT]], block: Integers, measured: Observations
) -> PredictionError[CauseT]:
    """Return the errors of all epochs, each epoch from the element of ``errors`` that ``block`` (B,) names."""
    rows = np.arange(len(block))

    def chosen(arrays: list[Array]) -> Array:
        return np.asarray(np.stack(arrays)[block, rows])

    frames = replace(errors[0].frames, R=chosen([e.frames.R for e in errors]), t=chosen([e.frames.t for e in errors]))
    return replace(
        errors[0],
        measured=measured,
        frames=frames,
        gap=chosen([e.gap for e in errors]),
        whitened=chosen([e.whitened for e in errors]),
        local=chosen([e.local for e in errors]),
        by_fitted=chosen([e.by_fitted for e in errors]),
    )


def prediction_error(
    model: Model[CauseT],
    measured: Observations,
    frames: Frames,
    shared: Array,
) -> PredictionError[CauseT]:
    """Return the error of the prediction from inputs; local unknowns that the model does not predict are fitted."""
    unpredicted = model.unpredicted
    free_columns = np.concatenate([np.ones(frames.size, bool), unpredicted])
    local = np.zeros((len(measured.values), len(unpredicted)))
    for _ in range(_ROUNDS if free_columns.any() else 0):
        at = linearise(model.predict, measured, frames, shared, local, by_shared=False)
        step = _fit(at.by_local[..., free_columns], at.residual[..., None])[..., 0]
        frames = frames.moved(step[:, : frames.size])
        local[:, unpredicted] += step[:, frames.size :]
    at = linearise(model.predict, measured, frames, shared, local, by_shared=False)
    fitted = at.by_local[..., free_columns]
    zero_groups = model.zero_groups
    rest = (
        at.residual
        if zero_groups is None
        else without_epoch_unknowns(at.residual[..., None], fitted, measured, zero_groups)[..., 0]
    )
    whitened, gap = rest.reshape(measured.values.shape), _unwhitened(measured, rest)
    return PredictionError(gap, measured, whitened, frames, local, fitted, model, shared)


def predicts_worse(
    without: PredictionError[CauseT] | None,
    with_cause: PredictionError[CauseT] | None,
    covered: Mask,
) -> bool:
    """Return True if held-out epochs that a cause covers (B,) are predicted significantly worse, in a paired test.

    Epochs of one error group count as one.
    """
    if without is None or with_cause is None:
        return False
    from scipy.special import stdtrit

    error_groups = with_cause.model.error_groups
    groups = np.arange(len(covered)) if error_groups is None else error_groups
    groups = np.unique(groups[covered], return_inverse=True)[1]
    if not len(groups) or groups.max() < 1:
        return False
    whitener = (
        without.measured.whitener * with_cause.is_observed[..., None, None]
    )  # one weighting for both: refits change the noise
    former, latter = (np.einsum("bkij,bkj->bki", whitener, error.gap)[covered] for error in (without, with_cause))
    worse = np.bincount(groups, np.sum(latter**2 - former**2, (1, 2)))
    of_noise = 4.0 * np.bincount(groups, np.sum((latter - former) ** 2, (1, 2))).mean()
    freedom = len(worse) - 1 + _EPOCHS_OF_NOISE
    variance = (np.sum((worse - worse.mean()) ** 2) + _EPOCHS_OF_NOISE * of_noise) / freedom
    return bool(worse.mean() > stdtrit(freedom, 1.0 - _WORSE) * np.sqrt(variance / len(worse)))


def _unwhitened(measured: Observations, rows: Array) -> Array:
    """Return whitened rows (B, M) as distances (B, K, d), SI, zero where an observation is missing."""
    gap = np.linalg.solve(_square(measured), rows.reshape(*measured.values.shape, 1))[..., 0]
    return np.where(measured.is_observed[..., None], gap, 0.0)


@dataclass(frozen=True)
class NoiseFloor:
    """Mean square (K,) per coordinate of each channel that noise alone causes in a prediction error, SI; counts
    ``observations`` (K,)."""

    square: Array
    observations: Integers

    def rms_of(self, channels: Integers | slice = slice(None)) -> float:
        """Return the root mean square per coordinate of some channels."""
        count = self.observations[channels]
        return float(np.sqrt(np.sum(self.square[channels] * count) / max(count.sum(), 1)))


def is_beyond_floor(error: PredictionError[CauseT], floor: NoiseFloor) -> bool:
    """Return True if a prediction error exceeds its noise floor by 10 %, beyond chance and wrongly declared noise.

    Both together do so once in 100 campaigns.

    Then an effect is missing. Declared noise is known to 10 %, as in `noise_level`. Each channel counts in units of its
    floor. Errors of one epoch have parts in common: how many independent numbers an epoch holds follows from the
    scatter of its mean square.
    """
    from scipy.special import fdtrc

    known = error.is_observed & (floor.square > 0.0)
    counts = known.sum(1)
    epochs = counts > 0
    if epochs.sum() < _FEWEST_EPOCHS:
        return False
    mean_squares = np.sum(error.gap**2, 2) / error.measured.size / np.where(floor.square > 0.0, floor.square, 1.0)
    squares = np.sum(np.where(known, mean_squares, 0.0), 1)[epochs] / counts[epochs]
    total, spread = float(np.average(squares, weights=counts[epochs])), float(squares.std(ddof=1))
    independent = max(1.0, 2.0 * (float(squares.mean()) / spread) ** 2) if spread > 0.0 else 1.0
    freedom = independent * len(squares)
    return total > _CLEARLY**2 and bool(fdtrc(freedom, NOISE_PRIOR_FREEDOM, total) < _RARE)


@dataclass(frozen=True)
class DeclaredNoise:
    """Covariance (B, K, d, d) of the observations, SI, and noise of the inputs over that of the fit."""

    covariance: Array
    inputs: float = 1.0


def noise_floor(
    model: Model[CauseT], fit: Fit, measured: Observations, declared: DeclaredNoise, rng: np.random.Generator
) -> NoiseFloor:
    """Return the prediction error of a fitted model that declared noise alone causes.

    Draws of all noise go through the linearised fit: noise of observations, inputs and known shared unknowns. The fit's
    own noise may be estimated from the same residuals.
    """
    whitened, problem = fit.whitened, fit.whitened.problem
    epochs, count = problem.residual.shape
    root = _square(measured) @ np.linalg.cholesky(declared.covariance)
    drawn = rng.standard_normal((epochs, count, _FLOOR_DRAWS)).reshape(*measured.values.shape, _FLOOR_DRAWS)
    noise = (root @ drawn).reshape(epochs, count, _FLOOR_DRAWS) * problem.present[..., None]
    prior = rng.standard_normal((*problem.local_value.shape, _FLOOR_DRAWS)) * problem.local_known[:, None]
    inputs = np.concatenate([np.zeros(fit.frames.size, bool), ~model.unpredicted])
    prior[:, inputs] *= declared.inputs
    error = _shared_error(whitened, noise, prior, rng)
    left = noise - problem.moved(error)
    left -= problem.by_local[..., inputs] @ prior[:, inputs]
    freed = without_epoch_unknowns(left, problem.by_local[..., ~inputs], measured, model.zero_groups)
    gap = np.linalg.solve(_square(measured), freed.reshape(*measured.values.shape, _FLOOR_DRAWS))
    observations = measured.is_observed.sum(0)
    square = np.sum(np.mean(gap**2, (2, 3)) * measured.is_observed, 0) / np.maximum(observations, 1)
    return NoiseFloor(square, observations)


def fit_squares(error: PredictionError[CauseT], covariance: Array) -> Array | None:
    """Return the mean square (B,) per coordinate, SI, that the uncertainty of the fit alone causes in a prediction
    error; None where it would take too much memory.

    covariance: that of the shared unknowns (G, G), in prior sigmas.
    """
    count, size = len(covariance), error.measured.size
    if error.gap.size * count > _MOST_SENSITIVITIES:
        return None
    values, vectors = np.linalg.eigh(covariance)
    moved = error.linearised.moved(vectors * np.sqrt(np.maximum(values, 0.0)))
    left = without_epoch_unknowns(moved, error.by_fitted, error.measured, error.model.zero_groups)
    gap = np.linalg.solve(_square(error.measured), left.reshape(*error.measured.values.shape, count))
    squares = np.sum(gap**2, (2, 3)) * error.is_observed
    return np.asarray(squares.sum(1) / np.maximum(size * error.is_observed.sum(1), 1))


def without_epoch_unknowns(rows: Array, columns: Array, measured: Observations, zero_groups: Integers | None) -> Array:
    """Return whitened rows (B, M, D) without the projection on each epoch's columns (B, M, h), or on the
    zeros of runs."""
    if zero_groups is None:
        return np.asarray(rows - columns @ _fit(columns, rows))
    weight = np.where(measured.is_observed & (zero_groups >= 0), measured.whitener[..., 0, 0], 0.0).ravel()
    return _without_zeros(rows.reshape(len(weight), -1), weight, np.maximum(zero_groups, 0).ravel()).reshape(rows.shape)


def _without_zeros(rows: Array, weight: Array, zero_groups: Integers) -> Array:
    """Return rows (N, D) without the zero shared by rows of one group number (N,), which acts with weight (N,)."""
    norm = np.bincount(zero_groups, weight**2)
    sums = np.stack([np.bincount(zero_groups, weight * column) for column in rows.T], -1)
    shared = sums / np.where(norm > 0.0, norm, 1.0)[:, None]
    return np.asarray(rows - weight[:, None] * shared[zero_groups])


def _shared_error(whitened: Whitened, noise: Array, prior: Array, rng: np.random.Generator) -> Array:
    """Return the errors (G, D) of the shared unknowns caused by noise (B, M, D) and prior noise (B, H, D)."""
    of_local = whitened.without_local(np.concatenate([noise, prior], 1)).reshape(-1, noise.shape[-1])
    random_part = rng.standard_normal((len(whitened.residual) - len(of_local), noise.shape[-1]))
    random_part *= whitened.present[len(of_local) :, None]
    return whitened.fitted(np.concatenate([of_local, random_part]))


def _fit(columns: Array, rows: Array) -> Array:
    """Return the coefficients (B, h, D) of rows (B, M, D) on columns (B, M, h), regularised where an epoch lacks
    channels."""
    size = columns.shape[-1]
    if not size:
        return np.zeros((len(columns), 0, rows.shape[-1]))
    held = np.broadcast_to(_HELD * np.eye(size), (len(columns), size, size))
    basis, factor = np.linalg.qr(np.concatenate([columns, held], 1))
    return np.linalg.solve(factor, np.swapaxes(basis[:, : columns.shape[1]], 1, 2) @ rows)


def _square(measured: Observations) -> Array:
    """Return the whitener (B, K, d, d) with the identity where an observation is missing."""
    return np.where(measured.is_observed[..., None, None], measured.whitener, np.eye(measured.size))
