"""Checks of positioning runs: agreement of positions with targets, copies, jumps, drift and gross errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.belonging.approaches import TargetMatch, match_targets
from truing.estimation.interferometry.approaches import (
    copied_series,
    cycle_drift,
    gross_errors,
    overflow,
    resolution,
    row_jump,
    turned_cycles,
    widest_gap,
)
from truing.estimation.interferometry.log_quality import temperatures_out_of_reach
from truing.report.belonging import slip_words
from truing.report.numbers import count_text, listed
from truing.stages.common.belonging import subject_of
from truing.stages.common.point_arrays import number_column
from truing.stages.quality.check import FAIL, PASS, WARN, CampaignLimits, Check, not_evaluated

WAYS = ("forward", "backward")
_UM = 1e3  # per mm
_NO_MATCH, _NOTED = 0.05, 0.01  # rms misfit over the travel
# Span of deviations over the travel below which no interferometer in air measures: about half of 0.1 ppm.
_LEAST_SHARE = 5e-8
_CHANCE, _COPIED, _DRIFT, _JUMP = 1e-3, 1e-4, 1e-4, 1e-6
_FEW, _TWO = 3, 2
_TIMES_SCATTER = 10.0
_STRAIGHT = 0.9


@dataclass(frozen=True)
class PositioningRun:
    """One run: target (P,), position and position as read (P, 2, C) in mm; the place of each row in its file (P, 2, C),
    and cycles (C,).

    Directions are forward, backward. ``temperature_c`` (P, 2, C), None where it was not recorded.
    """

    name: str
    target: Array
    position: Array
    read: Array
    row_order: Index
    cycles: tuple[int, ...]
    temperature_c: Array | None

    @property
    def subject(self) -> str:
        """Subject of the run in qa.parquet."""
        return subject_of(self.name)

    @property
    def deviation(self) -> Array:
        """Position minus target (P, 2, C), um."""
        return _UM * (self.position - self.target[:, None, None])

    @property
    def step_um(self) -> float:
        """Resolution of the readings, um; 0 if none is visible."""
        return _UM * resolution(self.read)

    @property
    def cycle_order(self) -> Index:
        """Order (P, 2, C) of a usual test, independent of the file: up and down, cycle by cycle."""
        targets, _, cycles = self.position.shape
        up = np.arange(targets)
        within = np.stack([up, 2 * targets - 1 - up], axis=1)
        return np.asarray(within[..., None] + 2 * targets * np.arange(cycles))

    def place(self, at: Sequence[int]) -> str:
        """Return one approach in words."""
        return f"target {self.target[at[0]]:g} mm {WAYS[at[1]]} in cycle {self.cycles[at[2]]}"

    def places(self, where: Mask) -> str:
        """Return approaches (P, 2, C) in words: whole cycles or targets where possible."""
        cycles, targets = np.all(where, axis=(0, 1)), np.all(where, axis=(1, 2))
        if np.array_equal(where, np.broadcast_to(cycles, where.shape)):
            return f"all of cycle {listed([str(self.cycles[k]) for k in np.flatnonzero(cycles)])}"
        if np.array_equal(where, np.broadcast_to(targets[:, None, None], where.shape)):
            return f"all of target {listed([f'{self.target[k]:g} mm' for k in np.flatnonzero(targets)])}"
        return listed([self.place(at) for at in np.argwhere(where).tolist()], 4)


def positioning_runs(positions: pa.Table) -> Iterator[PositioningRun]:
    """Yield the runs of the table ``positions``, with rows ordered by run, target, direction and cycle."""
    names = [str(name) for name in positions.column("run").to_pylist()]
    for name in dict.fromkeys(names):
        rows_of_run = positions.filter([run_name == name for run_name in names])
        target = np.unique(number_column(rows_of_run, "target_mm"))
        shape = len(target), len(WAYS), -1
        columns = rows_of_run.column_names
        order = number_column(rows_of_run, "row_order") if "row_order" in columns else np.arange(rows_of_run.num_rows)
        warmth = number_column(rows_of_run, "material_temperature_c") if "material_temperature_c" in columns else None
        cycles = tuple(dict.fromkeys(rows_of_run.column("cycle").to_pylist()))
        yield PositioningRun(
            name,
            target,
            number_column(rows_of_run, "position_mm").reshape(shape),
            number_column(rows_of_run, "position_read_mm" if "position_read_mm" in columns else "position_mm").reshape(
                shape
            ),
            order.astype(np.int64).reshape(shape),
            cycles,
            None if warmth is None else warmth.reshape(shape),
        )


def position_checks(runs: Sequence[PositioningRun], limits: CampaignLimits) -> Iterator[Check]:
    """Yield all checks of all runs; if positions contradict their targets, no other check is evaluated."""
    for run in runs:
        match = _matched(run)
        check = _overflow(run, match)
        yield check
        yield _against_targets(run, match)
        yield _cycles(run, limits)
        yield _temperature(run)
        yield _copied(run)
        if match.is_slip or check.verdict == FAIL:
            continue
        yield _jumps(run, limits)
        yield _errors(run)
        if _contradicts_targets(run, match):
            continue
        yield _directions(run)
        yield _drift(run)


def _matched(run: PositioningRun) -> TargetMatch:
    target = np.broadcast_to(run.target[:, None, None], run.position.shape).ravel()
    order = np.argsort(run.row_order, axis=None)
    return match_targets(target[order], run.position.ravel()[order])


def _contradicts_targets(run: PositioningRun, match: TargetMatch) -> bool:
    return match.is_slip or match.misfit > _NO_MATCH * float(np.ptp(run.target)) > 0.0


def _against_targets(run: PositioningRun, match: TargetMatch) -> Check:
    travel = float(np.ptp(run.target))
    if travel == 0.0:
        why = "a single target shows neither unit nor sign"
        return not_evaluated("positions against targets", "positions-against-targets", run.subject, why)
    limit = _NO_MATCH * travel
    text = f"Run {run.name}: positions differ from their targets by {match.misfit:.3g} mm rms over {travel:g} mm."
    if match.deviations:
        text += " They seem to be deviations: position_mm is the target plus the deviation."
    elif match.slips:
        text += f" Did you mean: {'; and '.join(slip_words(slip) for slip in match.slips)}?"
        text += f" With this, the misfit is {match.explained:.3g} mm."
        if match.rivals:
            text += f" Equally likely: {'; or '.join(slip_words(slip) for slip in match.rivals[:_FEW])}."
    elif match.single:
        rows = ", ".join(map(str, match.single[:_FEW]))
        text += (
            f" {'Row' if len(match.single) == 1 else 'Rows'} {rows} alone {'is' if len(match.single) == 1 else 'are'}"
        )
        text += " far from the target: a misread digit, or the value of another row."
    elif match.misfit > limit:
        text += " No tested recording error explains this."
    span = float(np.nanmax(run.deviation) - np.nanmin(run.deviation))
    if 0.0 < span < _LEAST_SHARE * _UM * travel:
        text += f" They span {span:.2g} um, less than the wavelength of light is known to in air: did you mean mm?"
        return Check("positions-against-targets", run.subject, match.misfit, limit, "mm", WARN, text)
    verdict = FAIL if _contradicts_targets(run, match) else WARN if match.misfit > _NOTED * travel else PASS
    return Check("positions-against-targets", run.subject, match.misfit, limit, "mm", verdict, text)


def _cycles(run: PositioningRun, limits: CampaignLimits) -> Check:
    count = len(run.cycles)
    made = f"{count_text(count, 'cycle')} at {count_text(len(run.target), 'target')}"
    text = f"Run {run.name}: {made}; ISO 230-2 asks for 5."
    return limits.of("approach-cycles").row(run.subject, float(count), "1", text)


def _temperature(run: PositioningRun) -> Check:
    if run.temperature_c is None or not np.isfinite(run.temperature_c).any():
        return not_evaluated("temperature of the axis", "axis-temperature", run.subject, "it was not recorded")
    out_of_reach = temperatures_out_of_reach(run.temperature_c.ravel())
    worst = float(np.nanmax(np.abs(run.temperature_c)))
    text = f"Run {run.name}: the axis' temperature is {worst:.4g} °C at most"
    text += ", which no laboratory has; is the unit right?" if len(out_of_reach.where) else "."
    verdict = FAIL if len(out_of_reach.where) else PASS
    return Check("axis-temperature", run.subject, worst, out_of_reach.limit, "degC", verdict, text)


def _overflow(run: PositioningRun, match: TargetMatch) -> Check:
    step = run.step_um
    if step == 0.0 or match.is_slip:
        why = "positions are not whole multiples of a step; see position-jumps for jumps of any size"
        why = "positions do not follow their targets" if match.is_slip else why
        return not_evaluated("overflow of an encoder", "encoder-overflow", run.subject, why)
    jumped = overflow(run.deviation, step)
    if jumped is None:
        text = f"Run {run.name}: no positions differ by 2^n steps of {step:.3g} um."
        return Check("encoder-overflow", run.subject, 0.0, 0.0, "um", PASS, text)
    text = f"Run {run.name}: positions jump by {jumped.jump / _UM:.6g} mm, 2^{jumped.bits} steps of {step:.3g} um: an "
    text += f"encoder overflowed at {run.places(jumped.where)}."
    return Check("encoder-overflow", run.subject, jumped.jump, 0.0, "um", FAIL, text)


def _jumps(run: PositioningRun, limits: CampaignLimits) -> Check:
    """Check for a step in the sequence of rows, over the scatter, and for a gap between groups, over their range."""
    limit = limits.of("position-jumps")
    for order, known_by in ((run.row_order, "rows"), (run.cycle_order, "cycles")):
        step = row_jump(run.deviation, order, run.step_um)
        if step is not None and step.p_value < _JUMP and limit.verdict(abs(step.size) / step.scatter) != PASS:
            text = f"Run {run.name}: from {run.place(step.after)} on, in the order of the {known_by}, positions are "
            text += f"shifted by {step.size:+.3g} um; their scatter is {step.scatter:.2g} um."
            return limit.row(run.subject, abs(step.size) / step.scatter, "1", text)
    gap = widest_gap(run.deviation, run.step_um)
    if gap is None:
        text = f"Run {run.name}: deviations differ only between directions."
        return limit.row(run.subject, 0.0, "1", text)
    text = f"Run {run.name}: the widest gap between deviations is {gap.size:.3g} um, the range on its wider side "
    text += f"{gap.spread:.3g} um."
    if limit.verdict(gap.ratio) != PASS:
        text += f" Separate: {run.places(gap.where)}."
    return limit.row(run.subject, min(gap.ratio, 1e9), "1", text)


def _errors(run: PositioningRun) -> Check:
    gross = gross_errors(run.deviation, _CHANCE, 0.5 * run.step_um)
    count, times = int(gross.where.sum()), abs(gross.off) / max(gross.scatter, 1e-300)
    text = f"Run {run.name}: the approach farthest from the others of its target and direction is "
    text += f"{run.place(gross.worst)}, {gross.off:+.3g} um off, scatter of the others {gross.scatter:.2g} um"
    text += f". Significant: {run.places(gross.where)}." if count else "."
    if count and len(run.cycles) == _TWO:
        text += " With two cycles, it cannot be decided which one is wrong."
    verdict = PASS if not count else FAIL if times > _TIMES_SCATTER else WARN
    return Check("position-errors", run.subject, abs(gross.off), _TIMES_SCATTER * gross.scatter, "um", verdict, text)


def _copied(run: PositioningRun) -> Check:
    pairs, chance = copied_series(run.read)
    unchanged = _unchanged_approaches(run)
    alike = float(np.ptp(run.read, axis=2).max()) == 0.0
    count = len(pairs) if chance < _COPIED or alike else 0
    text = f"Run {run.name}: no two series of approaches are equal in every digit, and no reading is frozen."
    if alike:
        text = (
            f"Run {run.name}: all {len(run.cycles)} cycles are equal in every digit: copies, or a reading coarser than "
        )
        text += "the scatter of the axis. Its repeatability cannot be determined."
    elif count:
        named = [f"{_series(run, i)} and {_series(run, j)}" for i, j in pairs]
        text = f"Run {run.name}: series are equal in every digit: {listed(named, 3)}."
    elif len(unchanged):
        text = f"Run {run.name}: the reading does not change from one target to another: {listed(unchanged, 3)}."
    verdict = FAIL if alike or count or len(unchanged) else PASS
    return Check("copied-approaches", run.subject, float(max(count, len(unchanged))), 0.0, "1", verdict, text)


def _series(run: PositioningRun, number: int) -> str:
    direction, cycle = divmod(number, len(run.cycles))
    return f"{WAYS[direction]} in cycle {run.cycles[cycle]}"


def _unchanged_approaches(run: PositioningRun) -> list[str]:
    """Return approaches with the reading of the previous row, which had another target."""
    order = np.argsort(run.row_order, axis=None)
    at = [np.array(k)[order] for k in np.unravel_index(np.arange(run.position.size), run.position.shape)]
    read = run.read.ravel()[order]
    again = np.flatnonzero((np.diff(read) == 0.0) & (np.diff(at[0]) != 0)) + 1
    return [run.place([int(k[row]) for k in at]) for row in again]


def _directions(run: PositioningRun) -> Check:
    turned = turned_cycles(run.deviation)
    contrary = _directions_are_exchanged(run)
    text = f"Run {run.name}: by the order of the rows, the axis moved forward and backward as recorded."
    if turned:
        names = listed([str(run.cycles[k]) for k in turned])
        text = f"Run {run.name}: in cycle {names} forward and backward are exchanged: their reversal has the sign "
        text += "opposite to that of the others."
    elif contrary:
        text = f"Run {run.name}: by the order of the rows forward and backward are exchanged. "
        text += "This changes the sign of the reversal, and nothing else."
    elif not _shows_movements(run):
        why = "the order of the rows does not show how the axis moved, so an exchange in a whole run cannot be detected"
        return not_evaluated("directions", "approach-directions", run.subject, why)
    verdict = FAIL if turned else WARN if contrary else PASS
    return Check("approach-directions", run.subject, float(len(turned)), 0.0, "1", verdict, text)


def _directions_are_exchanged(run: PositioningRun) -> bool:
    """Return True if forward rows descend and backward rows ascend in the order of the file.

    A file sorted by target ascends in both directions and gives no information.
    """
    forward, backward = _movements(run)
    return bool(len(forward) and len(backward) and (forward < 0).all() and (backward > 0).all())


def _shows_movements(run: PositioningRun) -> bool:
    """Return True if most forward rows ascend and most backward rows descend in the order of the file."""
    forward, backward = _movements(run)
    return bool(len(forward) and len(backward) and np.median(forward) > 0 and np.median(backward) < 0)


def _movements(run: PositioningRun) -> tuple[Array, Array]:
    """Return the signs of the steps between successive rows that are both forward, and both backward."""
    order = np.argsort(run.row_order, axis=None)
    target = np.broadcast_to(run.target[:, None, None], run.position.shape).ravel()[order]
    direction = np.broadcast_to(np.arange(2)[:, None], run.position.shape).ravel()[order]
    going, same = np.sign(np.diff(target)), np.diff(direction) == 0
    return going[same & (direction[1:] == 0)], going[same & (direction[1:] == 1)]


def _drift(run: PositioningRun) -> Check:
    drift = cycle_drift(run.deviation)
    if drift is None:
        return not_evaluated("drift", "position-drift", run.subject, "fewer than four cycles do not show a drift")
    walks = drift.p_value < _DRIFT and drift.share > _STRAIGHT
    text = f"Run {run.name}: from the first cycle to the last the deviations drift by {drift.walked:+.3g} um"
    text += f", {100.0 * drift.share:.0f} % of their differences between cycles." if walks else ", no more than chance "
    text += "" if walks else "or other differences between cycles make."
    return Check("position-drift", run.subject, abs(drift.walked), None, "um", WARN if walks else PASS, text)
