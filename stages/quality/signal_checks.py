"""Checks of a sensor's signals and loads: clipped signals, unloaded directions, exchanged rows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.design.observability import Observability, inseparable, observe
from truing.estimation.interferometry.log_quality import saturated
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.exchanged_loads import (
    RowExchange,
    StrayLoad,
    least_difference,
    search_exchanges,
    stray_loads,
)
from truing.estimation.sensor.load_table import LoadTable, least_signal, load_table
from truing.quality.loading import LoadingView, predicted_by_loads, scatter_of_signal
from truing.report.numbers import count_text, listed
from truing.stages.quality.check import FAIL, PASS, WARN, Check, not_evaluated
from truing.stages.quality.unit_slips import IMPLAUSIBLE_RATIO, unit_slip

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_MILLIVOLT = 1e-3
_APART = 1e3  # loads that differ from a combination of others by less than that part of their size are that combination
_ROUNDING = 1e-6  # of the largest signal: what is left of a combination that is exactly none
_FEWEST = 8
_NEARLY_EQUAL = 0.05  # of loads asked for by signals, and recorded with a mistake undone
# Share of the usual change of a signal below which one responds to no load.
_IDLE = 0.02
_MISTAKES = (
    (0.1, "a tenth of it"),
    (10.0, "ten times as much"),
    (1e-3, "a thousandth of it"),
    (1e3, "a thousand times as much"),
    (-1.0, "the opposite sign"),
    (9.80665, "as for kgf in place of N"),
)


def signal_checks(view: LoadingView, settings: Campaign, turned: frozenset[int], share: float) -> Iterator[Check]:
    """Every check of signals against loads; turned: runs whose sign is known to be wrong, and not their rows."""
    steps = view.steps
    if not steps.signals:
        yield not_evaluated("signals", "signals", "", "the campaign holds none")
        return
    used = np.flatnonzero(np.isfinite(steps.signal).all(axis=1))
    for at, name in enumerate(steps.signals):
        yield _saturated_samples(view, at, name, settings)
    yield _steps_without_signals(view)
    yield _noise(view, settings.noise.signal_mv)
    if len(used) < _FEWEST:
        yield not_evaluated("calibration", "loads-span", "", "too few load steps with all signals")
        return
    load, signal = steps.load[used], steps.signal[used]
    loaded = np.flatnonzero(load.any(axis=0))
    yield _loads_span(load[:, loaded], [LOADS[k] for k in loaded])
    about = signal if settings.signals.zero_mv is not None else signal - signal.mean(axis=0)
    independent = _signals_independent(about, steps.signals, len(loaded), settings.noise.signal_mv)
    yield independent
    right = used[~np.isin(steps.run[used], sorted(turned))]
    numbers = int(independent.value or 0) if independent.verdict == FAIL else len(steps.signals)
    yield from _exchanged(view, right, len(loaded), numbers, share)


def _saturated_samples(view: LoadingView, at: int, name: str, settings: Campaign) -> Check:
    """Samples at an end of the amplifier's range, where the signal is clipped."""
    steps = view.steps
    rows = np.flatnonzero(np.isfinite(steps.signal[:, at]))
    if not len(rows):
        return not_evaluated("never read", "saturated", f"signal {name}", "no step has a value of it")
    value = steps.signal[rows, at]
    range_mv, are_means = settings.signals.range_mv, settings.signals.average_samples
    limit = None if range_mv is None else range_mv * _MILLIVOLT
    is_clipped = np.zeros(len(rows), dtype=bool) if limit is None else np.abs(value) >= limit * (1.0 - 1e-9)
    is_clipped[saturated(value, predicted_by_loads(steps.load[rows], value)).where] = True
    places = view.places(rows[is_clipped])
    text = f"{name}: no sample is at an end of its range."
    if are_means:
        text = f"{name}: no mean of samples is at an end of its range; single samples were not tested."
    if places:
        ends = " and ".join(f"{1e3 * end:.6g} mV" for end in np.unique(value[is_clipped]))
        text = (
            f"{name}: {count_text(len(places), 'sample')} {'is' if len(places) == 1 else 'are'} "
            f"cut at {ends}: {listed(places)}."
        )
    count = float(len(places))
    return Check("saturated", f"signal {name}", count, 0.0, "1", FAIL if places else PASS, text)


