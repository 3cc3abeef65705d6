"""Tests of a final model as a whole: are its residuals consistent with noise alone, whatever causes it holds?

A search compares forms with each other; it does not test whether the true form is among them. A wrong model shows in
three ways. Its noise is larger than declared, of observations or of inputs, which absorb what no cause explains. Its
residuals are correlated between neighbours in time or in an input, or between neighbouring places of a group. Or they
have a mean at repeated epochs or in a region of the inputs. Means are tested against the scatter within repeats or
regions, whatever noise was declared.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.blocks import FEWEST_BLOCKS, regions
from truing.inference.fitted_model import FittedModel
from truing.inference.group_means import EpochResiduals, epoch_residuals, means_against_scatter, means_of_columns
from truing.inference.model import CauseT
from truing.inference.noise import NOISE_PRIOR_FREEDOM, NoiseLevel
from truing.inference.spatial_correlation import has_neighbours, spatial_correlation

_PERMUTATIONS = 499
_NEIGHBOURS = 2
# With fewer epochs, neighbours are not tested; of more epochs, a sample is tested.
_FEWEST_EPOCHS, _MOST_EPOCHS = 8, 2_000
# Fewest epochs beyond the first of each group of repeats, or of each region, for an F test.
_FEWEST_REPEATS = 4.0
# This many permutations that are as extreme determine the p-value, however few were drawn; with fewer than the second
# among all, the p-value is the normal tail.
_DETERMINED, _RESOLVED = 20, 11


class MisfitKind(StrEnum):
    """Kind of misfit that is tested."""

    OBSERVATION_NOISE = "observation-noise"  # more noise of observations than declared
    INPUT_NOISE = "input-noise"  # more noise of inputs than declared
    LIKE_NEIGHBOURS = "like-neighbours"  # residuals of neighbouring epochs are correlated
    LIKE_PLACES = "like-places"  # residuals of neighbouring places of a group are correlated within epochs
    PURE_ERROR = "pure-error"  # residuals of repeats have a mean larger than their scatter explains
    BY_REGION = "by-region"  # residuals in a region of the inputs have a mean larger than their scatter explains
    PARTS = "parts"  # errors of single parts depend on inputs; listed only where the search for them ended early


class WhyUntested(StrEnum):
    """Reasons that leave a kind of misfit untested."""

    NO_REPEATS = "no-repeats"  # nothing was measured twice at the same command
    TOO_FEW = "too-few"
    TOO_LARGE = "too-large"  # it would take too long


@dataclass(frozen=True)
class AdequacyTest:
    """One test of the final model: kind of misfit, column, value found, p-value.

    ``value`` is the noise over the declared one, the correlation of neighbours, or F: the mean square of means over
    that of the scatter about them. ``along`` is the column whose neighbours are compared, or the inputs of the regions;
    empty for noise, places and repeats.
    """

    lack: MisfitKind
    along: str
    value: float
    p_value: float


@dataclass(frozen=True)
class Adequacy:
    """All tests of a final model."""

    tests: tuple[AdequacyTest, ...]
    repeated: bool = False  # whether anything was measured twice at the same command
    not_asked: frozenset[MisfitKind] = frozenset()  # kinds whose data (commands, inputs) the campaign does not have
    too_large: frozenset[MisfitKind] = frozenset()  # kinds whose tests would take too long

    @property
    def worst(self) -> AdequacyTest | None:
        """The test with the smallest corrected p-value, None where nothing could be tested."""
        return min(self.tests, key=self.corrected, default=None)

    @property
    def p_value(self) -> float:
        """Probability that the worst test of an adequate model is as bad as this one."""
        return 1.0 if self.worst is None else self.corrected(self.worst)

    @property
    def untested(self) -> list[MisfitKind]:
        """Kinds of misfit that the campaign has too few data to test, or too many."""
        known = self.not_asked | {MisfitKind.PARTS} - self.too_large | {test.lack for test in self.tests}
        return [lack for lack in MisfitKind if lack not in known]

    def why_untested(self, lack: MisfitKind) -> WhyUntested:
        """Reason that leaves a kind of misfit untested."""
        if lack in self.too_large:
            return WhyUntested.TOO_LARGE
        is_known = lack == MisfitKind.PURE_ERROR and not self.repeated
        return WhyUntested.NO_REPEATS if is_known else WhyUntested.TOO_FEW

    def corrected(self, test: AdequacyTest) -> float:
        """A test's p-value, corrected for the kinds of misfit and for the tests of its kind (Bonferroni)."""
        kinds = len({other.lack for other in self.tests})
        return min(1.0, test.p_value * kinds * sum(other.lack == test.lack for other in self.tests))


