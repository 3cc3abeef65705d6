"""A model with some causes, fitted to calibration poses: what it leaves there, on held-out poses, and to candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.inference.fit import PointFit, fit_points
from truing.inference.linear_problem import Given, rows_by_source
from truing.inference.model import CausalModel
from truing.inference.noise import (
    NoiseComponents,
    NoiseFollowing,
    components,
    drivers,
    noise_following,
    reading_ratio,
    rescaled_points,
    standardised,
    survey_ratio,
    told_points,
    told_share,
)
from truing.inference.observations import MeasuredPoints, Poses
from truing.inference.prediction import NoiseFloor, PredictionError, merged, noise_floor, prediction_error
from truing.inference.screening import gross_errors
from truing.inference.signatures import Channels, channels_of

# How often gross errors are looked for, and the noise estimated anew, before the search.
_PREPARATIONS = 3
_SAME_NOISE = 0.05
# Where no pose is held out, so many blocks of poses are left out in turn, each of so many poses at least.
_BLOCKS, _FEWEST_IN_BLOCK, _MOST_POINTS = 5, 4, 20_000


@dataclass(frozen=True)
class Stand:
    """A model fitted to the calibration poses, with what it leaves there and on held-out poses."""

    causes: tuple[Any, ...]
    model: Any  # a CausalModel
    measured: MeasuredPoints
    fit: PointFit
    held_out: PredictionError | None
    seed: int
    learned: tuple[float, float] = (1.0, 1.0)  # noise of readings and survey used in the fit, over that declared

    @cached_property
    def error(self) -> PredictionError:
        """Return the error of its prediction from readings."""
        return prediction_error(self.model, self.measured, self.fit.frames, self.fit.shared, self.model.unpredicted)

    @cached_property
    def floor(self) -> NoiseFloor:
        """Return what noise alone leaves in that error."""
        rng = np.random.default_rng(self.seed)
        return noise_floor(self.fit, self.measured, self.model.unpredicted, self.model.zeros, rng)

    @cached_property
    def scene(self) -> Any:
        """Return what the campaign offers to causes, with what was seen of it."""
        return replace(self.model.scene, seen=self.measured.seen)

    @cached_property
    def designer(self) -> Callable[[Any], Mapping[str, NDArray]]:
        """Return what tells how a candidate acts at this fit."""
        return self.model.designer(self.fit.shared, self.fit.local)  # type: ignore[no-any-return]

    @property
    def reading_rows(self) -> slice:
        """Return which of a pose's local unknowns are readings."""
        first = self.fit.frames.size
        return slice(first, first + int(np.sum(~self.model.unpredicted)))

    @cached_property
    def noise(self) -> NoiseComponents:
        """Return the noise that the fit leaves, by component."""
        return components(self.fit.whitened, _height(self.measured), self.reading_rows)

    @property
    def noise_ratio(self) -> float:
        """Return the noise found over the one used in the fit, declared knowledge included."""
        found = self.noise
        return float(np.sqrt((found.points_total + found.readings_total) / (found.points + found.readings)))

    def covariance(self) -> NDArray:
        """Return the covariance (G, G) of the shared unknowns in prior sigmas, at the estimated noise level."""
        return self.fit.whitened.covariance() * self.noise_ratio**2

    def channels(self) -> Channels:
        """Return the channels through which candidates act on what the fit leaves."""
        motions = self.model.channels(self.fit.shared, self.fit.local)
        return channels_of(self.fit.whitened, self.measured, self.fit.frames, motions, self.reading_rows)

    def values(self, cause: Any) -> tuple[NDArray, NDArray]:
        """Return the values (P,) and covariance (P, P), SI, of an accepted cause's parameters."""
        place, sigma = self.model.layout[cause.key], self.model.effect_sigma(cause)
        return self.fit.shared[place] * sigma, self.covariance()[place, place] * np.outer(sigma, sigma)

    def given(self, cause: Any) -> tuple[Given, ...]:
        """Return what each source gives to the covariance of an accepted cause's parameters, SI: all of it together."""
        whitened, place = self.fit.whitened, self.model.layout[cause.key]
        rows = rows_by_source(whitened, self.model.layout, {own.key for own in self.causes}, self.reading_rows)
        sigma = self.noise_ratio * self.model.effect_sigma(cause)
        parts = whitened.covariance_from(rows, place)
        left = np.where(whitened.present, 1.0 - whitened.leverage, 0.0)
        return tuple(
            Given(name, covariance * np.outer(sigma, sigma), float(left[rows[name]].sum()))
            for name, covariance in parts.items()
        )


