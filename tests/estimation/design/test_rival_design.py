"""Poses that discriminate between rivals: odds as in simulated data, and a report if no pose discriminates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from tests.tolerance import assert_between, assert_close
from truing.estimation.design.rival_design import (
    ChosenPoses,
    Fitted,
    PointInstrument,
    PoseCandidates,
    candidates,
    discriminating_poses,
    narrowed,
)
from truing.estimation.rotation import exp_so3
from truing.inference.fit import Fit, fit_model
from truing.inference.observations import Frames, Observations

SIGMA = 0.01
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.5]])
OWN = np.array([3])  # the unknown that the effect has for itself
GRID = np.linspace(-1.0, 1.0, 21)[:, None]


@dataclass(frozen=True)
class Conditions:
    """Positions of the measured poses, with one reading each."""

    readings: np.ndarray


@dataclass(frozen=True)
class Prediction:
    """Points and derivatives of the model below."""

    values: np.ndarray
    by_shared: np.ndarray
    by_local: np.ndarray
    known_residual: np.ndarray
    known_by_shared: np.ndarray
    shared_known: np.ndarray
    local_known: np.ndarray
    zero_columns: None = None


@dataclass(frozen=True)
class Bending:
    """The last of five targets sits off by what is not known of it, and follows the reading to some power along z."""

    power: int
    conditions: Conditions
    local_size = 0

    def at(self, conditions: Any) -> Bending:
        return replace(self, conditions=conditions)

    def predict(self, shared: np.ndarray, local: np.ndarray, by_shared: bool = True) -> Prediction:
        x = self.conditions.readings[:, 0]
        by_shared = np.zeros((len(x), 5, 3, 4))
        by_shared[:, 4, :, :3] = 3 * SIGMA * np.eye(3)
        by_shared[:, 4, 2, 3] = x**self.power
        points = CORNERS + by_shared @ shared
        none = np.empty((len(x), 5, 3, 0))
        return Prediction(points, by_shared, none, np.empty(0), np.empty((0, 4)), np.ones(4, bool), np.ones(0, bool))


def _measured(model: Bending, truth: np.ndarray, rng: np.random.Generator) -> tuple[Observations, Frames]:
    points = model.predict(truth, np.empty((len(model.conditions.readings), 0))).values
    R, t = exp_so3(rng.normal(0.0, 0.5, (len(points), 3))), rng.normal(size=(len(points), 3))
    seen = points @ np.swapaxes(R, 1, 2) + t[:, None] + rng.normal(0.0, SIGMA, points.shape)
    cov = np.broadcast_to(np.eye(3) * SIGMA**2, (*points.shape, 3))
    return Observations(seen, cov, np.ones(points.shape[:2], bool)), Frames(R, t)


def _fit(model: Bending, measured: Observations, frames: Frames) -> Fit:
    return fit_model(model.predict, measured, frames, np.zeros(4), np.empty((len(frames.t), 0)))


def _log_evidence(fit: Fit) -> float:
    """Return the log marginal likelihood but for what all models of the same data have in common."""
    whitened = fit.whitened
    own = np.log(np.abs(np.diagonal(whitened.local_factor, axis1=1, axis2=2))).sum()
    return float(-0.5 * whitened.rest @ whitened.rest - own + 0.5 * np.linalg.slogdet(whitened.covariance())[1])


@dataclass(frozen=True)
class Case:
    """Two rivals after a campaign on one side of zero, where a line and a parabola are nearly the same."""

    measured: Observations
    frames: Frames
    fits: tuple[Fit, Fit]
    seen: tuple[PoseCandidates, PoseCandidates]
    odds: float  # log odds of the line against the parabola

    def gain(self, readings: np.ndarray, right: int, rng: np.random.Generator) -> float:
        """Return the gain in log odds of the right rival, its true values drawn from their estimate."""
        fitted = self.seen[right].fitted
        truth = rng.multivariate_normal(fitted.shared, fitted.covariance)
        more, where = _measured(fitted.model.at(Conditions(readings)), truth, rng)
        names = ("values", "covariance", "is_observed")
        both = Observations(*(np.concatenate([getattr(self.measured, n), getattr(more, n)]) for n in names))
        frames = Frames(np.concatenate([self.frames.R, where.R]), np.concatenate([self.frames.t, where.t]))
        known = np.concatenate([self.seen[0].fitted.model.conditions.readings, readings])
        found = [_log_evidence(_fit(one.fitted.model.at(Conditions(known)), both, frames)) for one in self.seen]
        return float((found[0] - found[1] - self.odds) * (1, -1)[right])


@pytest.fixture(scope="module")
def case() -> Case:
    rng = np.random.default_rng(3)
    line = Bending(1, Conditions(rng.uniform(0.7, 1.0, (12, 1))))
    parabola = replace(line, power=2)
    measured, frames = _measured(line, np.array([0.5, -0.3, 0.2, 0.03]), rng)
    fits = _fit(line, measured, frames), _fit(parabola, measured, frames)
    instrument = PointInstrument(np.broadcast_to(np.eye(3) * SIGMA**2, (5, 3, 3)))
    first, second = (
        candidates(Fitted(model, fit.shared, fit.whitened.covariance()), Conditions(GRID), instrument)
        for model, fit in zip((line, parabola), fits, strict=True)
    )
    return Case(measured, frames, fits, (first, second), _log_evidence(fits[0]) - _log_evidence(fits[1]))


def _apart(case: Case, most: int, odds: float = 0.0) -> ChosenPoses:
    return discriminating_poses(case.seen, (OWN, OWN), 20.0, most, odds)


def test_a_line_and_a_parabola_known_on_one_side_are_distinguished_on_the_other(case: Case) -> None:
    choice = _apart(case, 8)
    assert choice.is_enough
    assert len(set(choice.chosen)) == len(choice.chosen)
    assert GRID[choice.chosen[0], 0] == -1.0
    assert all(GRID[k, 0] < 0.5 for k in choice.chosen)
    assert 1 < choice.total <= 8
    assert choice.final >= 20.0 > choice.values[-2]


def _readings(choice: ChosenPoses) -> np.ndarray:
    """Return the readings of all measurements of a choice."""
    return GRID[np.repeat(choice.chosen, choice.times)]


@pytest.mark.slow
def test_the_odds_promised_are_those_that_simulated_measurements_give(case: Case) -> None:
    """They are those of the rival that is harder to show right."""
    choice, rng = _apart(case, 8), np.random.default_rng(5)
    gains = np.array([[case.gain(_readings(choice), right, rng) for _ in range(120)] for right in (0, 1)])
    harder = gains[np.argmin(gains.mean(1))]
    error = 4 * harder.std(ddof=1) / np.sqrt(harder.size)
    assert error < 2.5
    assert_between(float(harder.mean()), np.log(choice.final) - error, np.log(choice.final) + error)


def test_chosen_poses_separate_rivals_better_than_random_ones(case: Case) -> None:
    choice, rng = _apart(case, 8), np.random.default_rng(6)
    best = [case.gain(_readings(choice), 0, rng) for _ in range(80)]
    other = [case.gain(GRID[rng.integers(len(GRID), size=choice.total)], 0, rng) for _ in range(80)]
    assert np.mean(best) > np.mean(other) + 2 * np.hypot(np.std(best), np.std(other)) / np.sqrt(80)


def test_odds_so_far_count_for_the_rival_that_is_behind(case: Case) -> None:
    even, apart = _apart(case, 8), [_apart(case, 8, odds) for odds in (3.0, -3.0)]
    assert max(choice.total for choice in apart) > even.total


def test_rivals_that_predict_the_same_everywhere_are_never_distinguished(case: Case) -> None:
    choice = discriminating_poses((case.seen[0], case.seen[0]), (OWN, OWN), 20.0, 8)
    assert not choice.is_enough
    assert_close(choice.final, 1.0, atol=1e-9, what="odds")


def test_poses_are_repeated_if_the_allowed_number_is_not_enough(case: Case) -> None:
    choice = discriminating_poses(case.seen, (OWN, OWN), 10.0, 1)
    assert choice.is_enough
    assert len(choice.chosen) == 1
    assert choice.total > 1
    assert choice.final >= 10.0


def _sigma(case: Case, readings: np.ndarray) -> float:
    """Return the uncertainty of the line's slope once more was measured, by a fit of everything."""
    rng = np.random.default_rng(0)
    model = case.seen[0].fitted.model
    more, where = _measured(model.at(Conditions(readings)), case.fits[0].shared, rng)
    names = ("values", "covariance", "is_observed")
    both = Observations(*(np.concatenate([getattr(case.measured, n), getattr(more, n)]) for n in names))
    frames = Frames(np.concatenate([case.frames.R, where.R]), np.concatenate([case.frames.t, where.t]))
    known = Conditions(np.concatenate([model.conditions.readings, readings]))
    return float(np.sqrt(_fit(model.at(known), both, frames).whitened.covariance()[3, 3]))