def _steps_without_signals(view: LoadingView) -> Check:
    """Load steps at which neither a signal nor a reading was recorded."""
    steps = view.steps
    without = ~np.isfinite(np.column_stack([steps.signal, steps.reading])).any(axis=1)
    count = int(np.count_nonzero(without))
    text = "Every load step has a signal or a reading."
    if count:
        text = f"{count} of {count_text(len(steps.load), 'load step')} have no signal."
    verdict = WARN if count else PASS
    return Check("steps-without-signals", "signals", float(count), 0.0, "1", verdict, text)


def _noise(view: LoadingView, noise_mv: float | None) -> Check:
    """The scatter of signals that follows neither loads nor time, over the declared noise: are the two of one size?"""
    steps = view.steps
    if noise_mv is None:
        return not_evaluated("noise", "noise", "signals", "no noise is declared for them")
    ratios = [scatter_of_signal(view, at, noise_mv * _MILLIVOLT) for at in range(len(steps.signals))]
    known = [ratio for ratio in ratios if np.isfinite(ratio)]
    if not known:
        return not_evaluated("noise", "noise", "signals", "too few load steps for the number of possible inputs")
    ratio = float(np.median(known))
    slip = unit_slip(ratio, noise_mv, "mV")
    text = (
        f"signals: the scatter is {ratio:.3g} times the declared noise, median of {count_text(len(known), 'signal')}."
    )
    if slip and ratio > 1.0:
        slip += " Otherwise signals depend on an input that was not recorded."
    if slip and ratio < 1.0:
        slip += " Or are the signals in another unit?"
    return Check("noise", "signals", ratio, IMPLAUSIBLE_RATIO, "1", WARN if slip else PASS, text + slip)


def _loads_span(load: Array, names: list[str]) -> Check:
    """Check that the loads determine all components of the wrench, and name those that were never loaded."""
    never = [name for name in LOADS if name not in names]
    if not names:
        return Check("loads-span", "", 0.0, 6.0, "1", FAIL, "No step is loaded, so nothing can be calibrated.")
    seen = observe(load, 1.0 / np.linalg.norm(load, axis=0), names, unidentifiable=_APART)
    rank = int(seen.rank)
    if rank < len(names):
        text = f"The loads do not cover all directions, V V^T is singular: {_open(seen)}."
        return Check("loads-span", "", float(rank), float(len(names)), "1", FAIL, text)
    if never:
        text = f"{listed(never)} never loaded: only {rank} components can be calibrated, and V V^T is singular."
        return Check("loads-span", "", float(rank), 6.0, "1", WARN, text)
    return Check("loads-span", "", 6.0, 6.0, "1", PASS, "The loads span all six components.")


def _open(seen: Observability) -> str:
    return "; ".join(group.text for group in inseparable(seen))


def _signals_independent(about: Array, names: tuple[str, ...], loaded: int, noise_mv: float | None) -> Check:
    """Check that signals (N, S), minus their zero, have as many independent components as loads, with and without
    noise."""
    wanted, count = min(len(names), loaded), len(about)
    size = float(np.linalg.norm(about, axis=0).max())
    if size == 0.0:
        text = "No signal changes with the load: V V^T is singular."
        return Check("signals-independent", "", 0.0, float(wanted), "1", FAIL, text)
    seen = observe(about, np.full(len(names), 1.0 / size), names, unidentifiable=1.0 / _ROUNDING)
    verdict, but = FAIL, ""
    if seen.rank >= wanted and noise_mv:
        level = np.full(len(names), 1.0 / (noise_mv * _MILLIVOLT))
        seen = observe(about, level, names, unidentifiable=1.0 / least_signal(count))
        verdict, but = WARN, " but for noise"
    rank = float(seen.rank)
    determined = f"The {len(names)} signals determine {rank:.0f} independent quantities"
    if rank >= wanted:
        text = f"{determined}; the loads have {loaded} components."
        return Check("signals-independent", "", rank, float(wanted), "1", PASS, text)
    text = f"{determined}, but the loads have {loaded} components: "
    text += f"V V^T is singular{but}; {_open(seen)}."
    return Check("signals-independent", "", rank, float(wanted), "1", verdict, text + _idle(about, names))


