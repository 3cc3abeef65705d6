"""Inputs that predict the residuals of a machine which no model of causes explains as a whole.

The residuals are modelled as noise plus a smooth random function of some inputs, a Gaussian process. All sets of one
and two inputs are compared by marginal likelihood, and sets of three that contain a probable pair. An input is named
if it belongs to the right set with high probability. A set of several inputs may therefore be named in part.

An effect on a group moves its places in one pattern, which is unknown, along a course over the epochs. So residuals in
space are reduced to their leading principal components: those beyond noise are such courses. Whatever a course
follows, or nothing, its evidence is against a course of the same size without any order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.evidence import log_evidence
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.search import LEAST_P

_ORDER = "order"
# Length scales of the functions, in standard deviations of the inputs; time has finer ones, for drifts and walks.
_SCALES, _SCALES_OF_TIME, _SCALE_OF_FIELDS = (0.5, 0.9, 1.6), (0.1, 0.25, 0.5, 0.9, 1.6), 1.0
_MOST_FUNCTIONS = 60  # of one set of inputs
_LARGEST_EFFECT = 10.0  # largest plausible effect, in units of the noise
_FIELDS = 8  # smooth patterns over the places of a group, in addition to its common shift
_THRESHOLDS = 0.08, 0.2, 0.4  # widths of play operators, relative to the range of an input
_LOOK_BACK = 0.5  # plausible effect of an input's history, relative to that of the input
_DISTINCT = 1e-2  # functions below this share of the strongest are dropped
_REPEATED = 0.7  # fewer distinct values than this share: functions of any form can be told from chance
_LEAST_VARIANCE = 1e-6  # the same for variances along eigenvectors
_PROBABLE_PAIRS = 6  # pairs to which third inputs are added
_INCLUDED = 0.9  # probability from which on an input is named
_MOST_SETS = 3  # sets of inputs that are named in turn
_MOST_HELD = 0.5  # largest number of functions held fixed, as a share of the epochs
_COPY = 1e-9  # largest relative difference of two copies
_FEWEST_EPOCHS = 20
_FEWEST_OF_PLACE = 12
_MOST_FREE = 400  # with more epochs, courses without any input are not tried
_MOST_COURSES = 4  # of one group
_DRAWS_OF_NOISE = 20
_LEAST_SQUARES = 1e-300
_LEAST_SHARE = 1e-6  # of the squares; less is told of no input
_CLIPPED = 4.0  # residuals beyond so many robust standard deviations are clipped


@dataclass(frozen=True)
class Attributed:
    """Inputs that predict residuals of some channels, or of all channels where ``channels`` is empty.

    ``share`` is the share of the residuals' squares that they predict beyond chance; ``p_value`` is corrected for all
    tests.
    """

    channels: tuple[int, ...]
    inputs: tuple[str, ...]
    share: float
    p_value: float


@dataclass(frozen=True)
class _Residuals:
    """Residuals (n, q) of a group at selected epochs (B,), of some channels, or of all where ``channels`` is empty.

    A course is known to exceed noise, and only what it follows is open. ``share`` is the share of the residuals in the
    squares of their group.
    """

    channels: tuple[int, ...]
    epochs: Mask
    rows: Array
    group: int
    share: float
    is_course: bool


def attributed(models: Sequence[FittedModel[CauseT]], level: float, level_of_course: float) -> tuple[Attributed, ...]:
    """Return the inputs that predict the residuals of models of one campaign, at a familywise p-value of ``level``.

    What a course follows is a question of its own, decided at ``level_of_course`` for each. Shares are of the squares
    of the first model's residuals.
    """
    first = models[0]
    columns = _columns(first, first.model.error_groups)
    tried = [one for own in models for one in _residuals(own, first) if one.epochs.sum() >= _FEWEST_EPOCHS]
    known: dict[bytes, _Spectra] = {}  # of the last epochs alone: all spectra of a long campaign take much memory
    found: list[Attributed] = []
    for one in sorted(tried, key=lambda one: one.group):
        at = one.epochs
        if (key := at.tobytes()) not in known:
            own = {name: values[at] for name, values in columns.items() if np.ptp(values[at]) > 0.0}
            known.clear()
            known[key] = _Spectra(own, _in_time(first, at))
        tests, least = (1, level_of_course) if one.is_course else (len(tried), level / len(tried))
        for inputs, share, p_value in _sets_of_inputs(one.rows, known[key], least):
            if one.share * share < _LEAST_SHARE:
                continue
            found.append(Attributed(one.channels, inputs, one.share * share, min(1.0, max(p_value * tests, LEAST_P))))
    return tuple(_merged(found))


def random_courses(fitted: FittedModel[CauseT]) -> dict[tuple[str, ...], list[Array]]:
    """Return random courses over the epochs as functions (B, m), of unit variance on average, by the inputs followed.

    They are smooth in an input, with its history or without, or linear in all inputs. Courses that follow no input
    walk in the order of the epochs, or have no order.
    """
    groups = fitted.model.error_groups
    columns, whole = _columns(fitted, groups), np.ones(len(fitted.measured.values), bool)
    spectra = _Spectra(columns, _in_time(fitted, whole))
    found: dict[tuple[str, ...], list[Array]] = {(name,): list(spectra.functions((name,))) for name in columns}
    asked = [own[:, None] for own in map(_numbers, fitted.scene.inputs.values()) if own is not None]
    inputs = tuple(name for name, own in columns.items() if any(_is_copy(own[:, None], one, None) for one in asked))
    if len(inputs) > 1:
        together = np.column_stack([columns[name] for name in inputs])
        found[inputs] = [_standard(together), *([] if (levels := _levels(together)) is None else [levels])]
    if len(whole) <= _MOST_FREE:
        order = spectra.in_time.order
        walk = [] if order is None else [np.tri(len(whole))[np.argsort(np.argsort(order))]]
        found[()] = [*walk, np.eye(len(whole))]
    return {name: [_of_unit_variance(own) for own in several] for name, several in found.items()}


def random_factors(fitted: FittedModel[CauseT]) -> dict[tuple[str, ...], Array]:
    """Return gentle random functions (B, m) of each input, of unit variance on average, by the input."""
    columns = _columns(fitted, fitted.model.error_groups)
    return {
        (name,): _of_unit_variance(_centred(next(_smooth(own[:, None], _MOST_FUNCTIONS, _SCALES[-1:]))))
        for name, own in columns.items()
    }


def _of_unit_variance(functions: Array) -> Array:
    return np.asarray(functions / np.sqrt(np.mean(np.sum(_centred(functions) ** 2, 1))))


def p_value_of_dependence(rest: Array, own: Mask, fitted: FittedModel[CauseT]) -> float:
    """Return the p-value of a dependence of errors on inputs, in places ``own`` (B, K) of errors (B, K, d)."""
    at, channels = np.asarray(own.any(1)), own.any(0)
    if at.sum() < _FEWEST_OF_PLACE:
        return 1.0
    rows = np.nan_to_num(np.where(own[..., None], rest, 0.0)[at][:, channels].reshape(int(at.sum()), -1))
    groups = fitted.model.error_groups
    columns = {name: values[at] for name, values in _columns(fitted, groups).items() if np.ptp(values[at]) > 0.0}
    if not columns or not rows.any():
        return 1.0
    whole = _clipped(_condensed(_centred(rows)))
    odds = _odds_of_sets(whole, _Spectra(columns, _in_time(fitted, at)))
    return float(min(1.0, np.exp(-np.logaddexp.reduce(list(odds.values())))))


def _in_time(fitted: FittedModel[CauseT], at: Mask) -> _InTime:
    """Return the order, the groups and the known histories of the epochs ``at`` (B,)."""
    scene = fitted.scene
    order = _at_epochs(scene.covariates.get(_ORDER), at)
    known = [(np.asarray(scene.inputs[name], float)[at], own[at]) for name, own in scene.histories.items()]
    return _InTime(order, _at_epochs(fitted.model.error_groups, at), tuple(known))


def _at_epochs(values: Array | Integers | None, at: Mask) -> Array | None:
    return None if values is None else np.asarray(values, float)[at]


def _merged(found: Iterable[Attributed]) -> Iterator[Attributed]:
    """Yield one entry for all entries of the same channels whose inputs are contained in it."""
    left = sorted(found, key=lambda one: -len(one.inputs))
    while left:
        first = left[0]
        alike = [one for one in left if one.channels == first.channels and set(one.inputs) <= set(first.inputs)]
        share, p_value = max(one.share for one in alike), min(one.p_value for one in alike)
        left = [one for one in left if all(one is not other for other in alike)]
        yield Attributed(first.channels, first.inputs, share, p_value)


def _columns(fitted: FittedModel[CauseT], groups: Integers | None) -> dict[str, Array]:
    """Return the inputs (B,) that vary, without the order of the epochs. Of copies, in other units or of one clock, the
    first: functions of the others would count twice."""
    scene = fitted.scene
    found: dict[str, Array] = {}
    for name, values in {**scene.covariates, **scene.inputs}.items():
        own = _numbers(values)
        if name == _ORDER or own is None:
            continue
        if not any(_is_copy(own[:, None], other[:, None], groups) for other in found.values()):
            found[name] = own
    return found


def _numbers(values: ArrayLike) -> Array | None:
    """Return a column (B,) of numbers; None if it holds something else, a gap, or a constant."""
    if np.ndim(values) != 1 or np.asarray(values).dtype.kind not in "fiu":
        return None
    own: Array = np.asarray(values, float)
    return own if np.isfinite(own).all() and np.ptp(own) > 0.0 else None


def _is_copy(first: Array, second: Array, groups: Integers | None) -> bool:
    """Return True if two columns (B, 1) differ only by a factor, and by a constant in each group."""
    one, other = (_centred(own / np.ptp(own), groups) for own in (first, second))
    product = float(np.sum(one * other))
    of_one, of_other = (max(float(np.sum(own**2)), 1e-300) for own in (one, other))
    left = one - product / of_other * other, other - product / of_one * one
    return bool(max(np.abs(own).max() for own in left) < _COPY)


def _residuals(fitted: FittedModel[CauseT], first: FittedModel[CauseT]) -> Iterator[_Residuals]:
    """Yield the residuals to be explained. Where observations are numbers: one set per channel. In space: the courses
    of each group. Shares are of the squares of a first model's residuals."""
    measured = fitted.measured
    own = _groups_of_residuals(fitted)
    squares = map(_squares, own if first is fitted else _groups_of_residuals(first))
    for group, (rows, whole) in enumerate(zip(own, squares, strict=True)):
        if measured.size == 1:
            at = measured.seen[:, group] & np.isfinite(rows).all(1)
            if at.any():
                share = min(1.0, _squares(rows) / max(whole, _LEAST_SQUARES))
                yield _Residuals((group,), at, rows[at], group, share, is_course=False)
            continue
        for course in courses(rows):
            share = min(1.0, float(np.sum(course**2)) / max(whole, _LEAST_SQUARES))
            yield _Residuals((), np.ones(len(rows), bool), course, group, share, is_course=True)


