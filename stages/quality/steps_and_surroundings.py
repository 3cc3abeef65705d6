"""Checks of a loading programme: missing steps, incomplete runs, load range, and recorded surroundings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truing.estimation.interferometry.log_quality import (
    air_effect_m,
    pressures_out_of_reach,
    runs_cut_short,
    steps_missing,
    surroundings,
    temperatures_out_of_reach,
)
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.estimation.suspect_units import likely_pressure_unit
from truing.quality.loading import TEMPERATURES, LoadingView, first_steps, steps_without
from truing.report.numbers import count_text, listed
from truing.simulation.air import ciddor_index, vapour_pressure_pa
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.quality.check import COUNTED, FAIL, PASS, WARN, CampaignLimits, Check, not_evaluated
from truing.stages.quality.time_and_temperature import temperature_columns, temperature_units

if TYPE_CHECKING:
    from truing.schemas.interferometer import Interferometer
    from truing.schemas.sections import Loading

_RUNS_ALIKE = 3
_ROUNDED = 1e-9  # a load at its range is in it
_HUMIDITY_PCT = 50.0  # where it was not recorded: it hardly changes the index
_HUMIDITY = "relative_humidity_pct"
_MM, _HPA, _NM = 1e-3, 1e2, 1e-9


def missing_steps_check(view: LoadingView, limits: CampaignLimits) -> Check:
    """Numbers of steps that a run leaves out, or one of its tables; where all runs count in twos or tens, that is how
    they count."""
    steps = view.steps
    paces = np.diff(steps.step)[np.diff(steps.run) == 0]
    stride = max(math.gcd(*(int(pace) for pace in paces)), 1) if len(paces) else 1
    found = steps_missing(steps.run, (steps.step - first_steps(view)[steps.run]) // stride)
    lost = np.union1d(steps_without(steps.run, steps.reading), steps_without(steps.run, steps.signal))
    missing = int(found.size.sum()) + len(lost)
    share = missing / max(missing + len(steps.step), 1)
    places = [f"{view.run_name(steps.run[row])} near step {steps.step[row]}" for row in found.where]
    places += view.places(lost)
    text = f"{count_text(missing, 'step')} {'is' if missing == 1 else 'are'} missing: {listed(places)}."
    text = text if missing else "No step is missing."
    return limits.of("steps-missing").row("", share, "1", text)


def runs_complete(view: LoadingView) -> Check:
    """Runs that end before the others do, of the same axis where each has three."""
    steps = view.steps
    few = np.bincount(view.axis + 1)[view.axis + 1].min(initial=_RUNS_ALIKE) < _RUNS_ALIKE
    alike = np.zeros_like(view.axis) if few else view.axis
    cut_short = runs_cut_short(steps.run, steps.step - first_steps(view)[steps.run], alike[steps.run])
    names = [view.run_name(steps.run[row]) for row in cut_short.where]
    text = f"Runs that end earlier than others like them: {listed(names)}." if names else "No run was cut short."
    return Check("runs-cut-short", "", float(len(names)), 0.0, "1", WARN if names else PASS, text)


def missing_readings_checks(view: LoadingView, limits: CampaignLimits) -> Iterator[Check]:
    """Per channel, the share of readings missing in the runs that it was watched in."""
    steps = view.steps
    is_observed = np.isfinite(steps.reading)
    for k, channel in enumerate(CHANNELS):
        watched = np.isin(steps.run, np.unique(steps.run[is_observed[:, k]]))
        if not watched.any():
            continue
        share = float(1.0 - is_observed[watched, k].mean())
        text = f"{channel}: {100.0 * share:.1f} % of the readings are missing in the runs that have this channel."
        yield limits.of("completeness").row(f"channel {channel}", share, "1", text)
    if never := [channel for k, channel in enumerate(CHANNELS) if not is_observed[:, k].any()]:
        yield not_evaluated("never read", "completeness", f"channels {' '.join(never)}", "their response stays unknown")


def pauses(view: LoadingView, limits: CampaignLimits) -> Check:
    """A pause within a run much longer than the usual pace: zeros and temperatures may have moved meanwhile."""
    steps = view.steps
    within = np.flatnonzero(np.diff(steps.run) == 0)
    pause = np.diff(steps.time_s)[within]
    if view.is_counted:
        return not_evaluated("time gaps", "time-gaps", "", COUNTED)
    if len(pause) < 3 or np.median(pause) <= 0.0:
        return not_evaluated("time gaps", "time-gaps", "", "too few steps with times")
    longest, usual = int(pause.argmax()), float(np.median(pause))
    after = within[longest] + 1
    (where,) = view.places([after])
    times = pause[longest] / usual
    text = f"The longest pause within a run is {pause[longest]:.0f} s, {times:.1f} times the usual, before {where}."
    return limits.of("time-gaps", per=usual).row(where, float(pause[longest]), "s", text)


def load_range(view: LoadingView, loading: Loading, limits: CampaignLimits) -> Iterator[Check]:
    """Check that loads cover enough of the intended range of the sensor."""
    largest = np.abs(view.steps.load).max(axis=0, initial=0.0)
    enough = limits.of("load-range")
    for k, name in enumerate(LOAD_COLUMNS):
        full, allowed = getattr(loading, name), loading.allowed(name)
        if full is None or allowed is None or largest[k] == 0.0:
            continue
        share = float(largest[k] / full)
        text = f"{LOADS[k]}: the largest load is {100.0 * share:.0f} % of the range."
        if share > 1.0 + _ROUNDED:
            text += f" [loading] declares an overload test up to {100.0 * allowed / full:.0f} %."
        if enough.verdict(share) != PASS:
            text += " Above that, results are extrapolated."
        yield enough.row(f"load {LOADS[k]}", share, "1", text)


def surroundings_checks(
    view: LoadingView, optics: Interferometer, reference_c: float, limits: CampaignLimits
) -> Iterator[Check]:
    """Every check of temperatures, pressure and the air along the beams."""
    known = view.steps.covariates
    for name in (*TEMPERATURES, "air_pressure_hpa"):
        quantity = name.rsplit("_", 1)[0].replace("_", " ")
        if name not in known or not np.isfinite(known[name]).any():
            yield not_evaluated(quantity, "surroundings", quantity, "it was not recorded")
            continue
        yield _likely(view, name, quantity)
        yield _steady(view, name, quantity, limits)
    recorded = {name: known[name] for name in temperature_columns(known)}
    order = np.argsort(view.steps.time_s, kind="stable")
    yield from temperature_units(recorded, reference_c, view.places(range(len(order))), order)
    yield from _humidity(view)
    yield _air(view, optics, limits)


def _likely(view: LoadingView, name: str, quantity: str) -> Check:
    """Values that no laboratory has: another unit, or a sensor that is off."""
    value = view.steps.covariates[name]
    is_temperature = name in TEMPERATURES
    out_of_reach = temperatures_out_of_reach(value) if is_temperature else pressures_out_of_reach(value * _HPA)
    steps = view.places(out_of_reach.where)
    worst = float(np.nanmax(np.abs(value)))
    unit = "degC" if is_temperature else "hPa"
    limit = out_of_reach.limit if is_temperature else out_of_reach.limit / _HPA
    text = f"The {quantity} is within the range of a laboratory."
    likely = "" if is_temperature else likely_pressure_unit(float(np.nanmedian(value)))
    if steps:
        meant = f"; did you mean {likely}?" if likely else "; is the unit right?"
        text = f"The {quantity} is outside the range of a laboratory{meant} {listed(steps)}."
    elif likely:
        text = f"The {quantity} is within the range of a laboratory at high altitude; did you mean {likely}?"
    verdict = FAIL if steps else WARN if likely else PASS
    return Check("surroundings", quantity, worst, limit, unit, verdict, text)


def _humidity(view: LoadingView) -> Iterator[Check]:
    """Warn if all humidities are at most 1: they are likely fractions, not per cent."""
    value = view.steps.covariates.get(_HUMIDITY)
    if value is None or not np.isfinite(value).any():
        return
    largest = float(np.nanmax(value))
    is_share = 0.0 < largest <= 1.0
    text = f"The largest relative humidity is {largest:.3g} %"
    if is_share:
        text += (
            f", less than in any laboratory; if it is a fraction of 1 ({100.0 * largest:.3g} %), give it in per cent."
        )
    else:
        text += "; only values up to 1 % would indicate fractions of 1 in place of per cent."
    yield Check("surroundings", "relative humidity", largest, 1.0, "%", WARN if is_share else PASS, text)


def _steady(view: LoadingView, name: str, quantity: str, limits: CampaignLimits) -> Check:
    """Check the range of a quantity within runs and over the campaign."""
    value = view.steps.covariates[name]
    changes = surroundings(value, view.steps.run)
    span = np.where(np.isfinite(changes.span), changes.span, 0.0)
    worst = int(np.argmax(span))
    over_all = float(np.nanmax(value) - np.nanmin(value))
    is_temperature = name in TEMPERATURES
    unit = "K" if is_temperature else "hPa"
    read = np.isfinite(view.steps.reading).any(axis=1)
    missing = float(1.0 - np.isfinite(value[read]).mean())
    text = (
        f"The {quantity} changed by {over_all:.3g} {unit} in total, within a run by {span[worst]:.3g} {unit} at most "
    )
    text += f"({view.run_name(worst)})."
    if missing:
        text += f" It is missing in {100.0 * missing:.0f} % of the steps."
    limit = limits.of("temperature-span") if is_temperature else limits.of("pressure-span")
    row = limit.row(quantity, float(span[worst]), unit, text)
    return replace(row, verdict=WARN) if missing and row.verdict == PASS else row


def _air(view: LoadingView, optics: Interferometer, limits: CampaignLimits) -> Check:
    """Check the effect on readings of changes of the air since each run's start, over dead path and displacement."""
    known = view.steps.covariates
    if not {"air_temperature_c", "air_pressure_hpa"} <= set(known):
        return not_evaluated(
            "worth of the air", "worth-of-air", "", "temperature and pressure of the air were not recorded"
        )
    celsius, pressure = known["air_temperature_c"], known["air_pressure_hpa"]
    humidity = np.nan_to_num(known.get("relative_humidity_pct", np.full(len(celsius), np.nan)), nan=_HUMIDITY_PCT)
    vapour = vapour_pressure_pa(celsius, 1e-2 * humidity)
    change = surroundings(
        ciddor_index(_NM * optics.wavelength_nm, celsius, _HPA * pressure, vapour), view.steps.run
    ).change
    worst, at = 0.0, ""
    noise = np.inf
    for channel in view.channels:
        if not channel.name.startswith("d"):
            continue
        reading = view.steps.reading[channel.rows, channel.place]
        dead = _MM * getattr(optics.dead_path_mm, channel.name)
        worth = air_effect_m(np.nan_to_num(change)[view.steps.run[channel.rows]], dead, reading)
        noise = min(noise, channel.sigma)
        if worth.max() >= worst:
            worst, at = float(worth.max()), channel.name
    if not at:
        return not_evaluated("worth of the air", "worth-of-air", "", "no linear channel was read")
    text = f"Changes of the air within a run change the reading {at} by at most {1e6 * worst:.2g} um; "
    text += "the files hold compensated readings." if optics.compensated else "this run compensates for them."
    limit = limits.of("worth-of-air", per=1e6 * noise)
    return limit.row(at, 1e6 * worst, "um", text, counts=optics.compensated)