def test_the_uncertainty_promised_is_that_of_a_fit_of_everything(case: Case) -> None:
    choice = narrowed(case.seen[0], np.eye(4)[3], 0.5, 8)
    before = _sigma(case, GRID[:0])
    for count, value in enumerate(choice.values, 1):
        found = _sigma(case, GRID[np.repeat(choice.chosen[:count], choice.times[:count])]) / before
        assert_close(found, value, atol=1e-3, what=f"sigma with {count} more, of that before")


def test_two_poses_are_as_good_as_the_best_of_all_pairs(case: Case) -> None:
    """Each measured sixteen times, as a search does that two alone do not satisfy."""
    choice = narrowed(case.seen[0], np.eye(4)[3], 1e-3, 2)
    assert not choice.is_enough
    best = min(_sigma(case, GRID[list(pair) * 16]) for pair in combinations(range(0, len(GRID), 4), 2))
    assert _sigma(case, GRID[list(choice.chosen) * 16]) <= best * 1.01


def test_an_uncertainty_that_nothing_measured_there_lessens_stays(case: Case) -> None:
    at_zero = [k for k in range(len(GRID)) if abs(GRID[k, 0]) < 1e-9]
    seen = case.seen[0]
    only = PoseCandidates(seen.fitted, seen.predicted[at_zero], seen.rows[at_zero], seen.basis[at_zero])
    choice = narrowed(only, np.eye(4)[2] - np.eye(4)[3], 1e-3, 4)
    assert not choice.is_enough
    assert 0.0 < choice.final <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("right", [0, 1])
def test_the_distance_between_predictions_alone_promises_less_than_comes(case: Case, right: int) -> None:
    """Half the squared distance, in its dense form, leaves out what not knowing the effects' sizes adds: a third."""
    choice, rng = _apart(case, 8), np.random.default_rng(7)
    truth, wrong = case.seen[right], case.seen[1 - right]
    chosen = list(np.repeat(choice.chosen, choice.times))
    gap, rows = (one[chosen].reshape(-1, one.shape[-1]) for one in _freed(truth, wrong))
    known = np.eye(len(gap)) + rows @ wrong.fitted.covariance @ rows.T
    half = 0.5 * float(gap[:, 0] @ np.linalg.solve(known, gap[:, 0]))
    gains = np.array([case.gain(GRID[chosen], right, rng) for _ in range(150)])
    assert half < gains.mean() - gains.std() / np.sqrt(len(gains)), (half, gains.mean())


def _freed(right: PoseCandidates, wrong: PoseCandidates) -> tuple[np.ndarray, np.ndarray]:
    gap = (right.predicted - wrong.predicted)[..., None]
    return right.without_pose_unknowns(gap), right.without_pose_unknowns(wrong.rows)