def adequacy_of(
    final: FittedModel[CauseT], noise: NoiseLevel, rng: np.random.Generator, repeats: Integers | None = None
) -> Adequacy:
    """Return all tests of a final model, with the level of its noise over the declared one.

    ``repeats`` (B,): number of each command that was given more than once, -1 for the others; None if unknown.
    """
    tests = [AdequacyTest(MisfitKind.OBSERVATION_NOISE, "", noise.ratio, noise.p_value)]
    ratio, freedom = final.input_noise
    if freedom >= _FEWEST_EPOCHS:
        tests.append(noise_excess(MisfitKind.INPUT_NOISE, ratio, freedom))
    tests += like_neighbours(final.standardised, _orderings(final), rng, final.model.error_groups)
    inputs = dict(final.scene.inputs)
    residuals = epoch_residuals(final.fit.whitened, final.measured, final.fit.frames, final.input_rows)
    tests += by_region(residuals, inputs)
    tests += by_place(final, rng)
    known = {
        MisfitKind.BY_REGION: bool(inputs),
        MisfitKind.PURE_ERROR: repeats is not None,
        MisfitKind.LIKE_PLACES: final.measured.size > 1 and has_neighbours(final.model.channel_groups),
    }
    not_asked = {lack for lack, is_known in known.items() if not is_known}
    if repeats is None:
        return Adequacy(tuple(tests), not_asked=frozenset(not_asked))
    repeated = bool((np.bincount(repeats[repeats >= 0]) > 1).any())
    return Adequacy((*tests, *pure_error(residuals, repeats)), repeated, frozenset(not_asked))


def _orderings(fitted: FittedModel[CauseT]) -> dict[str, Array]:
    """Return the columns (B,) along which epochs can be neighbours, and all inputs together (B, D)."""
    inputs = dict(fitted.scene.inputs)
    columns = {name: values for name, values in fitted.scene.covariates.items() if np.ndim(values) == 1} | inputs
    if len(inputs) > 1:
        columns[" ".join(inputs)] = np.column_stack(list(inputs.values()))
    return columns


def is_like_noise(residuals: Array, selected: Mask, fitted: FittedModel[CauseT], level: float) -> bool:
    """Return True if residuals of selected places are as uncorrelated as noise.

    ``residuals`` (B, K, d) are standardised residuals, ``selected`` (B, K) selects places, ``level`` is the p-value
    above which no correlation counts. Neighbouring epochs are compared; of too few, the means of each place, and
    neighbouring places within an epoch. False where nothing can be compared."""
    p_value = p_value_of_order(residuals, selected, fitted)
    if p_value is None:
        p_value = _p_value_of_few_epochs(residuals, selected, fitted)
    return p_value is not None and p_value > level


def _p_value_of_few_epochs(residuals: Array, selected: Mask, fitted: FittedModel[CauseT]) -> float | None:
    """Return the p-value of what is common to residuals (B, K, d) of a few epochs: at a place over these epochs, or at
    neighbouring places in one of them. It is corrected for the number of tests; None where neither can be tested."""
    p_values = []
    means = means_of_columns(np.where(selected[..., None], residuals, np.nan).reshape(len(residuals), -1))
    if means is not None:
        p_values.append(means.p_value)
    neighbours = spatial_correlation(
        fitted.fit.whitened,
        fitted.measured.values.shape,
        np.asarray(fitted.scene.shape, float),
        fitted.model.channel_groups,
        np.random.default_rng(len(residuals)),
        np.flatnonzero(selected.any(1)),
    )
    if neighbours is not None:
        p_values.append(neighbours.p_value)
    return min(p_values) * len(p_values) if p_values else None