@dataclass(frozen=True)
class ScreenedPoint:
    """A point or reading taken out as a gross error: row and target in its ``Poses``, and its whitened residual."""

    row: int
    target: int
    held_out: bool
    length: float  # in units of the noise as it was known then


class Fitter:
    """Fits a campaign's model with any causes; knows the noise and the gross errors found so far."""

    def __init__(
        self,
        model: CausalModel,
        calibration: Poses,
        held_out: Poses | None,
        seed: int,
        progress: Callable[[str], None] = lambda what: None,
    ) -> None:
        self.model: Any = model
        self.calibration, self.held_out = calibration, held_out
        self._declared, self.declared_points = model, calibration.measured.covariance
        self._ratios = 1.0, 1.0
        self._seed, self._progress = seed, progress
        self.screened: list[ScreenedPoint] = []  # points taken out as gross errors

    def prepared(self, causes: tuple[Any, ...] = (), start: Stand | None = None) -> Stand:
        """Return the fit with some causes once gross errors are out and the noise is known; with what it predicts
        wrongly of poses that were left out."""
        stand = self.settled(causes, start)
        return stand if stand.held_out is not None else replace(stand, held_out=self._left_out_in_turn(stand))

    def settled(self, causes: tuple[Any, ...] = (), start: Stand | None = None) -> Stand:
        """Return the fit with some causes once gross errors are out and the noise is known."""
        stand = self.stand(causes, start)
        for _ in range(_PREPARATIONS):
            screened = self.screen(stand)
            if not self.learn_noise(stand) and not screened:
                break
            stand = self.stand(causes, stand)
        return stand

    def stand(self, causes: tuple[Any, ...], start: Stand | None = None) -> Stand:
        """Return the model with some causes, fitted from an earlier fit."""
        self._progress("fitting " + (", ".join(cause.id for cause in causes) or "the plain simulation"))
        model = self.model.with_causes(causes)
        measured, frames = self.calibration.measured, self.calibration.frames
        if start is None:
            shared, local = self.model.widened(np.empty(0), model), np.zeros((len(frames.t), model.local_size))
        else:
            shared, local = start.model.widened(start.fit.shared, model), start.fit.local
            frames = start.fit.frames
        fit = fit_points(model, measured, frames, shared, local)
        return Stand(causes, model, measured, fit, self._predicted(model, fit), self._seed, self._ratios)

    def _predicted(self, model: CausalModel, fit: PointFit) -> PredictionError | None:
        if self.held_out is None:
            return None
        held = self.held_out
        return prediction_error(model.at(held.conditions), held.measured, held.frames, fit.shared, model.unpredicted)

    def _left_out_in_turn(self, stand: Stand) -> PredictionError | None:
        """Return what is predicted wrongly of blocks of poses, one after the other in time, each left out of a fit.

        For campaigns that hold no pose out; None where blocks would have too few poses, or fits take too long.
        """
        measured, numbers = stand.measured, stand.model.blocks
        if numbers is None or len(numbers) < _BLOCKS * _FEWEST_IN_BLOCK or measured.seen.size > _MOST_POINTS:
            return None
        rank = np.unique(numbers, return_inverse=True)[1]
        count = min(_BLOCKS, int(rank.max()) + 1)
        block = rank * count // (rank.max() + 1)
        if count < 2:
            return None
        return merged([self._predicted_block(stand, block == number) for number in range(count)], block, measured)

    def _predicted_block(self, stand: Stand, own: NDArray) -> PredictionError:
        """Return the error of the prediction of poses own (B,) by a fit without them."""
        model, measured, fit = stand.model, stand.measured, stand.fit
        others = replace(measured, seen=measured.seen & ~own[:, None])
        local = np.where(own[:, None], 0.0, fit.local)
        without = fit_points(model, others, fit.frames, fit.shared, local)
        return prediction_error(model, measured, fit.frames, without.shared, model.unpredicted, by_shared=False)

    def screen(self, stand: Stand) -> bool:
        """Take out what is grossly wrong against a fit, held out or not; return whether there was anything."""
        seen, own = self.calibration.measured.seen, _height(self.calibration.measured)
        height = own + stand.fit.whitened.problem.local_value.shape[1]
        rows = stand.fit.whitened.rest[: len(seen) * height].reshape(len(seen), height)[:, :own]
        axes = self.calibration.measured.whitener @ stand.fit.frames.R[:, None]
        axes = axes @ stand.model.turns(stand.fit.shared, stand.fit.local)
        order = stand.scene.covariates.get("order")
        wrong = gross_errors(rows.reshape(*seen.shape, -1), seen, axes, order, stand.model.zeros)
        wrong = self.calibration.judged(wrong)
        self.calibration = self.calibration.without(wrong)
        found = _screened(wrong, rows.reshape(*seen.shape, -1), held_out=False)
        if self.held_out is not None and stand.held_out is not None:
            unseen = gross_errors(
                stand.held_out.whitened, self.held_out.measured.seen, zeros=stand.held_out.model.zeros
            )
            unseen = self.held_out.judged(unseen)
            self.held_out = self.held_out.without(unseen)
            found += _screened(unseen, stand.held_out.whitened, held_out=True)
        self.screened += found
        return bool(found)

    def learn_noise(self, stand: Stand) -> bool:
        """Take over the noise that a fit shows, and what its legs have in common; return whether either is another
        than before."""
        measured, whitened = self.calibration.measured, stand.fit.whitened
        rescaled = rescaled_points(whitened, measured, stand.model.bodies)
        size = len(whitened.rest) - len(stand.fit.shared)
        places = size + np.arange(len(stand.fit.shared))[stand.model.layout["shape"]]
        before = self._ratios
        self._ratios = (
            reading_ratio(whitened, _height(measured), stand.reading_rows, before[0]),
            survey_ratio(whitened, places, before[1]),
        )
        share_moved = self._learn_share(stand)
        self.model = self._declared.rescaled(*self._ratios)
        self.calibration = replace(self.calibration, measured=rescaled)
        traces = [np.trace(points.covariance, axis1=-2, axis2=-1) for points in (rescaled, measured)]
        steps = [now / old for now, old in zip(self._ratios, before, strict=True)]
        moved = max(*(abs(step - 1.0) for step in steps), float(np.abs(traces[0] / traces[1] - 1.0).max()))
        return moved > _SAME_NOISE or share_moved

    def _learn_share(self, stand: Stand) -> bool:
        """Take over how much of what legs are off by a fit shows them to have in common; return whether it is another
        share than before."""
        split = stand.model.split
        if split is None:
            return False
        covariance = stand.fit.whitened.covariance()[np.ix_(split.places, split.places)]
        share = told_share(stand.fit.shared[split.places], covariance, split.common, split.share)
        self._declared = self._declared.with_share(share)
        return share != split.share

    def following(self, stand: Stand, level: float) -> NoiseFollowing | None:
        """Return what the noise that a fit leaves follows, None where p exceeds the level."""
        measured, scene = self.calibration.measured, stand.scene
        seen = measured.seen
        rest, told = told_points(stand.fit.whitened, measured.points.shape)
        known = np.where(seen[..., None], standardised(rest, told), np.nan)
        columns = {name: np.asarray(values) for name, values in scene.covariates.items()}
        return noise_following(known, drivers(columns, scene.shape, stand.model.bodies), level)

    def reweight(self, factor: NDArray) -> None:
        """Take the points' noise to be larger by factors (B, K)."""
        measured, square = self.calibration.measured, factor[..., None, None] ** 2
        self.declared_points = self.declared_points * square
        self.calibration = replace(
            self.calibration, measured=replace(measured, covariance=measured.covariance * square)
        )


def _height(measured: MeasuredPoints) -> int:
    """Return how many rows the points of a pose are."""
    return measured.seen.shape[1] * measured.size


def _screened(wrong: NDArray, rest: NDArray, *, held_out: bool) -> list[ScreenedPoint]:
    """Return the points wrong (B, K) with the lengths of their whitened residuals (B, K, d)."""
    length = np.sqrt(np.sum(rest**2, -1))
    return [ScreenedPoint(int(b), int(k), held_out, float(length[b, k])) for b, k in np.argwhere(wrong)]
