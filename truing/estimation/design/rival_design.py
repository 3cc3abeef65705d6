"""Next measurements: poses or runs that discriminate between two rival models, or that reduce one uncertainty.

The predictions of a new pose are whitened and its own unknowns (frame, actuators) eliminated. Information then adds up
over poses, so that sets are searched by adding and exchanging single poses.

Rivals share their nuisance parameters and have one effect each. After a fit to old and new data, nuisances leave the
predictions a covariance C common to both; the effect's own parameters add to it, so that rival A predicts N(m_A, C_A).
If A is right, new measurements change the log odds of A against B on average by this divergence (Box and Hill, 1967):

    1/2 [ gap^T C_B^-1 gap + tr(C_B^-1 C_A) - n - log det(C_B^-1 C_A) ],    gap = m_A - m_B.

It is half the squared distance between the predictions, plus a term for the uncertain sizes of the effects
(Technometrics 9 (1967) 57).

Steps of a run belong together: each is relative to the run's zero, and hysteresis carries over between steps. Runs are
therefore chosen as a whole, by the same sums as poses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from truing.inference.fit import linearise
from truing.inference.observations import Frames, Observations

# Directions of the unknowns in which all candidates together see less than this share of the noise's variance are left
# out: they hardly change any squared distance.
_UNSEEN = 1e-3
# Number of candidates evaluated exactly per place: the best ones to first order.
_TRIED = 8
# If the requested number of poses is not enough, each is measured up to this many times.
_AGAIN = 16
# A number of repetitions that acts as infinity.
_MANY = 100
_LARGEST = 100.0  # logarithm of odds beyond which more makes no difference
Sums = list[NDArray]  # each (C, ...), one entry per candidate or set of candidates


class DesignCriterion(Protocol):
    """Criterion for sets of poses, evaluated from sums over them."""

    def reached(self, sums: Sums) -> NDArray:
        """Return the value (C,) of sets, to be maximised."""

    def promise(self, there: Sums, more: Sums) -> NDArray:
        """Return the first-order gain of adding each of several candidates to one set, on any scale."""


@dataclass(frozen=True)
class Fitted:
    """A fitted model of points: its unknowns (G,) and their covariance (G, G), in prior sigmas."""

    model: Any  # a `CampaignModel`
    shared: NDArray
    covariance: NDArray

    def propagated(self, columns: NDArray) -> NDArray:
        """Return the changes of all unknowns (G, P) per standard deviation of some (P,), with the others refitted."""
        covariance = self.covariance[:, columns]
        return np.linalg.solve(np.linalg.cholesky(covariance[columns]), covariance.T).T

    def conditional_covariance(self, columns: NDArray) -> NDArray:
        """Return the covariance (O, O) of the others if some of the unknowns were known."""
        nuisances = np.setdiff1d(np.arange(len(self.shared)), columns)
        follow = self.propagated(columns)[nuisances]
        return self.covariance[np.ix_(nuisances, nuisances)] - follow @ follow.T


@dataclass(frozen=True)
class PointInstrument:
    """Instrument for further poses: covariance (K, d, d) of each target's point (d = 3) in the model's frame, or of
    each distance (d = 1), m^2.

    free: whether each pose has its own measurement frame.
    """

    covariance: NDArray
    free: bool = True

    def observations(self, count: int) -> tuple[Observations, Frames]:
        """Return zero observations of a number of poses, with their noise, and frames at their start values."""
        targets, size = self.covariance.shape[:2]
        covariance = np.broadcast_to(self.covariance, (count, targets, size, size))
        frames = Frames(np.broadcast_to(np.eye(size), (count, size, size)), np.zeros((count, size)), self.free)
        return Observations(np.zeros(covariance.shape[:3]), covariance, np.ones((count, targets), bool)), frames


@dataclass(frozen=True)
class PoseCandidates:
    """C candidate poses with M measurements each, predicted by a fitted model in units of their noise.

    predicted (C, M); rows (C, M, G): derivatives by the shared unknowns, per prior sigma; basis (C, M + H, H): space of
    the H unknowns of a pose and their priors.
    """

    fitted: Fitted
    predicted: NDArray
    rows: NDArray
    basis: NDArray

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.predicted)

    def without_pose_unknowns(self, columns: NDArray) -> NDArray:
        """Return columns (C, M, P) as (C, M + H, P), with the poses' own unknowns eliminated."""
        padded = np.concatenate([columns, np.zeros((self.count, self.basis.shape[2], columns.shape[2]))], 1)
        return padded - self.basis @ (np.swapaxes(self.basis, 1, 2) @ padded)

    def sight(self, unknowns: NDArray, covariance: NDArray) -> CandidateSensitivity:
        """Return the sensitivity to some unknowns (G',) of covariance (G', G')."""
        directions, along = self._observable_directions(self.rows[..., unknowns], covariance)
        return CandidateSensitivity(self.without_pose_unknowns(along), directions)

    def information(self, covariance: NDArray) -> tuple[NDArray, NDArray]:
        """Return the information (C, R, R) of each candidate relative to the present one, and its directions (G, R).
        covariance (G, G): of all unknowns."""
        directions, along = self._observable_directions(self.rows, covariance)
        absorbed = np.swapaxes(self.basis[:, : along.shape[1]], 1, 2) @ along
        return np.swapaxes(along, 1, 2) @ along - np.swapaxes(absorbed, 1, 2) @ absorbed, directions

    def _observable_directions(self, rows: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
        """Return the directions (G', R) of unknowns that the candidates see by rows (C, M, G'), per standard deviation;
        and the rows (C, M, R) along them. covariance (G', G'): of the unknowns."""
        size, width = rows.shape[1:]
        factor = np.linalg.cholesky(covariance)
        rows_along = (np.swapaxes(self.basis[:, :size], 1, 2) @ rows).reshape(-1, width)
        flat = rows.reshape(-1, width)
        values, vectors = np.linalg.eigh(factor.T @ (flat.T @ flat - rows_along.T @ rows_along) @ factor)
        directions = factor @ vectors[:, values > _UNSEEN]
        return directions, (flat @ directions).reshape(self.count, size, -1)


@dataclass(frozen=True)
class CandidateSensitivity:
    """Sensitivity of candidates to a model's uncertainty: rows (C, N, R) per standard deviation along R directions (G,
    R)."""

    rows: NDArray
    directions: NDArray

    @property
    def information(self) -> NDArray:
        """Return the information (C, R, R) of each candidate relative to the present one."""
        return np.swapaxes(self.rows, 1, 2) @ self.rows


@dataclass(frozen=True)
class ChosenPoses:
    """Distinct candidates, as indices, in the order in which to measure them.

    times (n,): measurements of each; if ``is_enough`` is False, no number of repetitions reaches the aim, and times are
    very large. values (n,): value reached with all repetitions of the first, of the first two, ..
    """

    chosen: tuple[int, ...]
    times: tuple[int, ...]
    values: tuple[float, ...]
    is_enough: bool

    @property
    def final(self) -> float:
        """Value reached with all of them."""
        return self.values[-1]

    @property
    def total(self) -> int:
        """Number of measurements of all candidates together."""
        return sum(self.times)

    def with_values(self, convert: Callable[[float], float]) -> ChosenPoses:
        """Return the choice with its values converted to other terms."""
        return replace(self, values=tuple(convert(value) for value in self.values))


def candidates(fitted: Fitted, conditions: Any, instrument: PointInstrument) -> PoseCandidates:
    """Return poses at new conditions as predicted by a fitted model."""
    model = fitted.model.at(conditions)
    count = len(conditions.readings)
    origin, frames = instrument.observations(count)
    linearised = linearise(model.predict, origin, frames, fitted.shared, np.zeros((count, model.local_size)))
    size_of_local = linearised.by_local.shape[2]
    priors = np.broadcast_to(np.eye(size_of_local), (count, size_of_local, size_of_local))
    basis = np.linalg.qr(np.concatenate([linearised.by_local, priors], 1))[0]
    return PoseCandidates(fitted, -linearised.residual, linearised.by_shared, basis)


def discriminating_poses(
    rivals: tuple[PoseCandidates, PoseCandidates],
    columns_of_rivals: tuple[NDArray, NDArray],
    odds: float,
    most: int,
    log_odds: float = 0.0,
) -> ChosenPoses:
    """Return the poses that are expected to give odds of ``odds`` to 1 for whichever of two rivals is right.

    columns_of_rivals: unknowns (P,) of each rival's effect; the others are common to both.
    log_odds: of the first against the second from earlier measurements. Values are expected odds.
    """
    first, second = rivals
    gap = (first.predicted - second.predicted)[..., None]
    effects = [
        rival.rows @ rival.fitted.propagated(which) for rival, which in zip(rivals, columns_of_rivals, strict=True)
    ]
    columns = first.without_pose_unknowns(np.concatenate([gap, *effects], -1))
    nuisances = np.setdiff1d(np.arange(first.rows.shape[2]), columns_of_rivals[0])
    sight = first.sight(nuisances, first.fitted.conditional_covariance(columns_of_rivals[0]))
    turned = np.swapaxes(sight.rows, 1, 2)
    sums = [np.swapaxes(columns, 1, 2) @ columns, turned @ columns, sight.information]
    selection = search(sums, _Odds(log_odds, len(columns_of_rivals[0])), float(np.log(odds)), most)
    return selection.with_values(lambda value: float(np.exp(min(value, _LARGEST))))


def narrowed(seen: PoseCandidates, direction: NDArray, factor: float, most: int) -> ChosenPoses:
    """Return the poses that reduce the uncertainty along a direction (G,) to ``factor`` times its present value.

    Values are uncertainties relative to the present one.
    """
    covariance = seen.fitted.covariance
    information, directions = seen.information(covariance)
    now = float(direction @ covariance @ direction)
    along = direction @ directions
    aim = _Sharpness(along, now - float(along @ along), now)
    return search([information], aim, -factor, most).with_values(lambda value: -value)


@dataclass(frozen=True)
class _Odds:
    """Expected log odds of the right rival, for the worse of both cases. Sums are products (C, Q, Q) of Q columns: the
    gap, then the effects of the first and the second by their ``size`` parameters. They are also given along R
    directions of the nuisances (C, R, Q), with the information on those (C, R, R)."""

    log_odds: float
    size: int

    def reached(self, sums: Sums) -> NDArray:
        products, along, information = sums
        known = np.eye(information.shape[-1]) + information
        return self._log_odds(products - np.swapaxes(along, 1, 2) @ np.linalg.solve(known, along))

    def promise(self, there: Sums, more: Sums) -> NDArray:
        """Return the log odds with each candidate, with the nuisances' response unchanged."""
        products, along, information = (part[0] for part in there)
        followed = np.linalg.solve(np.eye(len(information)) + information, along)
        crossed = np.swapaxes(more[1], 1, 2) @ followed
        left = more[0] - crossed - np.swapaxes(crossed, 1, 2) + followed.T @ (more[2] @ followed)
        return self._log_odds(products - along.T @ followed + left)

    def _log_odds(self, products: NDArray) -> NDArray:
        """Return the log odds from products (C, Q, Q) with nuisances eliminated."""
        first, second = slice(1, 1 + self.size), slice(1 + self.size, None)
        for_first = self.log_odds + _divergence(products, first, second)
        for_second = -self.log_odds + _divergence(products, second, first)
        return np.minimum(for_first, for_second)


def _divergence(products: NDArray, right: slice, wrong: slice) -> NDArray:
    """Return the expected log odds (C,) of the right rival over the wrong one; columns as of `_Odds`."""
    of_right, of_wrong = products[:, right, right], products[:, wrong, wrong]
    known_right, known_wrong = np.eye(of_right.shape[-1]) + of_right, np.eye(of_wrong.shape[-1]) + of_wrong
    by_wrong = products[:, wrong]
    residual = products - np.swapaxes(by_wrong, 1, 2) @ np.linalg.solve(known_wrong, by_wrong)
    spread = np.trace(residual[:, right, right], axis1=1, axis2=2) - np.trace(
        residual[:, wrong, wrong], axis1=1, axis2=2
    )
    logs = np.linalg.slogdet(known_wrong)[1] - np.linalg.slogdet(known_right)[1]
    return np.asarray(0.5 * (residual[:, 0, 0] + spread + logs))


@dataclass(frozen=True)
class _Sharpness:
    """Minus the uncertainty of a parameter relative to the present one; sums: the information (C, R, R). along (R,):
    the parameter per standard deviation along each direction; unseen, now: its variance outside of them, and its
    present variance."""

    along: NDArray
    unseen: float
    now: float

    def reached(self, sums: Sums) -> NDArray:
        return -np.sqrt((self.unseen + _absorbed(self.along, sums[0])) / self.now)

    def promise(self, there: Sums, more: Sums) -> NDArray:
        """Return the derivative of the variance by each candidate's weight."""
        left = np.linalg.solve(np.eye(len(self.along)) + there[0][0], self.along)
        return np.asarray((more[0] @ left) @ left)


def search(sums: Sums, aim: DesignCriterion, enough: float, most: int) -> ChosenPoses:
    """Return at most ``most`` candidates whose summed ``sums`` reach a value, with repetitions if needed.

    They are added greedily, then exchanged one by one for better ones.
    """
    chosen, reached = _greedy_choice(sums, aim, enough, most)
    if reached < enough:
        chosen, _ = _greedy_choice([_AGAIN * part for part in sums], aim, enough, most)
    rounds = _rounds(_sum(sums, chosen), aim, enough)
    times = {pose: count * (rounds or _MANY) for pose, count in Counter(chosen).items()}
    ordered, values = _order_of_gain(sums, aim, times)
    return ChosenPoses(tuple(ordered), tuple(times[pose] for pose in ordered), values, rounds is not None)


def _sum(sums: Sums, chosen: Sequence[int]) -> Sums:
    return [part[list(chosen)].sum(0)[None] for part in sums]


def _greedy_choice(sums: Sums, aim: DesignCriterion, enough: float, most: int) -> tuple[list[int], float]:
    chosen: list[int] = []
    reached = -np.inf
    while reached < enough and len(chosen) < most:
        best, reached = _best_added(sums, aim, chosen)
        chosen.append(best)
    for index in range(len(chosen)):
        best, then = _best_added(sums, aim, chosen[:index] + chosen[index + 1 :])
        if then > reached:
            chosen[index], reached = best, then
    return chosen, reached


def _best_added(sums: Sums, aim: DesignCriterion, chosen: Sequence[int]) -> tuple[int, float]:
    there = _sum(sums, chosen)
    tried = np.argsort(-aim.promise(there, sums), kind="stable")[:_TRIED]
    values = aim.reached([present + part[tried] for present, part in zip(there, sums, strict=True)])
    best = int(np.argmax(values))
    return int(tried[best]), float(values[best])


def _order_of_gain(sums: Sums, aim: DesignCriterion, times: Mapping[int, int]) -> tuple[list[int], tuple[float, ...]]:
    """Return candidates sorted so that each adds most to those before it, and the values on the way."""
    left, ordered, values = list(times), list[int](), list[float]()
    there = [np.zeros_like(part[:1]) for part in sums]
    while left:
        count = np.array([times[pose] for pose in left])
        further = [present + part[left] * count[:, None, None] for present, part in zip(there, sums, strict=True)]
        found = aim.reached(further)
        best = int(np.argmax(found))
        there = [part[best][None] for part in further]
        ordered.append(left.pop(best))
        values.append(float(found[best]))
    return ordered, tuple(values)


def _rounds(sums: Sums, aim: DesignCriterion, enough: float) -> int | None:
    """Return the number of repetitions that a set (its sums, one trial) needs; None if no number is enough."""

    def at(times: int) -> float:
        return float(aim.reached([times * part for part in sums])[0])

    if at(_MANY) < enough:
        return None
    few, many = 0, _MANY
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if at(middle) >= enough else (middle, many)
    return many


def _absorbed(along: NDArray, information: NDArray) -> NDArray:
    """Return along^T (1 + information)^-1 along, (C,): the part of a gap that uncertain unknowns can absorb."""
    known = np.eye(information.shape[-1]) + information
    columns = np.broadcast_to(along, known.shape[:2])[..., None]
    return np.asarray(np.sum(columns * np.linalg.solve(known, columns), (1, 2)))


@dataclass(frozen=True)
class Readout:
    """Standard deviations (K,), SI, of a further reading and of its zero in a run."""

    sigma: NDArray
    zero: NDArray


@dataclass(frozen=True)
class Runs:
    """R runs of S ``steps`` each, in sequence in ``conditions`` (R S), and the channels that can be read in them.

    Candidate c is the run ``run`` (C,) with the channels ``reads`` (C, N).
    """

    conditions: Any  # of the model's own type
    steps: int
    run: NDArray
    reads: NDArray

    def by_run(self, values: NDArray) -> NDArray:
        """Return values (R S, K, ...) regrouped by candidate (C, S N, ...)."""
        count, read = self.reads.shape
        of_runs = values.reshape(len(values) // self.steps, self.steps, *values.shape[1:])
        of_run = of_runs[self.run[:, None, None], np.arange(self.steps)[:, None], self.reads[:, None]]
        return np.asarray(of_run.reshape(count, self.steps * read, *values.shape[2:]))


def run_candidates(fitted: Fitted, runs: Runs, readout: Readout) -> PoseCandidates:
    """Return runs as predicted by a fitted model; a run's own unknowns are its zeros and the load errors of its
    steps."""
    model = fitted.model.at(runs.conditions)
    count = len(runs.conditions.readings)
    found = model.predict(fitted.shared, np.zeros((count, model.local_size)))
    weight = 1.0 / readout.sigma[:, None]
    predicted = runs.by_run((found.values[:, :, 0] * weight[:, 0])[..., None])[..., 0]
    rows = runs.by_run(found.by_shared[:, :, 0] * weight)
    of_steps = _step_columns(runs.by_run(found.by_local[:, :, 0] * weight), runs.steps)
    by_shared = np.concatenate([of_steps, _zero_columns(runs, readout)], -1)
    priors = np.broadcast_to(np.eye(by_shared.shape[2]), (len(by_shared), *[by_shared.shape[2]] * 2))
    return PoseCandidates(fitted, predicted, rows, np.linalg.qr(np.concatenate([by_shared, priors], 1))[0])


def _step_columns(columns: NDArray, steps: int) -> NDArray:
    """Return the derivatives of readings (C, S N, H) by each step's own unknowns, as columns (C, S N, S H)."""
    count, size, each = columns.shape
    apart = columns.reshape(count, steps, size // steps, 1, each) * np.eye(steps)[:, None, :, None]
    return np.asarray(apart.reshape(count, size, steps * each))


def _zero_columns(runs: Runs, readout: Readout) -> NDArray:
    """Return the derivatives of readings (C, S N) by the zeros of their channels, (C, S N, N)."""
    count, read = runs.reads.shape
    zero_columns = (readout.zero / readout.sigma)[runs.reads]
    each = zero_columns[:, None, :, None] * np.eye(read)
    return np.broadcast_to(each, (count, runs.steps, read, read)).reshape(count, -1, read)