def _groups_of_residuals(fitted: FittedModel[CauseT]) -> list[Array]:
    """Return residuals (B, q) by group. Where observations are numbers: those of each channel, NaN where unseen. In
    space: those of all inputs together, and for each group of channels those of the projection on smooth fields over
    its places, along its own axes."""
    measured, whitened = fitted.measured, fitted.fit.whitened
    epochs, channels, size = measured.values.shape
    if size == 1:
        return [fitted.standardised[:, channel] for channel in range(channels)]
    height = channels * size
    rest = whitened.rest[: epochs * (height + whitened.problem.local_value.shape[1])].reshape(epochs, -1)
    of_groups = [rest[:, height + fitted.input_rows.start : height + fitted.input_rows.stop]]
    axes = (
        measured.whitener @ fitted.fit.frames.R[:, None] @ fitted.model.rotations(fitted.fit.shared, fitted.fit.local)
    )
    along = np.einsum("bkij,bki->bkj", axes, rest[:, :height].reshape(epochs, channels, size))
    for group in np.unique(fitted.model.channel_groups):
        own = fitted.model.channel_groups == group
        fields = _fields(np.asarray(fitted.scene.shape, float)[own])
        of_groups.append(np.einsum("bki,kp->bpi", along[:, own], fields).reshape(epochs, -1))
    return of_groups


