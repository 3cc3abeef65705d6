"""Whether a final model holds as a whole: what it leaves is tested against plain noise, whatever causes it holds.

A search asks which of its forms is best; it does not ask whether the truth is among them. A wrong picture leaves more
noise than was declared, of observations or of inputs (which stretch to swallow what no cause explains), residuals that
are alike where something is alike, in time or in any input, or that have a mean where epochs repeat one another or lie
in one region of the inputs: then the scatter within these tells what chance leaves, whatever was declared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.blocks import FEWEST_BLOCKS, regions
from truing.inference.fitted_model import FittedModel
from truing.inference.group_means import EpochResiduals, epoch_residuals, means_against_scatter
from truing.inference.model import CauseT
from truing.inference.noise import NOISE_PRIOR_FREEDOM, NoiseLevel

_PERMUTATIONS = 499
_NEIGHBOURS = 2
# With fewer epochs no order of them says anything; with more, pairs of a sample of them say all that is to be said.
_FEWEST_EPOCHS, _MOST_EPOCHS = 8, 2_000
# Repeats, beyond the first of each, that tell pure error; epochs of a region, each beyond the first.
_FEWEST_REPEATS = 4.0
_RESOLVED = 10  # permutations beyond which a share of them is a p-value by itself


class MisfitKind(StrEnum):
    """What kind of misfit is looked for."""

    OBSERVATION_NOISE = "observation-noise"  # more noise of observations than declared
    INPUT_NOISE = "input-noise"  # more noise of inputs than declared
    LIKE_NEIGHBOURS = "like-neighbours"  # residuals are alike where something is alike
    PURE_ERROR = "pure-error"  # residuals of repeats have a mean, beyond what the repeats scatter
    BY_REGION = "by-region"  # residuals of a region of the inputs have a mean, beyond what they scatter there


class WhyUntested(StrEnum):
    """Why a kind of misfit was not tested."""

    NO_REPEATS = "no-repeats"  # nothing was measured twice at the same command
    TOO_FEW = "too-few"


@dataclass(frozen=True)
class AdequacyTest:
    """One test of the final model: what was looked for, along which column, how much was found, the chance of so much.

    ``value`` is noise over the declared one, the correlation of neighbours, or the mean square of means over the
    scatter about them (F); ``along`` is empty for noise and repeats.
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
    not_asked: frozenset[MisfitKind] = frozenset()  # of what nothing is known: which commands were given, which inputs

    @property
    def worst(self) -> AdequacyTest | None:
        """The test that speaks most against the model, None where nothing could be tested."""
        return min(self.tests, key=self.corrected, default=None)

    @property
    def p_value(self) -> float:
        """Chance that an adequate model does as badly in the worst of all tests."""
        return 1.0 if self.worst is None else self.corrected(self.worst)

    @property
    def untested(self) -> list[MisfitKind]:
        """Kinds of misfit that nothing was there to test."""
        known = self.not_asked | {test.lack for test in self.tests}
        return [lack for lack in MisfitKind if lack not in known]

    def why_untested(self, lack: MisfitKind) -> WhyUntested:
        """Why a kind of misfit was not tested."""
        is_known = lack == MisfitKind.PURE_ERROR and not self.repeated
        return WhyUntested.NO_REPEATS if is_known else WhyUntested.TOO_FEW

    def corrected(self, test: AdequacyTest) -> float:
        """A test's p-value, corrected for the kinds of misfit and for the tests of its kind (Bonferroni)."""
        kinds = len({other.lack for other in self.tests})
        return min(1.0, test.p_value * kinds * sum(other.lack == test.lack for other in self.tests))


def adequacy_of(
    final: FittedModel[CauseT], noise: NoiseLevel, rng: np.random.Generator, repeats: Integers | None = None
) -> Adequacy:
    """Test what a final model leaves, beside the level of its noise over what was declared.

    ``repeats`` (B,): numbers of commands that were given more than once, -1 for the others.
    """
    tests = [AdequacyTest(MisfitKind.OBSERVATION_NOISE, "", noise.ratio, noise.p_value)]
    ratio, freedom = final.input_noise
    if freedom >= _FEWEST_EPOCHS:
        tests.append(noise_excess(MisfitKind.INPUT_NOISE, ratio, freedom))
    tests += like_neighbours(final.standardised, _orderings(final), rng, final.model.error_groups)
    inputs = dict(final.scene.inputs)
    residuals = epoch_residuals(final.fit.whitened, final.measured, final.fit.frames, final.input_rows)
    tests += by_region(residuals, inputs)
    not_asked = {
        lack
        for lack, known in ((MisfitKind.BY_REGION, inputs), (MisfitKind.PURE_ERROR, repeats is not None))
        if not known
    }
    if repeats is None:
        return Adequacy(tuple(tests), not_asked=frozenset(not_asked))
    repeated = bool((np.bincount(repeats[repeats >= 0]) > 1).any())
    return Adequacy((*tests, *pure_error(residuals, repeats)), repeated, frozenset(not_asked))


def _orderings(fitted: FittedModel[CauseT]) -> dict[str, Array]:
    """Return the columns (B,) along which epochs are neighbours, and all inputs together (B, D)."""
    inputs = dict(fitted.scene.inputs)
    columns = {name: values for name, values in fitted.scene.covariates.items() if np.ndim(values) == 1} | inputs
    if len(inputs) > 1:
        columns[" ".join(inputs)] = np.column_stack(list(inputs.values()))
    return columns


def is_unordered(rest: Array, own: Mask, fitted: FittedModel[CauseT], level: float) -> bool:
    """Whether standardised residuals (B, K, d) in some places (B, K) are like noise, as far as that can be told: of
    enough epochs, which resemble their neighbours along anything as much as noise does by a chance above level."""
    rng = np.random.default_rng(len(rest))
    inside = np.where(own[..., None], rest, np.nan)
    tests = list(like_neighbours(inside, _orderings(fitted), rng, fitted.model.error_groups))
    return bool(tests) and min(test.p_value for test in tests) * len(tests) > level