def p_value_of_order(residuals: Array, selected: Mask, fitted: FittedModel[CauseT]) -> float | None:
    """Return the p-value of correlations between neighbours in residuals (B, K, d) of places ``selected`` (B, K).

    It is corrected for the number of orderings; None where too few epochs can be tested.
    """
    rng = np.random.default_rng(len(residuals))
    tested = np.where(selected[..., None], residuals, np.nan)
    tests = list(like_neighbours(tested, _orderings(fitted), rng, fitted.model.error_groups))
    return min(test.p_value for test in tests) * len(tests) if tests else None


def pure_error(residuals: EpochResiduals, repeats: Integers) -> Iterator[AdequacyTest]:
    """Yield the F test of lack of fit against pure error, if there are enough repeats.

    ``repeats`` (B,): number of each epoch's command, -1 for none.
    """
    lack_of_fit = means_against_scatter(residuals, repeats, _FEWEST_REPEATS)
    if lack_of_fit is not None:
        yield AdequacyTest(MisfitKind.PURE_ERROR, "", lack_of_fit.ratio, lack_of_fit.p_value)


def by_region(residuals: EpochResiduals, inputs: Mapping[str, Array]) -> Iterator[AdequacyTest]:
    """Yield the F test of the residual means in regions of the inputs, each (B,), against the scatter about them."""
    columns = np.column_stack(list(inputs.values())) if inputs else np.zeros((len(residuals.values), 0))
    varies = np.isfinite(columns).all(0) & (np.ptp(columns, axis=0) > 0.0)
    if not varies.any():
        return
    region = regions(columns[:, varies])
    if region.max() + 1 < FEWEST_BLOCKS or np.bincount(region).min() < _FEWEST_EPOCHS:
        return
    if (lack_of_fit := means_against_scatter(residuals, region, _FEWEST_REPEATS)) is not None:
        yield AdequacyTest(MisfitKind.BY_REGION, " ".join(inputs), lack_of_fit.ratio, lack_of_fit.p_value)


def by_place(final: FittedModel[CauseT], rng: np.random.Generator) -> Iterator[AdequacyTest]:
    """Yield the correlation of residuals of neighbouring places of a group within epochs, if there are such places."""
    places, groups = np.asarray(final.scene.shape, float), final.model.channel_groups
    neighbours = spatial_correlation(final.fit.whitened, final.measured.values.shape, places, groups, rng)
    if neighbours is not None:
        yield AdequacyTest(MisfitKind.LIKE_PLACES, "", neighbours.correlation, neighbours.p_value)


def noise_excess(lack: MisfitKind, ratio: float, freedom: float) -> AdequacyTest:
    """Test the ratio of found to declared noise, one-sided; the declared noise is known to about 10 %.

    ``freedom``: degrees of freedom of the noise found.
    """
    spread = math.sqrt(0.5 / NOISE_PRIOR_FREEDOM + 0.5 / freedom)
    return AdequacyTest(lack, "", ratio, 0.5 * math.erfc(math.log(ratio) / spread / math.sqrt(2.0)))