def _squares(rows: Array) -> float:
    """Return the sum of squares of centred residuals (B, q), without epochs that hold a gap."""
    kept = rows[np.isfinite(rows).all(1)]
    return float(np.sum(_centred(kept) ** 2)) if len(kept) else 0.0


def courses(rows: Array) -> Iterator[Array]:
    """Yield the leading principal components (n, 1) of rows (n, q) that exceed noise of the same size; none of few
    epochs.

    Noise is drawn as many times; its size follows from the median of all components, most of which are noise.
    """
    count = min(len(rows) - 1, rows.shape[1])
    if len(rows) < _FEWEST_EPOCHS or not (centred := _centred(rows)).any():
        return
    left, size, _ = np.linalg.svd(centred, full_matrices=False)
    rng = np.random.default_rng(len(rows))
    drawn = [
        np.linalg.svd(_centred(rng.normal(size=rows.shape)), compute_uv=False)[:count] for _ in range(_DRAWS_OF_NOISE)
    ]
    limit = float(np.median(size[:count]) * np.max([own[0] / np.median(own) for own in drawn]))
    for k in range(min(_MOST_COURSES, int(np.sum(size[:count] > limit)))):
        yield left[:, k : k + 1] * size[k]


def _fields(places: Array) -> Array:
    """Return smooth orthonormal patterns (K, p) over places (K, 0 to 3), a common shift among them."""
    ones = np.ones((len(places), 1))
    if not places.shape[1] or len(places) < 2:
        return _orthonormal(ones)
    return _orthonormal(np.column_stack([ones, *_smooth(places[:, :2], _FIELDS, (_SCALE_OF_FIELDS,))]))


