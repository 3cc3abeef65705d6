"""Slips in all that was measured on a chain, or in its description: the chain is fitted anew without each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.belonging.joint_rows import changes_of_axes, slips_of_all, slips_of_lines
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways
from truing.simulation.mechanisms.chains.column_slips import does_not_belong, few_poses, foreign_misfit
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.measured_lines import GROUND
from truing.simulation.mechanisms.chains.notations import DenavitHartenberg
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.stages.common.chain_description import described_otherwise, numbers_otherwise
from truing.stages.common.chain_measurements import MeasuredLinks
from truing.stages.common.chain_start import NominalFit

FEWEST_POSES = 8
"""Fewest poses whose readings are compared with measured links."""
_MOST_PERMUTED = 4  # targets of a link whose names are tried in every order
# Share of the spread, or times the noise, and share of the misfit as recorded, that another unit may leave within
# tolerances.
_CLOSE, _NOISES, _FAR_SMALLER = 0.05, 2.0, 0.2
_EXPLAINED = 0.2  # of the misfit: what a slip in one number may leave
_MM = 1e-3
# Of distances, smallest wrong zero that is a slip, m: half of the smallest reflector's radius. Share of the misfit that
# it may leave: one of ten or more independent errors of a machine explains as much with a probability below 1e-4.
_LEAST_ZERO, _EXPLAINED_BY_ZERO = 3e-3, 0.35
_REACH, _STEPS, _FINE = 60.0, 8, 1e-6  # largest zero over the misfit, steps on either side, and tolerance, m
# Poses that miss by this many times the median are left out, if at least this share remains.
_FAR, _MOST = 5.0, 0.9


@dataclass(frozen=True)
class ComparedChain:
    """A chain, its readings and the measurements on it, with the usable poses (B,).

    ``rows`` describe the chain, where its description has rows; ``fit_of``: fit of the places to a chain; ``fit_on``:
    to the chain with the same measurements on other links, none for distances.
    """

    tree: Tree
    table: pa.Table
    measured: MeasuredLinks
    conditions: ChainConditions
    usable: Mask
    rows: list[DenavitHartenberg]
    fit_of: Callable[[Tree], NominalFit]
    fit_on: Callable[[MeasuredLinks], NominalFit] | None = None

    @property
    def chain(self) -> Tree:
        """The tree without the ground of stations."""
        return replace(self.tree, nodes=tuple(node for node in self.tree.nodes if node.link != GROUND))

    @property
    def fit(self) -> NominalFit:
        """The fit of the chain as described."""
        return self.fit_of(self.chain)

    @property
    def names(self) -> list[str]:
        """Names (K,) of the measured channels, or (D,) of the distances."""
        channels, ends = self.measured.channels, self.measured.ends
        return (
            list(channels.names) if ends is None else [f"{channels.names[a]} to {channels.names[b]}" for a, b in ends]
        )


def with_most_poses(compared: ComparedChain) -> ComparedChain:
    """The same with fits that leave out single poses: wrong targets of a few hide a slip in all of them."""
    fit_of, fit_on, usable = compared.fit_of, compared.fit_on, compared.usable

    def of_most(fit: NominalFit) -> NominalFit:
        def start_of(chosen: Mask, conditions: ChainConditions, other: Array | None = None) -> StartValues:
            chosen = chosen & usable
            start = fit.start_of(chosen, conditions, other)
            most = without_lone_errors(start, chosen)
            if (most == chosen).all():
                return start
            fitted = fit.start_of(most, conditions, other)
            errors = np.full_like(start.errors, np.nan)
            errors[most[chosen]] = fitted.errors
            return replace(fitted, errors=errors)

        return replace(fit, start_of=start_of)

    return replace(
        compared,
        fit_of=lambda other: of_most(fit_of(other)),
        fit_on=None if fit_on is None else lambda other: of_most(fit_on(other)),
    )


@dataclass(frozen=True)
class WholeSlip:
    """A slip of all positions, or of the description: the misfit after it is undone, over the positions' spread and
    in m."""

    share: float
    slip: RecordSlip
    after: float


def _explaining(slip: RecordSlip, after: StartValues) -> Iterator[WholeSlip]:
    if not does_not_belong(after):
        yield WholeSlip(after.rms / after.spread, slip, after.rms)


def slips_of_measured(compared: ComparedChain, fit: NominalFit) -> Iterator[WholeSlip]:
    """Yield units and mirror images of all measured positions, or units of all distances, that explain the misfit."""
    for slip in slips_of_all(fit.values.shape[-1]):
        values = np.where(fit.is_position[:, None], fit.values @ slip.matrix, fit.values)
        yield from _explaining(slip.slip, fit.start_of(compared.usable, compared.conditions, values))


def units_within_tolerances(compared: ComparedChain, fit: NominalFit, tolerated: float) -> Iterator[WholeSlip]:
    """Yield units of all positions that leave a misfit, m, which tolerances explain, and a far smaller one than as
    recorded.

    A coarse instrument, or a small range of poses, leaves more than a share of the spread in any unit.
    """
    before, measured = fit.start_of(compared.usable, compared.conditions), compared.measured
    seen = measured.is_observed & measured.is_position & compared.usable[:, None]
    noise = float(np.sqrt(np.trace(measured.cov[seen], axis1=-2, axis2=-1).mean())) if seen.any() else 0.0
    for slip in slips_of_all(fit.values.shape[-1]):
        if slip.slip.kind is not SlipKind.UNIT:
            continue
        values = np.where(fit.is_position[:, None], fit.values @ slip.matrix, fit.values)
        after = fit.start_of(compared.usable, compared.conditions, values)
        share = after.rms / after.spread
        is_close = after.rms <= min(tolerated, max(_CLOSE * after.spread, _NOISES * noise))
        if is_close and share <= _FAR_SMALLER * before.rms / before.spread:
            yield WholeSlip(share, slip.slip, after.rms)


def slips_of_links(compared: ComparedChain) -> Iterator[WholeSlip]:
    """Yield other units of the positions of one of several links that explain the misfit."""
    channels, fit_on, values = compared.measured.channels, compared.fit_on, compared.measured.values
    links = list(dict.fromkeys(channels.links))
    if fit_on is None or len(links) < 2:
        return
    for link, factor in product(links, both_ways(LENGTH_FACTORS)):
        on_link = np.array([name == link for name in channels.links]) & compared.measured.is_position
        fit = fit_on(replace(compared.measured, values=np.where(on_link[:, None], factor * values, values)))
        slip = RecordSlip(SlipKind.UNIT, "measured positions", (f"of body {link}",), factor=factor)
        yield from _explaining(slip, fit.start_of(compared.usable, compared.conditions))


def slips_of_surveys(compared: ComparedChain) -> Iterator[WholeSlip]:
    """Yield other axes of the survey of one link that explain the misfit, or else another place of its targets."""
    measured, fit_on = compared.measured, compared.fit_on
    known = np.asarray(np.isfinite(measured.surveyed).all(1))
    if fit_on is None:
        return
    for link in dict.fromkeys(name for name, used in zip(measured.channels.links, known.tolist(), strict=True) if used):
        used = known & np.array([name == link for name in measured.channels.links])

        def fitted(surveyed: Array, rows_used: Mask = used) -> StartValues:
            changed = np.where(rows_used[:, None], surveyed, measured.surveyed)
            return fit_on(replace(measured, surveyed=changed)).start_of(compared.usable, compared.conditions)

        axes = (
            changes_of_axis
            for changes_of_axis in changes_of_axes(f"the survey of body {link}")
            if changes_of_axis.slip.kind is not SlipKind.UNIT
        )
        found = [part for axis in axes for part in _explaining(axis.slip, fitted(measured.surveyed @ axis.matrix))]
        for slip, order in _renamed(compared, link, np.flatnonzero(used)):
            found += _explaining(slip, fitted(measured.surveyed[order]))
        yield from found
        if not found:
            slip = RecordSlip(SlipKind.PLACED, "survey of body", (link,))
            yield from _explaining(slip, fitted(np.full_like(measured.surveyed, np.nan)))


def _renamed(compared: ComparedChain, link: str, rows: Index) -> Iterator[tuple[RecordSlip, Index]]:
    """Yield the orders of all channels (K,) in which few targets of a link, ``rows``, bear each other's names."""
    targets = compared.measured.channels.names
    for other in permutations(rows.tolist()) if len(rows) <= _MOST_PERMUTED else ():
        order = np.arange(len(targets))
        order[rows] = other
        pairs = [f"{targets[k]} is {targets[at]}" for k, at in zip(rows, other, strict=True) if k != at]
        if pairs:
            yield RecordSlip(SlipKind.RELABELLED, "targets", (*pairs, link)), order