def _idle(about: Array, names: tuple[str, ...]) -> str:
    """Return the sentence on signals (N, S), minus their zero, that hardly change; empty where there are none."""
    spread = np.sqrt(np.mean(about**2, axis=0))
    idle = [name for name, size in zip(names, spread, strict=True) if size < _IDLE * float(np.median(spread))]
    if not idle:
        return ""
    responds = "responds" if len(idle) == 1 else "respond"
    return f" {listed(idle)} {responds} to no load: disconnected, or dead?"


def _exchanged(view: LoadingView, rows: Index, loaded: int, independent: int, share: float) -> Iterator[Check]:
    """Rows whose loads stand in each other's place, by the signals."""
    steps = view.steps
    if loaded > independent or len(rows) < 3 * (len(steps.signals) + 1):
        why = "too few signals or rows to predict the loads of each row"
        yield not_evaluated("loads of single rows", "stray-loads", "", why)
        yield not_evaluated("exchanged rows", "exchanged-rows", "", why)
        return
    table = load_table(steps.signal[rows], steps.load[rows], steps.run[rows])
    exchanges, unseen = search_exchanges(table, share)
    yield from _stray(
        view, rows, stray_loads(table, {row for exchange in exchanges for row in (exchange.first, exchange.second)})
    )
    for row_exchange in exchanges:
        yield _pair(view, rows, row_exchange)
    if unseen:
        why = f"of {count_text(len(rows), 'row')} so many are gross errors that {unseen} pairs were not tested"
        yield not_evaluated("exchanged rows", "exchanged-rows", "other pairs", why)
    elif not exchanges:
        yield _no_exchange_found(table, share)


def _stray(view: LoadingView, rows: Index, stray: list[StrayLoad] | None) -> Iterator[Check]:
    """Single rows whose signals indicate another load."""
    if stray is None:
        why = "the signals of many rows indicate other loads: these are not single mistakes"
        yield not_evaluated("loads of single rows", "stray-loads", "", why)
        return
    for stray_load in stray:
        step = view.places(rows[[stray_load.row]])[0]
        name = LOADS[stray_load.component]
        unit = "N" if name.startswith("f") else "N m"
        text = f"{step}: {name} is recorded as {stray_load.written:.6g} {unit}, "
        text += f"and the signals indicate {stray_load.asked:.4g} {unit}"
        yield Check("stray-loads", step, stray_load.sigmas, 0.0, "1", FAIL, f"{text}{_likely(stray_load)}.")
    if not stray:
        yield Check("stray-loads", "", 0.0, 0.0, "1", PASS, "The signals of every row agree with its recorded load.")


def _likely(stray_load: StrayLoad) -> str:
    """Return the mistake that turns the indicated load into the recorded one, as the end of a sentence."""
    for factor, words in _MISTAKES:
        if stray_load.written and abs(stray_load.asked / (factor * stray_load.written) - 1.0) < _NEARLY_EQUAL:
            return f", {words}"
    return ": a misread digit, the load of another row, or a disturbed signal"


def _no_exchange_found(table: LoadTable, share: float) -> Check:
    """No exchange found; the value is the difference of two loads, over their range, from which one is named."""
    span = np.ptp(table.loads, axis=0)
    used = np.flatnonzero(span > 0.0)
    shares = least_difference(table, share)[used] / span[used]
    names = [LOADS[k] for k in used]
    least = float(shares.max(initial=0.0))
    text = f"No exchange of loads is significant among {len(table.loads)} rows. "
    unseen = [name for name, possible in zip(names, shares, strict=True) if possible >= 1.0]
    if unseen:
        text += f"No exchange of {listed(unseen)} would be: signals determine it no better than by its range. "
    elif names:
        worst = names[int(np.argmax(shares))]
        text += f"Exchanges of loads that differ by less than {100.0 * least:.2g} % of the range cannot be detected "
        text += f"({worst}, the worst). "
    text += "Loads exchanged or reversed in whole runs cannot be detected here."
    return Check("exchanged-rows", "", least, None, "1", PASS, text)


def _pair(view: LoadingView, rows: Index, exchange: RowExchange) -> Check:
    steps = view.places(rows[[exchange.first, exchange.second]])
    names = " ".join(LOADS[k] for k in exchange.components)
    text = f"The loads ({names}) of {steps[0]} and {steps[1]} are exchanged: the error of their signals is "
    text += f"{exchange.before:.0f} sigmas as recorded and {exchange.after:.1f} sigmas after the exchange."
    return Check("exchanged-rows", " and ".join(steps), exchange.before, exchange.after, "1", FAIL, text)