@dataclass(frozen=True)
class _InTime:
    """Order in time (n,) of the epochs and the groups (n,) within which they follow each other; None where unknown.

    ``known``: inputs (n,) whose history (n, m) is known, with it. Epochs that are left out are part of it.
    """

    order: Array | None
    groups: Array | None
    known: tuple[tuple[Array, Array], ...] = ()

    @property
    def _sorted(self) -> tuple[Integers, Integers]:
        """Epochs sorted by time within each group, and their groups."""
        assert self.order is not None
        groups = np.zeros(len(self.order), int) if self.groups is None else self.groups.astype(int)
        in_time = np.lexsort((self.order, groups))
        return in_time, groups[in_time]

    def history(self, values: Array) -> Array | None:
        """Return the history of an input (n,): its lead over play operators of several widths, and its previous value
        (n, 4). None where no order is known."""
        for reading, past in self.known:
            if np.ptp(reading) > 0.0 and _is_copy(values[:, None], reading[:, None], None):
                return past
        if self.order is None:
            return None
        x, (in_time, groups) = _standard(values[:, None])[:, 0], self._sorted
        found = np.zeros((len(x), len(_THRESHOLDS) + 1))
        reach = np.array(_THRESHOLDS) * max(float(np.ptp(x)), 1e-12)
        ahead = np.zeros(len(reach))
        for place, now in enumerate(in_time):
            first = place == 0 or groups[place] != groups[place - 1]
            last = now if first else in_time[place - 1]
            ahead = 0.0 * ahead if first else np.clip(ahead + x[now] - x[last], -reach, reach)
            found[now] = [*(ahead / reach), x[last]]
        return found


@dataclass(frozen=True)
class _Spectrum:
    """Eigenvectors of the covariance of a random function at the epochs, and the roots (r,) of its eigenvalues.

    The function has unit variance on average. The eigenvectors are ``functions`` (n, m), free of what is held, times
    ``weights`` (m, r).
    """

    functions: Array
    weights: Array
    strengths: Array

    def along(self, rest: Array) -> Array:
        """Return the parts (r, q) of residuals (n, q) along the eigenvectors; the residuals are free of what is held,
        so the functions need not be."""
        return np.asarray(self.weights.T @ (self.functions.T @ rest))