def slips_of_single_lines(compared: ComparedChain, fit: NominalFit) -> Iterator[WholeSlip]:
    """Yield slips of single distances that explain the misfit."""
    names, ends = compared.measured.channels.names, compared.measured.ends
    if ends is None:
        return
    for slip, values in slips_of_lines([(names[a], names[b]) for a, b in ends], fit.values):
        yield from _explaining(slip, fit.start_of(compared.usable, compared.conditions, values))


def slips_of_zeros(compared: ComparedChain, fit: NominalFit) -> Iterator[WholeSlip]:
    """Yield zeros of all distances, or of those of one end, that explain the misfit: each fitted with the places.

    Smaller zeros are errors of the instrument, which the diagnosis finds.
    """
    names, ends = compared.measured.channels.names, compared.measured.ends
    if ends is None:
        return
    some = compared.usable.copy()
    some[compared.usable] = few_poses(int(compared.usable.sum()))
    compared = replace(compared, usable=some)
    before = fit.start_of(compared.usable, compared.conditions)
    is_distance = np.arange(fit.values.shape[1]) >= fit.values.shape[1] - len(ends)
    groups = {"": is_distance}
    for end in dict.fromkeys(names[k] for k in ends.ravel()):
        of_end = is_distance.copy()
        of_end[is_distance] = [end in (names[a], names[b]) for a, b in ends]
        if of_end.sum() < len(ends):
            groups[f"of {end}"] = of_end
    for name, group in groups.items():
        offset, after = _fitted_zero(compared, fit, group, before.rms)
        if abs(offset) > _LEAST_ZERO and after.rms < _EXPLAINED_BY_ZERO * before.rms:
            slip = RecordSlip(SlipKind.ZERO, "distances (mm)", (name,) if name else (), offset=offset / _MM)
            yield from _explaining(slip, after)