def pure_error(residuals: EpochResiduals, repeats: Integers) -> Iterator[AdequacyTest]:
    """Yield the F test of lack of fit against pure error, where enough was repeated; repeats (B,) by number, -1 for
    none."""
    found = means_against_scatter(residuals, repeats, _FEWEST_REPEATS)
    if found is not None:
        yield AdequacyTest(MisfitKind.PURE_ERROR, "", found.ratio, found.p_value)


def by_region(residuals: EpochResiduals, inputs: Mapping[str, Array]) -> Iterator[AdequacyTest]:
    """Yield the F test of the means over regions of the inputs, each (B,), against the scatter about them."""
    columns = np.column_stack(list(inputs.values())) if inputs else np.zeros((len(residuals.values), 0))
    varies = np.isfinite(columns).all(0) & (np.ptp(columns, axis=0) > 0.0)
    if not varies.any():
        return
    own = regions(columns[:, varies])
    if own.max() + 1 < FEWEST_BLOCKS or np.bincount(own).min() < _FEWEST_EPOCHS:
        return
    if (found := means_against_scatter(residuals, own, _FEWEST_REPEATS)) is not None:
        yield AdequacyTest(MisfitKind.BY_REGION, " ".join(inputs), found.ratio, found.p_value)


def noise_excess(lack: MisfitKind, ratio: float, freedom: float) -> AdequacyTest:
    """Test noise found over declared noise, from so many degrees of freedom; declared noise is known to about 10 %."""
    spread = math.sqrt(0.5 / NOISE_PRIOR_FREEDOM + 0.5 / freedom)
    return AdequacyTest(lack, "", ratio, 0.5 * math.erfc(math.log(ratio) / spread / math.sqrt(2.0)))


def like_neighbours(
    rest: Array, columns: Mapping[str, Array], rng: np.random.Generator, groups: Integers | None = None
) -> Iterator[AdequacyTest]:
    """Yield how alike residuals (B, K, d) of epochs are that are neighbours along each of the columns (B,) or (B, D).

    Residuals have unit noise, and are NaN where nothing was seen. Epochs are compared with the nearest ones, channel by
    channel; the chance of as much is told from epochs in random orders, within their ``groups`` (B,) where only these
    are exchangeable: noise that is the same throughout is as likely in any order.
    """
    rows = rest.reshape(len(rest), -1)
    kept = np.isfinite(rows).any(1)
    if kept.sum() < _FEWEST_EPOCHS:
        return
    chosen = np.flatnonzero(kept)
    if len(chosen) > _MOST_EPOCHS:
        chosen = np.sort(rng.choice(chosen, _MOST_EPOCHS, replace=False))
    products = _products(rows[chosen])
    orders = _orders(len(chosen), None if groups is None else groups[chosen], rng)
    for name, values in columns.items():
        own = np.asarray(values, float).reshape(len(values), -1)[chosen]
        if np.isfinite(own).all() and np.ptp(own, axis=0).any():
            yield AdequacyTest(
                MisfitKind.LIKE_NEIGHBOURS, name, *_serial_correlation(products, _neighbours(own), orders)
            )


def _products(rows: Array) -> Array:
    """Mean products (B, B) of epochs' residuals (B, C), channel by channel where both were seen, of unit variance."""
    seen = np.isfinite(rows)
    count = np.maximum(seen.sum(0), 1)
    centred = np.where(seen, rows - np.where(seen, rows, 0.0).sum(0) / count, 0.0)
    centred = centred / np.maximum(np.sqrt((centred**2).sum(0) / count), 1e-12)
    return np.asarray(centred @ centred.T / np.maximum(seen.astype(float) @ seen.T, 1.0))


def _orders(count: int, groups: Integers | None, rng: np.random.Generator) -> list[Integers]:
    if groups is None:
        return [rng.permutation(count) for _ in range(_PERMUTATIONS)]
    by_group = np.argsort(groups, kind="stable")
    found = []
    for _ in range(_PERMUTATIONS):
        order = np.empty(count, int)
        order[by_group] = np.lexsort((rng.random(count), groups))
        found.append(order)
    return found


def _serial_correlation(
    products: Array, pairs: tuple[Integers, Integers], orders: list[Integers]
) -> tuple[float, float]:
    """Mean product of neighbours, and the chance of a larger one: the normal tail beyond what permutations resolve."""
    from scipy.special import ndtr

    found = float(np.mean(products[pairs]))
    drawn = np.array([np.mean(products[order[pairs[0]], order[pairs[1]]]) for order in orders])
    larger = int(np.sum(drawn >= found))
    if larger > _RESOLVED:
        return found, (larger + 1) / (len(drawn) + 1)
    score = (found - float(drawn.mean())) / max(float(drawn.std()), 1e-12)
    return found, float(max(ndtr(-score), 1e-12))


def _neighbours(columns: Array) -> tuple[Integers, Integers]:
    """Pairs of epochs nearest to each other in columns (B, D), each column over its range."""
    from scipy.spatial import KDTree

    spread = np.ptp(columns, axis=0)
    scaled = columns / np.where(spread > 0.0, spread, 1.0)
    near = KDTree(scaled).query(scaled, k=_NEIGHBOURS + 1)[1]
    first = np.repeat(np.arange(len(scaled)), _NEIGHBOURS)
    # Of several epochs in one place an epoch may come behind another as its own neighbour.
    others = np.array([row[row != own][:_NEIGHBOURS] for own, row in enumerate(near)])
    return first, others.ravel()
