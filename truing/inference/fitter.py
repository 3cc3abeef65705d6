"""Fitter of a campaign's model: it keeps the noise levels and the gross errors found so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.blocks import EpochBlocks, possible_blocks
from truing.inference.fit import Fit, fit_model, shared_without
from truing.inference.fitted_model import FittedModel, epoch_height, observation_residuals
from truing.inference.model import CampaignModel, CauseT, ConditionsLike, ConditionsT, Model, ScatterCandidate
from truing.inference.noise import (
    NoiseDependence,
    drivers,
    estimated_share,
    input_ratio,
    larger_where,
    noise_dependence,
    rescaled_noise,
    survey_ratio,
)
from truing.inference.observations import Epochs, Observations
from truing.inference.prediction import PredictionError, merged, prediction_error
from truing.inference.scatter import (
    SETTLED,
    FoundScatter,
    drivers_of,
    likeliest_scatter,
    overlapping_candidates,
    scattering,
    unbiased,
)
from truing.inference.screening import gross_errors

# Most repetitions of gross-error screening and noise estimation before the search.
_PREPARATIONS = 3
# Scatter counts as smaller than its prior by this many standard deviations, and by this share at least.
_SMALLER, _SMALLER_AT_LEAST = 2.0, 0.1
_SAME_NOISE = 0.05
_FAR_BETTER = 0.5  # residual over the one for which an observation was excluded, from which causes explain it
# Most repetitions of the estimate of the inputs' scatter.
_MOST_SCALINGS = 8
# Where no epoch is held out: blocks of epochs left out in turn, fewest epochs in a block, most observations.
_BLOCKS, _FEWEST_IN_BLOCK, _MOST_VALUES = 5, 4, 20_000


@dataclass(frozen=True)
class ScreenedValue:
    """An observation excluded as a gross error: its row and channel in `Epochs`, and its whitened residual."""

    row: int
    channel: int
    held_out: bool
    length: float  # in units of the noise estimated at that time


class Fitter(Generic[CauseT]):
    """Fits a campaign's model with any causes; keeps the noise estimates and the gross errors found so far."""

    def __init__(
        self,
        model: CampaignModel[CauseT, ConditionsT],
        calibration: Epochs[ConditionsT],
        held_out: Epochs[ConditionsT] | None,
        seed: int,
        progress: Callable[[str], None] = lambda what: None,
    ) -> None:
        self.model: Model[CauseT] = model
        self.calibration: Epochs[ConditionsLike] = calibration
        self.held_out: Epochs[ConditionsLike] | None = held_out
        self._declared: Model[CauseT] = model
        self._held_out_model: Model[CauseT] | None = None if held_out is None else model.at(held_out.conditions)
        self.declared = calibration.measured.covariance
        self._ratios = 1.0, 1.0
        self._input_factor: Array = np.ones((1, 1))
        self._seed, self._progress = seed, progress
        self._recorded = calibration.measured.is_observed, None if held_out is None else held_out.measured.is_observed
        self.screened: list[ScreenedValue] = []  # observations taken out as gross errors

    @property
    def repeats(self) -> Integers | None:
        """Numbers (B,) of commands that were given more than once, -1 for the others."""
        return self.calibration.repeats

    @property
    def blocks(self) -> list[EpochBlocks] | None:
        """Groupings of epochs that can be left out block by block; None where the campaign declares no groupings."""
        groupings = self.calibration.groupings
        return None if groupings is None else possible_blocks(groupings, len(self.calibration.measured.is_observed))

    def prepared(
        self, causes: tuple[CauseT, ...] = (), start: FittedModel[CauseT] | None = None
    ) -> FittedModel[CauseT]:
        """Return the converged fit with some causes, with its prediction error on epochs that were left out."""
        return self.predicted(self.converged(causes, start))

    def predicted(self, fitted: FittedModel[CauseT]) -> FittedModel[CauseT]:
        """Return a fit with its prediction error on epochs that were left out, held out or in turn."""
        return fitted if fitted.held_out is not None else replace(fitted, held_out=self._left_out_in_turn(fitted))

    def converged(
        self, causes: tuple[CauseT, ...] = (), start: FittedModel[CauseT] | None = None
    ) -> FittedModel[CauseT]:
        """Return the fit with some causes after gross errors are screened and the noise is estimated."""
        fitted = self.fitted(causes, start)
        for _ in range(_PREPARATIONS):
            screened = self.screen(fitted)
            if not self.learn_noise(fitted) and not screened:
                break
            fitted = self.fitted(causes, fitted)
        return self.fitted(causes, fitted) if self._readmit_patterns(fitted) else fitted

    def fitted(self, causes: tuple[CauseT, ...], start: FittedModel[CauseT] | None = None) -> FittedModel[CauseT]:
        """Return the fit of the model with some causes, started from another fit."""
        return self._fitted(causes, self.model, self.calibration.measured, self._ratios, start)

    def comparable(self, causes: tuple[CauseT, ...], other: FittedModel[CauseT]) -> FittedModel[CauseT]:
        """Return the fit with some causes to the observations and the noise of another fit, so that their sums of
        squares compare. Noise estimated since then is that of other causes."""
        return self._fitted(causes, other.model, other.measured, other.learned, other)

    def _fitted(
        self,
        causes: tuple[CauseT, ...],
        plain: Model[CauseT],
        measured: Observations,
        ratios: tuple[float, float],
        start: FittedModel[CauseT] | None,
    ) -> FittedModel[CauseT]:
        self._progress("fitting " + (", ".join(cause.id for cause in causes) or "the plain simulation"))
        model = plain.with_causes(causes)
        frames = self.calibration.frames
        shared = self.model.embedded(np.empty(0), model)
        local: Array = np.zeros((len(frames.t), model.local_size))
        if start is not None:
            shared = start.model.embedded(start.fit.shared, model)
            if start.fit.local.shape == local.shape:  # a fit to other epochs knows nothing of theirs
                local, frames = start.fit.local, start.fit.frames
        fit = fit_model(model.predict, measured, frames, shared, local)
        held_out = self._predicted(causes, fit, ratios)
        return FittedModel(causes, model, measured, fit, held_out, self._seed, ratios, self.declared)

    def _predicted(
        self, causes: tuple[CauseT, ...], fit: Fit, ratios: tuple[float, float]
    ) -> PredictionError[CauseT] | None:
        epochs = self.held_out
        if epochs is None or self._held_out_model is None:
            return None
        model = self._held_out_model.rescaled(*ratios).with_causes(causes)
        return prediction_error(model, epochs.measured, epochs.frames, fit.shared)

    def _left_out_in_turn(self, fitted: FittedModel[CauseT]) -> PredictionError[CauseT] | None:
        """Return the prediction error of blocks of epochs, each left out of a fit in turn; for campaigns without
        held-out epochs. None where blocks would have too few epochs, or fits take too long."""
        measured, numbers = fitted.measured, fitted.model.blocks
        if numbers is None or len(numbers) < _BLOCKS * _FEWEST_IN_BLOCK or measured.is_observed.size > _MOST_VALUES:
            return None
        rank = np.unique(numbers, return_inverse=True)[1]
        count = min(_BLOCKS, int(rank.max()) + 1)
        block = rank * count // (rank.max() + 1)
        if count < 2:
            return None
        return merged([self._predicted_block(fitted, block == number) for number in range(count)], block, measured)

    def _predicted_block(self, fitted: FittedModel[CauseT], block: Mask) -> PredictionError[CauseT]:
        """Return the error of the prediction by a fit without the epochs ``block`` (B,)."""
        model, measured, fit = fitted.model, fitted.measured, fitted.fit
        others = replace(measured, is_observed=measured.is_observed & ~block[:, None])
        shared = shared_without(model.predict, others, fit, block)
        return prediction_error(model, measured, fit.frames, shared)

    def screen(self, fitted: FittedModel[CauseT]) -> bool:
        """Exclude gross errors of a fit, on held-out epochs too; return True if there were any."""
        is_observed, residuals = (
            self.calibration.measured.is_observed,
            observation_residuals(fitted.fit, self.calibration.measured),
        )
        axes = self.calibration.measured.whitener @ fitted.fit.frames.R[:, None]
        axes = axes @ fitted.model.rotations(fitted.fit.shared, fitted.fit.local)
        order = fitted.scene.covariates.get("order")
        wrong = gross_errors(residuals, is_observed, axes, order, fitted.model.zero_groups)
        wrong = self.calibration.removable(wrong)
        self.calibration = self.calibration.without(wrong)
        screened = _screened(wrong, residuals, held_out=False)
        if self.held_out is not None and fitted.held_out is not None:
            unseen = gross_errors(
                fitted.held_out.whitened,
                self.held_out.measured.is_observed,
                zero_groups=fitted.held_out.model.zero_groups,
            )
            unseen = self.held_out.removable(unseen)
            self.held_out = self.held_out.without(unseen)
            screened += _screened(unseen, fitted.held_out.whitened, held_out=True)
        self.screened += screened
        return bool(screened)

    def readmit(self, fitted: FittedModel[CauseT]) -> bool:
        """Keep observations that were excluded as gross errors although a fit with causes explains them; return True if
        there were any.

        The fit did not use them, and predicts them far better than the fit that excluded them: they only show an effect
        more than others do. Neither its prediction nor, for calibration epochs, a fit to them leaves gross errors.
        """
        explained = self._explained_in_fit(fitted)
        predicted = self._explained_in_prediction(fitted)
        self.calibration = self.calibration.with_kept(explained)
        if self.held_out is not None:
            self.held_out = self.held_out.with_kept(predicted)
        self._forget(explained, predicted)
        return bool(explained.any() or predicted.any())

    def _readmit_patterns(self, fitted: FittedModel[CauseT]) -> bool:
        """Keep observations that were excluded as gross errors although they form a pattern where epochs share an
        input; return True if there were any.

        A model without that effect cannot tell gross errors of the same channel, so that no more of it are excluded.
        """
        calibration, held_out = self._patterned(fitted)
        channels = calibration.any(axis=0)
        if held_out.size:
            channels |= held_out.any(axis=0)
        if not channels.any():
            return False
        own = calibration | (self.calibration.measured.is_observed & channels)
        self.calibration = self.calibration.with_kept(own)
        if self.held_out is not None:
            self.held_out = self.held_out.with_kept(held_out | (self.held_out.measured.is_observed & channels))
        self._forget(calibration, held_out)
        return True

    def _patterned(self, fitted: FittedModel[CauseT]) -> tuple[Mask, Mask]:
        """Return the excluded observations of calibration and held-out epochs that form a pattern, by the prediction of
        a fit without them."""
        excluded = self._recorded[0] & ~self.calibration.measured.is_observed
        calibration, held_out = np.zeros(excluded.shape, bool), np.zeros((0, excluded.shape[1]), bool)
        if self.calibration.inputs is not None and excluded.any():
            measured = fitted.measured.with_observed(fitted.measured.is_observed | excluded)
            missed = prediction_error(fitted.model, measured, fitted.fit.frames, fitted.fit.shared)
            calibration = self.calibration.patterned(excluded, missed.whitened)
        if self.held_out is not None and self._recorded[1] is not None and fitted.held_out is not None:
            excluded = self._recorded[1] & ~self.held_out.measured.is_observed
            held_out = np.zeros(excluded.shape, bool)
            if self.held_out.inputs is not None and excluded.any():
                measured = self.held_out.measured.with_observed(self._recorded[1])
                missed = prediction_error(fitted.held_out.model, measured, self.held_out.frames, fitted.fit.shared)
                held_out = self.held_out.patterned(excluded, missed.whitened)
        return calibration, held_out

    def _forget(self, calibration: Mask, held_out: Mask) -> None:
        """Take readmitted observations out of the list of gross errors."""
        self.screened = [
            value
            for value in self.screened
            if not (held_out if value.held_out else calibration)[value.row, value.channel]
        ]

    def _explained_in_fit(self, fitted: FittedModel[CauseT]) -> Mask:
        """Return the excluded observations (B, K) of calibration epochs that a fit explains."""
        measured, fit = fitted.measured, fitted.fit
        excluded = self._recorded[0] & ~self.calibration.measured.is_observed
        if not excluded.any():
            return excluded
        predicted = prediction_error(
            fitted.model, measured.with_observed(measured.is_observed | excluded), fit.frames, fit.shared
        )
        near = excluded & (
            _lengths(predicted.whitened) < _FAR_BETTER * self._screened_lengths(excluded.shape, held_out=False)
        )
        if not near.any():
            return near
        enlarged = measured.with_observed(measured.is_observed | near)
        residuals = observation_residuals(
            fit_model(fitted.model.predict, enlarged, fit.frames, fit.shared, fit.local), enlarged
        )
        return near & ~gross_errors(residuals, enlarged.is_observed, zero_groups=fitted.model.zero_groups)

    def _explained_in_prediction(self, fitted: FittedModel[CauseT]) -> Mask:
        """Return the excluded observations (B, K) of held-out epochs that a fit predicts."""
        if self.held_out is None or fitted.held_out is None or self._recorded[1] is None:
            return np.zeros((0, 0), bool)
        epochs, excluded = self.held_out, self._recorded[1] & ~self.held_out.measured.is_observed
        if not excluded.any():
            return excluded
        model, measured = fitted.held_out.model, epochs.measured.with_observed(self._recorded[1])
        residuals = prediction_error(model, measured, epochs.frames, fitted.fit.shared).whitened
        near = excluded & (_lengths(residuals) < _FAR_BETTER * self._screened_lengths(excluded.shape, held_out=True))
        return near & ~gross_errors(residuals, measured.is_observed, zero_groups=model.zero_groups)

    def _screened_lengths(self, shape: tuple[int, ...], *, held_out: bool) -> Array:
        """Return the lengths of whitened residuals for which observations were excluded, zero for all others."""
        length = np.zeros(shape)
        for value in self.screened:
            if value.held_out is held_out:
                length[value.row, value.channel] = value.length
        return length

    def learn_noise(self, fitted: FittedModel[CauseT]) -> bool:
        """Adopt the noise estimates of a fit and the common share of like parts; return True if either changed."""
        measured, whitened = self.calibration.measured, fitted.fit.whitened
        rescaled = rescaled_noise(whitened, measured, fitted.model.channel_groups, self.declared)
        size = len(whitened.rest) - len(fitted.fit.shared)
        places = size + np.arange(len(fitted.fit.shared))[fitted.model.survey]
        previous = self._ratios
        self._ratios = (
            input_ratio(whitened, epoch_height(measured), fitted.input_rows, previous[0]),
            survey_ratio(whitened, places, previous[1]),
        )
        share_moved = self._learn_share(fitted)
        self.model = self._declared.rescaled(*self._ratios)
        self.calibration = replace(self.calibration, measured=rescaled)
        traces = [np.trace(observations.covariance, axis1=-2, axis2=-1) for observations in (rescaled, measured)]
        steps = [now / old for now, old in zip(self._ratios, previous, strict=True)]
        moved = max(*(abs(step - 1.0) for step in steps), float(np.abs(traces[0] / traces[1] - 1.0).max()))
        return moved > _SAME_NOISE or share_moved

    def _learn_share(self, fitted: FittedModel[CauseT]) -> bool:
        """Adopt a fit's estimate of the variance share that like parts have in common; return True if it changed."""
        split = fitted.model.split
        if split is None:
            return False
        covariance = fitted.fit.whitened.covariance()[np.ix_(split.places, split.places)]
        share = estimated_share(fitted.fit.shared[split.places], covariance, split.common, split.share)
        self._declared = self._declared.with_share(share)
        if self._held_out_model is not None:
            self._held_out_model = self._held_out_model.with_share(share)
        return share != split.share

    def scatter_count(self, fitted: FittedModel[CauseT], kinds: Sequence[CauseT], *, of_inputs: bool) -> int:
        """Return the number of candidates that make inputs, or observations, scatter."""
        return sum(scatter.of_inputs == of_inputs for scatter in _scatters(fitted, kinds))

    def noise_dependence(
        self, fitted: FittedModel[CauseT], kinds: Sequence[CauseT], level: float
    ) -> NoiseDependence | None:
        """Return the dependence of the residual noise with the smallest p-value, None where p exceeds the level."""
        scene = fitted.scene
        columns = {name: np.asarray(values) for name, values in scene.covariates.items()}
        possible = drivers(columns, scene.shape, fitted.model.channel_groups)
        possible += drivers_of([scatter for scatter in _scatters(fitted, kinds) if not scatter.of_inputs])
        return noise_dependence(self.known_residuals(fitted), possible, level)

    def scatter(
        self, fitted: FittedModel[CauseT], kinds: Sequence[CauseT], level: float
    ) -> tuple[ScatterCandidate[CauseT], float] | None:
        """Return the cause that makes inputs scatter most significantly, and its p-value; None where p exceeds the
        level.

        Candidates most of whose inputs already have a wider prior are left out.
        """
        known = self._input_factor > 1.0
        offered = [scatter for scatter in _scatters(fitted, kinds) if scatter.of_inputs]
        candidates = [candidate for candidate in offered if 2 * (known & candidate.own).sum() < candidate.own.sum()]
        residuals = fitted.input_residuals
        return scattering(residuals, candidates, level) if candidates and residuals.rest.size else None

    def widen(
        self, fitted: FittedModel[CauseT], candidate: ScatterCandidate[CauseT], kinds: Sequence[CauseT]
    ) -> ScatterCandidate[CauseT]:
        """Widen the prior sigmas of a candidate's inputs to their estimated scatter, by repeated fits.

        Return the candidate, or a more likely one with at least half its inputs in common, whose inputs are widened
        instead.
        """
        start = self._input_factor
        self._restore_screened()
        wide = self._with_widened_inputs(fitted, candidate.own, start * self._ratios[0])
        near = overlapping_candidates([scatter for scatter in _scatters(fitted, kinds) if scatter.of_inputs], candidate)
        best = likeliest_scatter(wide.input_residuals, near, self._input_factor)
        if best is not candidate:
            first = float(self._input_factor[candidate.own].max())
            self._input_factor = start
            self._with_widened_inputs(wide, best.own, first)
        return best

    def narrow_to(self, fitted: FittedModel[CauseT], candidate: ScatterCandidate[CauseT]) -> bool:
        """Narrow the widened prior sigmas of a candidate's inputs to the scatter that a fit leaves; return False where
        that is no smaller by more than its uncertainty."""
        factor, share = fitted.input_residuals.factor(candidate.own)
        if factor > 1.0 - max(_SMALLER * share, _SMALLER_AT_LEAST):
            return False
        self._with_widened_inputs(fitted, candidate.own, self._input_factor * factor)
        return True

    def narrow(self, factor: Array | None = None) -> None:
        """Reset the prior sigmas of all inputs to the declared ones, or to those widened by factors (B, H)."""
        self._input_factor = np.ones_like(self._input_factor) * (1.0 if factor is None else factor)
        self._declared = self._declared.with_input_factor(self._input_factor)
        self.model = self._declared.rescaled(*self._ratios)

    def _restore_screened(self) -> None:
        """Restore all screened observations: they may have looked wrong only because inputs or noise were trusted too
        much."""
        is_observed, unseen = self._recorded
        self.screened = []
        self.calibration = replace(self.calibration, measured=self.calibration.measured.with_observed(is_observed))
        if self.held_out is not None and unseen is not None:
            self.held_out = replace(self.held_out, measured=self.held_out.measured.with_observed(unseen))

    def _with_widened_inputs(
        self, fitted: FittedModel[CauseT], inputs: Mask, factor: Array | float
    ) -> FittedModel[CauseT]:
        """Widen inputs ``inputs`` (B, H), from given factors on, to their estimated scatter; return the fit."""
        previous, factor = 0.0, np.where(inputs, factor, self._input_factor)
        self._ratios = 1.0, self._ratios[1]  # a larger noise of all inputs may be due to these alone
        for _ in range(_MOST_SCALINGS):
            self._declared = self._declared.with_input_factor(factor)
            self.model = self._declared.rescaled(*self._ratios)
            self._restore_screened()  # an epoch looks wrong while its inputs are trusted too much
            fitted = self.converged(fitted.causes, fitted)
            square = self._mean_square(factor, inputs)
            if abs(square / max(previous, 1e-300) - 1.0) < SETTLED:
                break
            previous = square
            factor = np.where(inputs, factor * fitted.input_residuals.factor(inputs)[0], factor)
        self._input_factor = factor
        return fitted

    def input_scatter(
        self, fitted: FittedModel[CauseT], candidate: ScatterCandidate[CauseT], p_value: float
    ) -> FoundScatter[CauseT]:
        """Return the scatter of a candidate's inputs beyond their declared sigmas, in a fit whose priors are already
        widened."""
        more, share = fitted.input_residuals.factor(candidate.own)
        wide = more**2 * self._mean_square(self._input_factor, candidate.own)
        size = max(wide - self._mean_square(np.ones((1, 1)), candidate.own), 0.0) ** 0.5
        return FoundScatter(candidate, p_value, *unbiased(size, wide / max(size, wide**0.5 / 2) * share))

    def _mean_square(self, factor: Array, inputs: Mask) -> float:
        """Return the mean variance, SI, of inputs ``inputs`` (B, H) with prior sigmas multiplied by ``factor``."""
        sigmas = self.model.input_scale * factor * np.ones(inputs.shape)
        return float(np.mean(sigmas[inputs] ** 2))

    def with_noise_dependence(self, fitted: FittedModel[CauseT], dependence: NoiseDependence) -> NoiseDependence:
        """Weight observations by a noise dependence; return the dependence with its ratio estimated anew.

        If a cause makes the noise larger, screened observations are restored first: they may be part of that noise.
        """
        self.reweight(dependence.factor)
        if dependence.driver.cause is None:
            return dependence
        self._restore_screened()
        for _ in range(_MOST_SCALINGS):
            fitted = self.converged(fitted.causes, fitted)
            more = larger_where(dependence.driver, self.known_residuals(fitted), dependence.p_value)
            self.reweight(more.factor)
            share = more.sigma / more.ratio
            ratio = dependence.ratio * more.ratio
            dependence = replace(dependence, ratio=ratio, sigma=ratio * share, factor=dependence.factor * more.factor)
            if abs(more.ratio - 1.0) < SETTLED:
                break
        return dependence

    @property
    def input_factor(self) -> Array:
        """Factors (B, H), or (1, 1), by which scatter widened the prior sigmas of inputs."""
        return self._input_factor

    def known_residuals(self, fitted: FittedModel[CauseT]) -> Array:
        """Return the standardised residuals (B, K, d) of a fit, NaN where nothing was observed."""
        return np.where(self.calibration.measured.is_observed[..., None], fitted.standardised, np.nan)

    def reweight(self, factor: Array) -> None:
        """Multiply the observations' noise by factors (B, K)."""
        measured, square = self.calibration.measured, factor[..., None, None] ** 2
        self.declared = self.declared * square
        self.calibration = replace(
            self.calibration, measured=replace(measured, covariance=measured.covariance * square)
        )


def _scatters(fitted: FittedModel[CauseT], kinds: Sequence[CauseT]) -> list[ScatterCandidate[CauseT]]:
    """Return the candidates that make inputs or observations scatter."""
    return [candidate for kind in kinds for candidate in fitted.scene.scatters(kind)]


def _lengths(residuals: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(residuals**2, -1)))


def _screened(wrong: Mask, rest: Array, *, held_out: bool) -> list[ScreenedValue]:
    """Return the observations marked in ``wrong`` (B, K), with the lengths of their whitened residuals (B, K, d)."""
    length = _lengths(rest)
    return [ScreenedValue(int(b), int(k), held_out, float(length[b, k])) for b, k in np.argwhere(wrong)]
