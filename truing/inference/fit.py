"""Gauss-Newton fit of a model to observations of all groups and epochs, each epoch in a frame of its own.

The model is a function of shared and local unknowns that returns observations and derivatives. An observation has d
coordinates: three in space, or one where an instrument reads a number. Numbers have no frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property, partial

import numpy as np

from truing.inference.arrays import Array, Integers, Mask, index_or_slice
from truing.inference.linear_problem import Whitened, whiten
from truing.inference.linearised_model import LinearisedModel, columns_of
from truing.inference.model import Predict, PredictionLike, ZeroColumns
from truing.inference.observations import Frames, Observations

_MAX_ITERATIONS = 25
# A step that raises the sum of squares is halved at most this many times.
_MOST_HALVINGS = 8
# A fit has converged when its next step would lower the sum of squares by less than this: then no unknown moves by
# more than a hundredth of its standard deviation.
_SETTLED = 1e-4
# Anderson acceleration starts after _QUICK iterations if a step would lower the sum of squares by more than the share
# _SLOW of the last step's reduction. It uses the last _HISTORY steps, without directions below _DISTINCT.
_QUICK, _SLOW, _HISTORY, _DISTINCT = 3, 0.05, 5, 1e-6
# Steps with the same derivatives go on, at most so many, while each would lower the sum of squares by less than the
# share _FAST of what the last one would, down to the share _FULLY of what counts as converged.
_MOST_SIMPLIFIED, _FAST, _FULLY = 8, 0.1, 0.1


class FitState(StrEnum):
    """State in which a fit ended."""

    SETTLED = "settled"
    NOT_SETTLED = "not-settled"


@dataclass(frozen=True)
class Fit:
    """Unknowns at the optimum in prior sigmas, and frames; ``linearised`` returns the problem there."""

    shared: Array  # (G,)
    local: Array  # (B, H) without the frames
    frames: Frames
    linearised: Callable[[], LinearisedModel] = field(repr=False)
    state: FitState
    iterations: int

    @cached_property
    def whitened(self) -> Whitened:
        """Whitened problem at the optimum, computed anew after `release`."""
        return whiten(self.linearised())

    def release(self) -> None:
        """Free the whitened problem, whose arrays are clearly the largest."""
        self.__dict__.pop("whitened", None)


def fit_model(predict: Predict, measured: Observations, frames: Frames, shared: Array, local: Array) -> Fit:
    """Return the maximum of posterior probability over shared (G,) and local (B, H) unknowns and frames."""
    at = _Unknowns(shared, local, frames)
    past, state, iterations = _Past(), FitState.NOT_SETTLED, _MAX_ITERATIONS
    for iteration in range(_MAX_ITERATIONS):
        whitened = whiten(at.linearised(predict, measured))
        if whitened.explained < _SETTLED:
            state, iterations = FitState.SETTLED, iteration
            break
        at, _ = _descended(predict, measured, at, whitened, past)
    else:
        whitened = whiten(at.linearised(predict, measured))
    fit = Fit(at.shared, at.local, at.frames, partial(at.linearised, predict, measured), state, iterations)
    fit.__dict__["whitened"] = whitened
    return fit


def shared_without(predict: Predict, measured: Observations, fit: Fit, epochs: Mask) -> Array:
    """Return the shared unknowns (G,) of the fit without some epochs (B,), which are not seen in ``measured``.

    The derivatives are those of the fit, from which the unknowns move by about their standard deviations; where steps
    with these shrink slowly, the model is fitted anew."""
    at = _Unknowns(fit.shared, np.where(epochs[:, None], 0.0, fit.local), fit.frames)
    at, left = _descended(predict, measured, at, fit.whitened.without(epochs), _Past())
    return at.shared if left < _SETTLED else fit_model(predict, measured, at.frames, at.shared, at.local).shared


@dataclass(frozen=True)
class _Unknowns:
    """Shared (G,) and local (B, H) unknowns, and frames."""

    shared: Array
    local: Array
    frames: Frames

    def moved(self, of_shared: Array, of_local: Array) -> _Unknowns:
        """Return the unknowns after a step, whose local part (B, 6 + H) has the frames first."""
        size = self.frames.size
        return _Unknowns(
            self.shared + of_shared, self.local + of_local[:, size:], self.frames.moved(of_local[:, :size])
        )

    def linearised(self, predict: Predict, measured: Observations) -> LinearisedModel:
        """Return the problem linearised here."""
        return linearise(predict, measured, self.frames, self.shared, self.local, compact=True)

    def residuals(self, predict: Predict, measured: Observations, linearised: LinearisedModel) -> LinearisedModel:
        """Return the problem with the residuals here, and derivatives that are known nearby."""
        here = linearise(predict, measured, self.frames, self.shared, self.local, by_shared=False)
        return linearised.at(here.residual, here.local_value, self.shared)


def _descended(
    predict: Predict, measured: Observations, at: _Unknowns, whitened: Whitened, past: _Past
) -> tuple[_Unknowns, float]:
    """Return the unknowns after a least-squares step, and after further steps with the same derivatives as long as
    these shrink fast; and the reduction of the sum of squares that another one would bring.

    Derivatives by the shared unknowns, and their elimination, take most of the time of an iteration. Source: simplified
    Newton method, Kelley, Iterative Methods for Linear and Nonlinear Equations (SIAM 1995), section 5.4.
    """
    for step in past.steps(whitened, at.shared):
        moved = at.moved(*step)
        problem = moved.residuals(predict, measured, whitened.problem)
        if problem.squares <= whitened.problem.squares:
            break
    else:
        return moved, np.inf
    for _ in range(_MOST_SIMPLIFIED):
        before, at, whitened = whitened.explained, moved, whitened.with_residuals(problem)
        if whitened.explained < _FULLY * _SETTLED or whitened.explained > _FAST * before:
            break
        moved = at.moved(*whitened.step())
        problem = moved.residuals(predict, measured, whitened.problem)
        if problem.squares > whitened.problem.squares:
            break
    return at, whitened.explained


@dataclass
class _Past:
    """Shared unknowns and least-squares steps of the last iterations, for Anderson acceleration.

    Local unknowns follow the shared ones as in any step. Source: Walker and Ni, SIAM J. Numer. Anal. 49 (2011) 1715.
    """

    places: list[Array] = field(default_factory=list)  # (G,) each
    taken: list[Array] = field(default_factory=list)  # the least-squares steps there
    explained: list[float] = field(default_factory=list)

    def steps(self, whitened: Whitened, shared: Array) -> Iterator[tuple[Array, Array]]:
        """Yield steps of shared (G,) and local (B, H) unknowns to be tried in turn. The accelerated step comes first
        where convergence is slow, then the least-squares step, then its halves."""
        step, of_local = whitened.step()
        self.places.append(shared)
        self.taken.append(step)
        self.explained.append(whitened.explained)
        if len(self.places) > _QUICK and self.explained[-1] > _SLOW * self.explained[-2]:
            better = self._accelerated_step(whitened)
            yield better, whitened.local_step(better)
        for halved in range(_MOST_HALVINGS):
            yield 0.5**halved * step, 0.5**halved * of_local

    def _accelerated_step(self, whitened: Whitened) -> Array:
        """Return the accelerated step (G,): it leads to where linear extrapolation makes the next step smallest."""
        places, steps = (np.array(values[-_HISTORY - 1 :]) for values in (self.places, self.taken))
        moved, changed = np.diff(places, axis=0).T, np.diff(steps, axis=0).T
        weights = np.linalg.lstsq(whitened.in_basis(changed), whitened.in_basis(steps[-1]), rcond=_DISTINCT)[0]
        return np.asarray(steps[-1] - (moved + changed) @ weights)


def linearise(
    predict: Predict,
    measured: Observations,
    frames: Frames,
    shared: Array,
    local: Array,
    by_shared: bool = True,
    *,
    compact: bool = False,
) -> LinearisedModel:
    """Return the whitened problem at given unknowns; the six of each frame come first among the local ones.

    Derivatives by the shared unknowns are left out (G = 0) unless ``by_shared``. ``compact`` stores, where it saves
    memory, only the columns that act in each epoch.
    """
    prediction = predict(shared, local, by_shared)
    rotated = prediction.values @ np.swapaxes(frames.R, 1, 2)
    gap = measured.values - rotated - frames.t[:, None]
    turned = measured.whitener @ frames.R[:, None]
    by_local = np.concatenate([measured.whitener @ frames.columns(rotated), turned @ prediction.by_local], -1)
    epochs, height = len(rotated), rotated.shape[1] * rotated.shape[2]
    slopes, columns, common = _slopes(prediction, compact)
    return LinearisedModel(
        residual=(measured.whitener @ gap[..., None]).reshape(epochs, -1),
        by_local=by_local.reshape(epochs, height, by_local.shape[-1]),
        by_shared=_rotated_slopes(turned, slopes).reshape(epochs, height, -1)
        if by_shared
        else np.zeros((epochs, height, 0)),
        local_value=np.concatenate([np.zeros((epochs, frames.size)), local], 1),
        shared_value=shared,
        extra_residual=prediction.known_residual,
        extra_by_shared=prediction.known_by_shared,
        present=np.repeat(measured.is_observed, measured.size, axis=1),
        local_known=np.concatenate([np.zeros(frames.size, bool), prediction.local_known]),
        shared_known=prediction.shared_known,
        columns=columns,
        common=common,
    )


def _slopes(prediction: PredictionLike, compact: bool) -> tuple[Array, Integers | None, int]:
    """Return a prediction's derivatives (B, K, d, G) by the shared unknowns; or, compact, derivatives (B, K, d, C) by
    the columns (B, C) of each epoch, these columns, and the number common to all epochs."""
    zeros, slopes = prediction.zero_columns, prediction.by_shared
    if compact:
        acting = _acting(slopes)
        acting_columns = columns_of(acting if zeros is None else np.concatenate([zeros.acting, acting], 1))
        if acting_columns is not None:
            return _column_derivatives(slopes, zeros, *acting_columns), *acting_columns
    if zeros is not None:
        slopes = zeros.before(slopes)
    return slopes, None, 0


def _acting(slopes: Array) -> Mask:
    """Return True for shared unknowns that act in each epoch, (B, G), from derivatives (B, K, d, G)."""
    acts = np.zeros((len(slopes), slopes.shape[-1]), bool)
    for channel, axis in np.ndindex(slopes.shape[1:3]):  # a long campaign's derivatives are too many to compare at once
        acts |= slopes[:, channel, axis] != 0.0
    return acts


def _column_derivatives(slopes: Array, zeros: ZeroColumns | None, columns: Integers, common: int) -> Array:
    """Return derivatives (B, K, d, C) of the columns (B, C) of each epoch; zero for column G.

    slopes: derivatives by all unknowns, or by all after the zeros (B, K, d, G - Z). The first ``common`` columns are
    the same in all epochs.
    """
    first = 0 if zeros is None else zeros.size
    few = columns[:, common:]
    alike, column_index = columns[0, :common], (few - first)[:, None, None]
    acting = (column_index >= 0) & (column_index < slopes.shape[-1])
    derivatives = np.zeros((*slopes.shape[:3], few.shape[1]))
    if slopes.shape[-1]:
        derivatives += np.take_along_axis(slopes, np.where(acting, column_index, 0), 3) * acting
    parts = [slopes[..., index_or_slice(alike[alike >= first] - first)], derivatives]
    if zeros is not None:
        derivatives += zeros.at(few)
        parts.insert(0, zeros.at(alike[alike < first]))
    return np.concatenate(parts, -1)


def _rotated_slopes(turned: Array, slopes: Array) -> Array:
    """Return slopes (B, K, d, G) multiplied by matrices (B, K, d, d), elementwise where observations are numbers."""
    return turned * slopes if turned.shape[-1] == 1 else turned @ slopes
