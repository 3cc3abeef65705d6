"""Checks over time: drift of the base, pauses, units of times; range and units of temperatures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.quality import find_drift
from truing.estimation.suspect_units import (
    FEWEST,
    SECONDS_PER_UNIT,
    MistakenRows,
    MistakenTimes,
    MistakenUnit,
    mistaken_rows,
    mistaken_times,
    mistaken_unit,
)
from truing.quality.bodies import BodyView, PoseSurroundings
from truing.report.numbers import count_text, duration, listed
from truing.stages.quality.check import COUNTED, FAIL, PASS, WARN, CampaignLimits, Check, not_evaluated

_LEAST_POSES = 8  # that tell a walk from chance
_LEAST_OF_STEP, _BY_STEP = 2, 0.9  # poses on either side of a step, and its least share of the squares
_UNITS = {"d": "days", "h": "hours", "min": "minutes", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_WORDS = {"K": "kelvin", "degF": "degrees Fahrenheit"}


def base_drift(body: BodyView | None, share: float, *, frame_stays: bool) -> Iterator[Check]:
    """Check for a drift of the reference body in the frame of the measurement.

    Not evaluated without a reference body. If the frame may change by pose, a drift is reported, but its absence is not
    confirmed.
    """
    if body is None:
        yield not_evaluated("drift of the base", "base-drift", "", "[bodies] reference names no stationary body")
        return
    if body.good.all(axis=1).sum() < _LEAST_POSES:
        why = f"{body.name}: fewer than eight poses show all its targets"
        yield not_evaluated("drift of the base", "base-drift", body.name, why)
        return
    drift = find_drift(body.points.points, body.good)
    size = float(drift.span.max(initial=0.0)) * 1e3
    sigma = float(np.median(body.sigma)) * 1e3
    walks = drift.p_value < share and size > 3.0 * sigma
    target = body.survey.targets[int(drift.span.argmax())] if len(drift.span) else ""
    if not walks and not frame_stays:
        why = f"{body.name}: campaign.toml does not say that all poses share one frame ([measurement] frame)"
        yield not_evaluated("drift of the base", "base-drift", body.name, why)
        return
    message = f"{body.name}: no drift in the frame of the measurement."
    if walks:
        since = _step(body.points.points, body.good)
        how, start = ("drifts", "") if since is None else ("jumps", f" from pose {body.points.poses[since]} on")
        message = (
            f"{body.name}: {how} by {size:.3f} mm in the frame of the measurement{start}, most at target {target}."
        )
    yield Check("base-drift", body.name, size if walks else 0.0, 3.0 * sigma, "mm", WARN if walks else PASS, message)


def _step(points: Array, good: Mask) -> int | None:
    """Return the first pose after a single step of points (B, T, 3); None where they move otherwise.

    Only poses that show all targets count. An even drift leaves a quarter of its squares next to the best step.
    """
    seen = np.flatnonzero(good.all(axis=1))
    place = points[seen].reshape(len(seen), -1)
    place = place - place.mean(axis=0)
    first = np.arange(_LEAST_OF_STEP, len(seen) - _LEAST_OF_STEP + 1)
    if not len(first):
        return None
    sums = np.cumsum(place, axis=0)[first - 1]
    explained = np.sum(sums**2, axis=1) * (1.0 / first + 1.0 / (len(seen) - first))
    best = int(np.argmax(explained))
    is_step = explained[best] > _BY_STEP * np.sum(place**2)
    return int(seen[first[best]]) if is_step else None


def time_gaps(around: PoseSurroundings, limits: CampaignLimits) -> Check:
    """Check for a pause much longer than the usual interval, during which something may have changed."""
    steps = np.diff(around.time)
    if around.is_counted:
        return not_evaluated("time gaps", "time-gaps", "", COUNTED)
    if len(steps) < 3 or np.median(steps) <= 0.0:
        return not_evaluated("time gaps", "time-gaps", "", "no times")
    longest = int(steps.argmax())
    usual = float(np.median(steps))
    return limits.of("time-gaps", per=usual).row(
        f"pose {around.poses[longest + 1]}",
        float(steps[longest]),
        "s",
        f"The longest pause is {steps[longest]:.0f} s, {steps[longest] / usual:.1f} times the usual, "
        f"before pose {around.poses[longest + 1]}.",
    )


def time_unit(time: Array, run: Index | None, table: str, quantity: str, *, is_counted: bool) -> Check:
    """Check that times (N,) of runs (N,), or without runs, are in seconds; ``table``, ``quantity``: table and name of a
    row."""
    if is_counted:
        return not_evaluated("unit of times", "time-unit", "", COUNTED)
    if np.isfinite(time).sum() < FEWEST:
        return not_evaluated("unit of times", "time-unit", "", "too few rows with times")
    mistaken = mistaken_times(time, run)
    if mistaken is None:
        text = f"The times of {table} are plausible as seconds."
        return Check("time-unit", table, 1.0, 1.0, "s", PASS, text)
    factor = SECONDS_PER_UNIT[mistaken.unit]
    text = f"time_s of {table} increases by {mistaken.pace:.3g} from {quantity} to {quantity}, and is likely in "
    text += f"{_UNITS.get(mistaken.unit, mistaken.unit)} ({_paced(mistaken, mistaken.unit)})"
    text += "".join(f", or in {_UNITS[unit]} ({_paced(mistaken, unit)})" for unit in mistaken.others)
    return Check(
        "time-unit", table, factor, 1.0, "s", WARN, f"{text}: write {_cure(mistaken.unit)} in [files.{table}]."
    )


def _paced(mistaken: MistakenTimes, unit: str) -> str:
    return f"{duration(float(f'{mistaken.pace * SECONDS_PER_UNIT[unit]:.3g}'))} each"


def _cure(unit: str) -> str:
    if unit in ("ns", "100 ns"):
        return f"columns = {{ time_s = {{ scale = {SECONDS_PER_UNIT[unit]:g} }} }}"
    return f'units = {{ time_s = "{unit}" }}'


def temperature_span(around: PoseSurroundings, limits: CampaignLimits) -> Check:
    """Check the range of the temperature, which limits the detection of thermal effects."""
    if around.temperature is None or not np.isfinite(around.temperature).any():
        return not_evaluated("temperature", "temperature-span", "", "no temperatures were recorded")
    low, high = float(np.nanmin(around.temperature)), float(np.nanmax(around.temperature))
    text = f"The temperature was {low:.2f} to {high:.2f} degrees C."
    return limits.of("temperature-span").row("", high - low, "K", text)


def temperature_columns(names: Iterable[str]) -> list[str]:
    """Return the columns that hold temperatures in degrees Celsius, by their names."""
    return [name for name in names if name.endswith("_c")]


def temperature_units(
    recorded: Mapping[str, Array],
    reference_c: float,
    rows: Sequence[str] = (),
    order: Index | None = None,
) -> Iterator[Check]:
    """Yield one row per column of temperatures (N,), compared with [mechanism] reference_temperature_c and within
    itself.

    ``rows`` (N,): names of the rows; ``order`` (N,): rows in time order. A contradiction fails, because it would act as
    an expansion by tens or hundreds of kelvins. A reference that looks like another unit by itself warns.
    """
    columns = {name: value for name, value in recorded.items() if np.isfinite(value).any()}
    for name, value in columns.items():
        part = mistaken_rows(value, order)
        if part is not None:
            yield _check_part(name, value, part, reference_c, rows)
        else:
            yield _check(name, value, reference_c, mistaken_unit(value, reference_c))
    if not columns:
        alone = mistaken_unit([], reference_c)
        if alone is None:
            yield not_evaluated("unit of temperatures", "temperature-unit", "", "no temperatures were recorded")
        else:
            yield _check("reference", np.array([reference_c]), reference_c, alone)


def _check_part(name: str, value: Array, part: MistakenRows, reference_c: float, rows: Sequence[str]) -> Check:
    """Return the check of a column of which a part is in another unit."""
    low, high = float(value[part.rows].min()), float(value[part.rows].max())
    read = f"{low:.5g}" if low == high else f"{low:.5g} to {high:.5g}"
    known = int(np.isfinite(value).sum())
    text = (
        f"{name}: {len(part.rows)} of {count_text(known, 'row')} ({read}) likely in {_WORDS[part.unit]}, the others in "
    )
    text += f"degrees Celsius: did you mean {part.celsius:.5g} degC, next to {part.others:.5g}? "
    text += f"Convert {listed(_stretches(part.rows, rows))}."
    return Check("temperature-unit", name, high, reference_c, "degC", FAIL, text)


def _stretches(at: Index, names: Sequence[str]) -> list[str]:
    """Return rows (K,) in words; successive rows as one range."""
    parts = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    called = [(_row_name(part[0], names), _row_name(part[-1], names)) for part in parts]
    return [first if first == last else f"{first} to {last}" for first, last in called]


def _row_name(row: int, names: Sequence[str]) -> str:
    return names[row] if names else f"row {row + 1}"


def _check(name: str, value: Array, reference_c: float, mistaken: MistakenUnit | None) -> Check:
    typical = float(np.nanmedian(value))
    if mistaken is None:
        text = f"{name}: {typical:.5g} degC; the reference is {reference_c:g} degC."
        return Check("temperature-unit", name, typical, reference_c, "degC", PASS, text)
    what = f"reference_temperature_c = {reference_c:g}" if mistaken.of_reference else f"{name}: {typical:.5g}"
    beside = (
        f" next to a reference of {reference_c:g}" if not mistaken.of_reference else f" next to {typical:.5g} in {name}"
    )
    text = f"{what}{beside if mistaken.certain else ''} is likely in {_WORDS[mistaken.unit]}; "
    text += f"did you mean {mistaken.celsius:.5g} degC"
    if mistaken.of_reference:
        text += "?"
    elif mistaken.rows < np.isfinite(value).sum():
        text += (
            f"? It concerns {count_text(mistaken.rows, 'row')}; convert these, for the others are in degrees Celsius."
        )
    else:
        text += f'? It concerns {count_text(mistaken.rows, "row")}; units = {{ {name} = "{mistaken.unit}" }}.'
    return Check("temperature-unit", name, typical, reference_c, "degC", FAIL if mistaken.certain else WARN, text)