def like_neighbours(
    residuals: Array, columns: Mapping[str, Array], rng: np.random.Generator, groups: Integers | None = None
) -> Iterator[AdequacyTest]:
    """Yield the correlation of residuals (B, K, d) between epochs that are neighbours along each column (B,) or (B, D).

    Residuals have unit noise, NaN where unseen. Each epoch is compared with the nearest ones, channel by channel. The
    p-value comes from random permutations of the epochs, within ``groups`` (B,) if only epochs of a group are
    exchangeable.
    """
    rows = residuals.reshape(len(residuals), -1)
    observed = np.isfinite(rows).any(1)
    if observed.sum() < _FEWEST_EPOCHS:
        return
    chosen = np.flatnonzero(observed)
    if len(chosen) > _MOST_EPOCHS:
        chosen = np.sort(rng.choice(chosen, _MOST_EPOCHS, replace=False))
    products = _products(rows[chosen])
    orders = _Orders(len(chosen), None if groups is None else groups[chosen], rng)
    for name, values in columns.items():
        values_at_epochs = np.asarray(values, float).reshape(len(values), -1)[chosen]
        if np.isfinite(values_at_epochs).all() and np.ptp(values_at_epochs, axis=0).any():
            yield AdequacyTest(
                MisfitKind.LIKE_NEIGHBOURS,
                name,
                *_neighbour_correlation(products, _neighbours(values_at_epochs), orders),
            )


def _products(rows: Array) -> Array:
    """Return the mean products (B, B) of two epochs' residuals (B, C), scaled to unit variance, over channels seen in
    both."""
    is_observed = np.isfinite(rows)
    count = np.maximum(is_observed.sum(0), 1)
    centred = np.where(is_observed, rows - np.where(is_observed, rows, 0.0).sum(0) / count, 0.0)
    centred = centred / np.maximum(np.sqrt((centred**2).sum(0) / count), 1e-12)
    return np.asarray(centred @ centred.T / np.maximum(is_observed.astype(float) @ is_observed.T, 1.0))


class _Orders:
    """Random orders of epochs, each drawn when it is first needed and kept for further columns; only epochs of one of
    the ``groups`` (B,) are exchanged, if there are such."""

    def __init__(self, count: int, groups: Integers | None, rng: np.random.Generator) -> None:
        self._count, self._groups, self._rng = count, groups, rng
        self._by_group = None if groups is None else np.argsort(groups, kind="stable")
        self._drawn: list[Integers] = []

    def __iter__(self) -> Iterator[Integers]:
        for number in range(_PERMUTATIONS):
            if number == len(self._drawn):
                self._drawn.append(self._order())
            yield self._drawn[number]

    def _order(self) -> Integers:
        if self._groups is None:
            return self._rng.permutation(self._count)
        order = np.empty(self._count, int)
        order[self._by_group] = np.lexsort((self._rng.random(self._count), self._groups))
        return order


def _neighbour_correlation(
    products: Array, pairs: tuple[Integers, Integers], orders: Iterable[Integers]
) -> tuple[float, float]:
    """Return the mean product of neighbours and its p-value.

    Permutations are drawn until so many of them are as extreme that their share is the p-value, which then is far from
    significant: Besag and Clifford, Biometrika 78 (1991) 301. Beyond all of them it is the normal tail.
    """
    from scipy.special import ndtr

    mean, flat, count = float(np.mean(products[pairs])), products.ravel(), len(products)  # one index is faster than two
    first, second = pairs[0], pairs[1]
    drawn, larger = [], 0
    for order in orders:
        drawn.append(float(flat.take(order[first] * count + order[second]).mean()))
        larger += drawn[-1] >= mean
        if larger == _DETERMINED:
            return mean, larger / len(drawn)
    if larger >= _RESOLVED:
        return mean, (larger + 1) / (len(drawn) + 1)
    score = (mean - float(np.mean(drawn))) / max(float(np.std(drawn)), 1e-12)
    return mean, float(max(ndtr(-score), 1e-12))


def _neighbours(columns: Array) -> tuple[Integers, Integers]:
    """Return pairs of epochs nearest to each other in columns (B, D), each scaled by its range."""
    from scipy.spatial import KDTree

    spread = np.ptp(columns, axis=0)
    scaled = columns / np.where(spread > 0.0, spread, 1.0)
    near = KDTree(scaled).query(scaled, k=_NEIGHBOURS + 1)[1]
    first = np.repeat(np.arange(len(scaled)), _NEIGHBOURS)
    # Where several epochs coincide, an epoch may be listed after another one as its own neighbour.
    others = np.array([row[row != epoch][:_NEIGHBOURS] for epoch, row in enumerate(near)])
    return first, others.ravel()