def _fitted_zero(compared: ComparedChain, fit: NominalFit, group: Mask, before: float) -> tuple[float, StartValues]:
    """Return the zero, m, that distances of a group (D,) lack, and the places that fit then; ``before``: misfit, m."""
    from scipy.optimize import minimize_scalar

    def at(offset: float) -> StartValues:
        values = fit.values + offset * group[:, None]
        return fit.start_of(compared.usable, compared.conditions, values)

    # The misfit by a wrong zero is a share of it: other places of the stations absorb the rest.
    step = _REACH * before / _STEPS
    tried = step * np.arange(-_STEPS, _STEPS + 1)
    best = float(tried[int(np.argmin([at(offset).rms for offset in tried.tolist()]))])
    bounds = (best - step, best + step)
    found = minimize_scalar(lambda offset: at(offset).rms, bounds=bounds, method="bounded", options={"xatol": _FINE})
    return float(found.x), at(float(found.x))


def moved_frame(compared: ComparedChain, fit: NominalFit) -> WholeSlip | None:
    """Return the pose from which on all places are in another frame, if two frames explain the misfit.

    The frame of the first poses, which a fit of these alone must explain, misses all poses from that one on.
    """
    conditions = compared.conditions
    indices = np.flatnonzero(compared.usable)
    first = np.isin(np.arange(len(conditions.series)), indices[: max(FEWEST_POSES, len(indices) // 4)])
    if fit.reference is not None or conditions.series.any() or compared.measured.ends is not None:
        return None
    alone = fit.start_of(first, conditions)
    limit = foreign_misfit(alone)
    errors = fit.errors_at(alone, conditions, fit.values)[np.ix_(indices, fit.is_position)]
    size = np.sqrt(np.nanmean(np.sum(errors**2, -1), axis=1))
    agree = np.flatnonzero(size <= limit)
    start = int(agree[-1]) + 1 if len(agree) else 0
    if alone.rms > limit or not FEWEST_POSES <= start <= len(indices) - FEWEST_POSES or len(agree) < start:
        return None
    series = (np.arange(len(conditions.series)) >= indices[start]).astype(int)
    after = fit.start_of(compared.usable, replace(conditions, series=series))
    slip = RecordSlip(SlipKind.FRAME, "measured places from pose", (str(conditions.poses[indices[start]]),))
    return None if does_not_belong(after) else WholeSlip(after.rms / after.spread, slip, after.rms)


def slips_of_bodies(compared: ComparedChain) -> Iterator[WholeSlip]:
    """Yield other moving links that explain the misfit, if all that was measured was on one link."""
    channels, fit_on = compared.measured.channels, compared.fit_on
    nodes = compared.tree.nodes
    if fit_on is None or len(set(channels.links)) > 1:
        return
    for k, node in enumerate(nodes):
        if node.kind is not JointKind.FIXED and k != channels.node[0]:
            moved = replace(channels, node=np.full_like(channels.node, k))
            subject_text = f"measurements on link {node.link}, or one fixed to it,"
            slip = RecordSlip(SlipKind.MISLABELLED, subject_text, (f"body {channels.links[0]}",))
            fit = fit_on(replace(compared.measured, channels=moved))
            yield from _explaining(slip, fit.start_of(compared.usable, compared.conditions))


def slips_of_description(compared: ComparedChain) -> Iterator[WholeSlip]:
    """Yield slips in the description, each with the chain without it, that explain the misfit."""
    for slip, other in described_otherwise(compared.chain, compared.rows):
        yield from _explaining(slip, compared.fit_of(other).start_of(compared.usable, compared.conditions))


def slips_of_numbers(compared: ComparedChain) -> list[WholeSlip]:
    """Return slips in single numbers of the description that explain most of the misfit.

    Some are equal to zeros or signs of joints; such a slip of readings is tried before.
    """
    before = compared.fit.start_of(compared.usable, compared.conditions).rms
    return [
        explaining
        for slip, other in numbers_otherwise(compared.chain, compared.rows)
        for explaining in _explaining(slip, compared.fit_of(other).start_of(compared.usable, compared.conditions))
        if explaining.after < _EXPLAINED * before
    ]


def without_lone_errors(start: StartValues, usable: Mask) -> Mask:
    """Mask (B,) of the usable poses without a few that miss clearly more than most, such as those of a wrong target."""
    size = np.sqrt(np.nanmean(np.sum(start.errors**2, -1), axis=1))
    usual = size <= _FAR * float(np.median(size))
    if usual.mean() < _MOST:
        return usable
    is_usable = usable.copy()
    is_usable[usable] = usual
    return is_usable