@dataclass(frozen=True)
class _Spectra:
    """Spectra of functions of sets of inputs; ``held`` (n, h) are orthonormal functions from which they are free."""

    columns: Mapping[str, Array]
    in_time: _InTime
    held: Array | None = None
    # Functions of each set of inputs, which do not depend on what is held: made once for all spectra.
    made: dict[tuple[str, ...], list[Array]] = field(default_factory=dict, repr=False)

    def of(self, inputs: tuple[str, ...]) -> list[_Spectrum]:
        """Return the spectra of a set of inputs, one for each length scale, and for the history of a single input."""
        if inputs not in self._known:
            if inputs not in self.made:
                self.made[inputs] = list(self.functions(inputs))
            found = (self._spectrum(functions) for functions in self.made[inputs])
            self._known[inputs] = [own for own in found if own is not None]
        return self._known[inputs]

    def beyond(self, functions: Array) -> _Spectra:
        """Return the spectra free of further functions (n, m)."""
        held = functions if self.held is None else np.column_stack([self.held, functions])
        return _Spectra(self.columns, self.in_time, _orthonormal(held), self.made)

    def free(self, rows: Array) -> Array:
        """Return rows (n, m), centred, without the functions that are held fixed."""
        own = _centred(rows)
        return own if self.held is None else _centred(own - self.held @ (self.held.T @ own))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of residuals."""
        return len(next(iter(self.columns.values()))) - 1 - (0 if self.held is None else self.held.shape[1])

    def functions(self, inputs: tuple[str, ...]) -> Iterator[Array]:
        own = np.column_stack([self.columns[name] for name in inputs])
        is_time = len(inputs) == 1 and inputs[0] in self._timed
        smooth = list(_smooth(own, _MOST_FUNCTIONS, _SCALES_OF_TIME if is_time else _SCALES))
        yield from smooth
        if not is_time and (levels := _levels(own)) is not None:
            yield levels
        if len(inputs) == 1 and not is_time and (history := self.in_time.history(own[:, 0])) is not None:
            past = _LOOK_BACK * _standard(history)
            yield past
            yield np.column_stack([smooth[1], past])

    def _spectrum(self, functions: Array) -> _Spectrum | None:
        free = self.free(functions)
        values, vectors = np.linalg.eigh(free.T @ free)
        # What the held functions explain is no new function.
        kept = values > _LEAST_VARIANCE * max(values[-1], float(np.sum(_centred(functions) ** 2)))
        if not kept.any():
            return None
        unit = values[kept] / values[kept].sum() * len(free)
        return _Spectrum(functions, vectors[:, kept] / np.sqrt(values[kept]), np.sqrt(unit))

    def vectors(self, spectrum: _Spectrum, chosen: Integers) -> Array:
        """Return some eigenvectors (n, k) of a spectrum."""
        return self.free(spectrum.functions) @ spectrum.weights[:, chosen]

    @cached_property
    def _timed(self) -> frozenset[str]:
        return _timed(self.columns, self.in_time)

    @cached_property
    def _known(self) -> dict[tuple[str, ...], list[_Spectrum]]:
        return {}


def _dependences(
    rows: Array, columns: Mapping[str, Array], in_time: _InTime, level: float
) -> Iterator[tuple[tuple[str, ...], float, float]]:
    """Yield names, share and p-value of the inputs on which residuals (n, q) depend, set by set."""
    yield from _sets_of_inputs(rows, _Spectra(columns, in_time), level)


def _sets_of_inputs(rows: Array, spectra: _Spectra, level: float) -> Iterator[tuple[tuple[str, ...], float, float]]:
    whole = _clipped(_condensed(_centred(rows)))
    total = float(np.sum(whole**2))
    for _ in range(_MOST_SETS):
        rest = spectra.free(whole)
        odds = _odds_of_sets(rest, spectra)
        # The mean of likelihood ratios exceeds 1 / p by chance with a probability of at most p (Markov's inequality).
        p_value = float(np.exp(-np.logaddexp.reduce(list(odds.values())))) if odds else 1.0
        if p_value > level:
            return
        inputs = tuple(name for name in spectra.columns if _probability(name, odds) >= _INCLUDED)
        best = max((own for own in odds if set(inputs) <= set(own)), key=lambda own: odds[own])
        functions, squares = _explained(rest, spectra, best)
        if inputs and squares > 0.0:  # no more than chance is no prediction, whatever its evidence
            yield inputs, min(1.0, squares / total), p_value
        spectra = spectra.beyond(functions)
        if spectra.held is None or spectra.held.shape[1] > _MOST_HELD * len(rest):
            return


def _odds_of_sets(rest: Array, spectra: _Spectra) -> dict[tuple[str, ...], float]:
    """Return the log odds of every set of inputs over noise alone, from residuals (n, q); all sizes of sets have equal
    prior probability, and all sets of a size."""
    names = list(spectra.columns)
    found: dict[tuple[str, ...], float] = {}
    for size in (1, 2, 3):
        possible = list(combinations(names, size))
        if size > len(names) or not possible:
            break
        prior = -np.log(3.0 * len(possible))
        if size == 3:
            pairs = sorted((own for own in found if len(own) == 2), key=lambda own: -found[own])[:_PROBABLE_PAIRS]
            possible = [own for own in possible if any(set(pair) <= set(own) for pair in pairs)]
        for own in possible:
            found[own] = float(np.sum(_log_evidence(rest, spectra, own))) + prior
    return found


def _log_evidence(rest: Array, spectra: _Spectra, inputs: tuple[str, ...]) -> Array:
    """Return the log evidence (q,) of a dependence on a set of inputs, column by column of residuals (n, q)."""
    # Few columns depend on anything: about the root of their number.
    responds = 1.0 / (1.0 + np.sqrt(rest.shape[1]))
    own = [_of_spectrum(rest, spectrum, spectra.freedom) for spectrum in spectra.of(inputs)]
    if not own:
        return np.zeros(rest.shape[1])
    mean = np.logaddexp.reduce(own, axis=0) - np.log(len(own))
    return np.asarray(np.logaddexp(np.log1p(-responds), np.log(responds) + mean))


def _of_spectrum(rest: Array, spectrum: _Spectrum, freedom: int) -> Array:
    along = spectrum.along(rest).T
    return log_evidence(along, spectrum.strengths, np.sum(rest**2, 0), freedom, _LARGEST_EFFECT / 3.0)


def _probability(name: str, odds: Mapping[tuple[str, ...], float]) -> float:
    """Return the probability that an input belongs to the set on which the residuals depend."""
    every = np.logaddexp.reduce(list(odds.values()))
    with_it = [own for inputs, own in odds.items() if name in inputs]
    return float(np.exp(np.logaddexp.reduce(with_it) - every))


def _explained(rest: Array, spectra: _Spectra, inputs: tuple[str, ...]) -> tuple[Array, float]:
    """Return the functions (n, m) of a set of inputs that residuals (n, q) need, and the squares that they predict
    beyond chance."""
    evidence = [_of_spectrum(rest, own, spectra.freedom) for own in spectra.of(inputs)]
    best = spectra.of(inputs)[int(np.argmax(np.sum(np.maximum(evidence, 0.0), 1)))]
    along = best.along(rest)
    strongest = np.argsort(-best.strengths)
    # A direction counts if noise of one unit leaves the effect visible there.
    count = int(np.clip(np.sum(best.strengths > 1.0), 1, max(spectra.freedom // 3, 1)))
    basis = spectra.vectors(best, strongest[:count])
    squares = float(np.sum(along[strongest[:count]] ** 2))
    left = float(np.sum(rest**2)) - squares
    return basis, squares - count * left / max(spectra.freedom - count, 1)


def _timed(columns: Mapping[str, Array], in_time: _InTime) -> frozenset[str]:
    """Return the columns that never decrease in time: a dependence on these may itself be serial correlation."""
    if in_time.order is None:
        return frozenset()
    order = np.argsort(in_time.order, kind="stable")
    return frozenset(name for name, values in columns.items() if np.all(np.diff(values[order]) >= 0.0))


def _clipped(rows: Array) -> Array:
    """Return centred rows (n, q) with outliers clipped: one of them would pass for a narrow peak of a function."""
    robust = 1.4826 * np.median(np.abs(rows - np.median(rows, 0)), 0)
    limit = _CLIPPED * np.maximum(robust, 0.5 * rows.std(0))
    return _centred(np.clip(rows, -limit, limit))


def _smooth(columns: Array, most: int, scales: Sequence[float]) -> Iterator[Array]:
    """Yield functions (n, m) of inputs (n, D) that approximate a Gaussian process, for each length scale in standard
    deviations of the inputs. The products of the functions are the covariance of the process, exact at its landmarks,
    of which there are at most ``most``."""
    x = _standard(columns)
    marks = _landmarks(x, most)
    among, beside = _exponents(marks, marks), _exponents(x, marks)
    for scale in scales:
        values, vectors = np.linalg.eigh(np.exp(among / scale**2))
        kept = values > 1e-4 * values[-1]
        yield np.asarray(np.exp(beside / scale**2) @ (vectors[:, kept] / np.sqrt(values[kept])))


def _levels(columns: Array) -> Array | None:
    """Return indicators (n, m) of the distinct values of inputs (n, D), for functions of any form; None where too few
    are repeated."""
    distinct, number = np.unique(np.round(_standard(columns), 9), axis=0, return_inverse=True)
    return np.eye(len(distinct))[number.ravel()] if len(distinct) <= _REPEATED * len(columns) else None


def _landmarks(x: Array, most: int) -> Array:
    """Return at most ``most`` landmarks (n, D): the place nearest to the middle, then repeatedly the farthest one."""
    distinct = _distinct(np.round(x, 9))
    if len(distinct) <= most:
        return distinct
    chosen = [int(np.argmin(np.sum(distinct**2, 1)))]
    far = np.sum((distinct - distinct[chosen[0]]) ** 2, 1)
    while len(chosen) < most:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.sum((distinct - distinct[chosen[-1]]) ** 2, 1))
    return distinct[chosen]


def _distinct(rows: Array) -> Array:
    """Return the distinct ones of rows (n, D), sorted; in a fraction of the time that `numpy.unique` takes."""
    ordered = rows[np.lexsort(rows.T[::-1])]
    return np.asarray(ordered[np.concatenate([[True], np.any(ordered[1:] != ordered[:-1], 1)])])


def _exponents(first: Array, second: Array) -> Array:
    """Return the exponents (n, m) of a Gaussian covariance of unit length scale between places (n, D) and (m, D)."""
    squares = np.sum(first**2, 1)[:, None] + np.sum(second**2, 1) - 2.0 * (first @ second.T)
    return np.asarray(-0.5 * np.maximum(squares, 0.0))


def _standard(columns: Array) -> Array:
    spread = columns.std(0)
    return np.asarray((columns - columns.mean(0)) / np.where(spread > 0.0, spread, 1.0))


def _centred(rows: Array, groups: Integers | None = None) -> Array:
    """Return rows (n, q) less their mean, group by group."""
    if groups is None:
        return np.asarray(rows - rows.mean(0))
    number = np.unique(groups, return_inverse=True)[1]
    mean = np.stack([np.bincount(number, column) for column in rows.T], -1) / np.bincount(number)[:, None]
    return np.asarray(rows - mean[number])


def _condensed(rows: Array) -> Array:
    """Return rows (n, q) reduced to as many columns as their rank."""
    left, size, _ = np.linalg.svd(rows, full_matrices=False)
    kept = size > 1e-6 * size.max(initial=0.0)
    return np.asarray(left[:, kept] * size[kept])


def _orthonormal(functions: Array, least: float = _DISTINCT) -> Array:
    """Return an orthonormal basis (n, r) of functions (n, m), without directions below a share of the largest."""
    basis, size, _ = np.linalg.svd(functions, full_matrices=False)
    return np.asarray(basis[:, size > least * size.max(initial=0.0)])
