"""Checks of a loading campaign, and their shares of the false-alarm budget.

As in ``point_checks``: failing significance tests share ``[qa] false_alarm``; tests that only warn get ten times that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, TableRow
from truing.quality.load_responses import run_responses, sign_reversed, signal_responses
from truing.quality.loading import ExpectedReadings, LoadingView
from truing.report.numbers import count_text, percent
from truing.stages.common.beam_rows import channel_rows
from truing.stages.common.reading_arrays import load_steps
from truing.stages.common.sensor_elements import declared_compliance
from truing.stages.quality.belonging import belonging_checks, without_contradiction
from truing.stages.quality.bench_descriptions import relations_of_loads
from truing.stages.quality.check import CampaignLimits, Check, CheckResults, not_evaluated
from truing.stages.quality.joined_loads import joined_loads_check
from truing.stages.quality.manual_exclusions import decision_checks
from truing.stages.quality.position_checks import position_checks, positioning_runs
from truing.stages.quality.reading_checks import (
    drift,
    exchanged_channels,
    gross_errors,
    jumps,
    noise,
    not_only_noise,
    repeatability,
    run_zeros,
    signs,
    units,
    zero_return,
)
from truing.stages.quality.signal_checks import signal_checks
from truing.stages.quality.steps_and_surroundings import (
    load_range,
    missing_readings_checks,
    missing_steps_check,
    pauses,
    runs_complete,
    surroundings_checks,
)
from truing.stages.quality.time_and_temperature import time_unit

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_CHANCE_CHECKS = 3  # noise, signs, exchanged rows: the failing checks that chance can trip


def checks(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """Return all checks of load steps and of an axis' positioning runs."""
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    runs = list(positioning_runs(tables["positions"])) if "positions" in tables else []
    of_axis = position_checks(runs, limits)
    approaches = (
        f"{count_text(tables['positions'].num_rows, 'approach')} of an axis in {count_text(len(runs), 'run')}"
        if runs
        else ""
    )
    if not any(name in tables and tables[name].num_rows for name in ("readings", "signals")):
        return CheckResults(of_axis, approaches, why_not="" if runs else "no readings and no signals")
    compliance = declared_compliance(tables, settings)
    seen = None if compliance is None else np.asarray(channel_rows(settings.interferometer.beams) @ compliance)
    view = _view(tables, settings, compliance, seen)
    relations = relations_of_loads(view.steps, seen, settings)
    found = chain(
        quadrature_checks(tables["quadrature"], limits) if "quadrature" in tables else (),
        _checks(view, settings, limits),
        _correction_checks(view, tables["reading_corrections"], limits) if "reading_corrections" in tables else (),
        [joined_loads_check(view.steps, tables["loads_joined"])] if "loads_joined" in tables else (),
    )
    read = f"{count_text(len(view.steps.run), 'load step')} in {count_text(len(view.steps.runs), 'run')}"
    return CheckResults(
        chain(belonging_checks(relations), without_contradiction(found, relations), of_axis),
        f"{read}; {approaches}" if approaches else read,
        relations,
    )


def _view(
    tables: Mapping[str, pa.Table], settings: Campaign, compliance: Array | None, seen: Array | None
) -> LoadingView:
    """Return readings and signals with the simulated readings; ``is_observed``: compliance in terms of the channels."""
    steps, noise = load_steps(tables), settings.noise
    load_sigma = np.array([noise.load_n] * 3 + [noise.load_nm] * 3)
    if compliance is None or seen is None:
        return LoadingView(steps, None, load_sigma)
    gives = np.maximum(np.diag(compliance), 0.0)
    at_most = np.sqrt((steps.load**2 @ gives)[:, None] * gives)
    return LoadingView(steps, ExpectedReadings(steps.load @ seen.T, at_most), load_sigma)


def _checks(view: LoadingView, settings: Campaign, limits: CampaignLimits) -> Iterator[Check]:
    """Yield all checks: load programme, single channels, surroundings, signals."""
    share = settings.qa.false_alarm / _CHANCE_CHECKS
    yield from decision_checks(view, settings)
    yield missing_steps_check(view, limits)
    yield runs_complete(view)
    yield pauses(view, limits)
    table = "interferometer" if view.channels else "signals"
    yield time_unit(view.steps.time_s, view.steps.run, table, "step", is_counted=view.is_counted)
    yield from load_range(view, settings.loading, limits)
    if view.channels:
        yield from _check_readings(view, settings, share, limits)
    else:
        yield not_evaluated("readings", "completeness", "", "the campaign holds no readings of the platform's motion")
    turned: frozenset[int] = frozenset()
    if view.steps.signals:
        found = signal_responses(view)
        yield from signs(view, found, "signals", 0.5 * share)
        turned = frozenset(found.run[sign_reversed(found, 0.5 * share)].tolist())
    yield from signal_checks(view, settings, turned, share)


def _check_readings(view: LoadingView, settings: Campaign, share: float, limits: CampaignLimits) -> Iterator[Check]:
    yield from missing_readings_checks(view, limits)
    found = run_responses(view)
    yield from units(view, found)
    yield from signs(view, found, "readings", 0.5 * share)
    yield from exchanged_channels(view)
    yield from run_zeros(view)
    each = share / len(view.channels)
    not_noise = not_only_noise(view, each)
    for channel in view.channels:
        yield gross_errors(view, channel, limits)
        yield noise(channel, each, channel.name in not_noise)
        yield drift(view, channel, 10.0 * each)
        yield zero_return(view, channel, 10.0 * each)
        yield repeatability(view, channel, 10.0 * each)
    yield from jumps(view, 10.0 * share)
    reference = settings.mechanism.reference_temperature_c
    yield from surroundings_checks(view, settings.interferometer, reference, limits)


def _correction_checks(view: LoadingView, corrections: pa.Table, limits: CampaignLimits) -> Iterator[Check]:
    """Yield one check per channel and correction with a declared uncertainty."""
    noise = {channel.name: channel.declared * channel.in_files for channel in view.channels}
    for row in corrections.to_pylist():
        name, left = row["subject"], row["sigma"]
        if left is None or name not in noise:
            continue
        by = "" if row["largest"] is None else f" by {row['largest']:.2g} {row['unit']} at most, which"
        text = f"{name} is corrected for the {row['correction']}{by or ' as it came, which'}"
        text += f" is known to {left:.2g} {row['unit']} (one sigma)."
        limit = limits.of("corrections", per=noise[name])
        yield limit.row(f"channel {name} {row['correction']}", left, row["unit"], text)


def quadrature_checks(channels: pa.Table, limits: CampaignLimits) -> Iterator[Check]:
    """Yield two checks per channel: roundness of the raw signals and risk of miscounted fringes."""
    for row in channels.to_pylist():
        yield _round(row, limits)
        yield _counted(row, limits)


def _round(row: TableRow, limits: CampaignLimits) -> Check:
    share, uncut = row["radius_after"] / row["radius_mean"], row["radius_uncut"] / row["radius_mean"]
    name = row["channel"]
    text = (
        f"{name}: corrected by its ellipse, the radius of the raw signals scatters by {percent(100.0 * share)} of it."
    )
    if row["cut_share"] > 0.0:
        text += f" {percent(100.0 * row['cut_share'])} of the samples stand at an end of the converter's range;"
        text += f" the others scatter by {percent(100.0 * uncut)} about an ellipse of their own."
    return limits.of("signals-round").row(f"channel {name}", share, "1", text)


def _counted(row: TableRow, limits: CampaignLimits) -> Check:
    risk, name = row["miscount_risk"], row["channel"]
    text = f"{name}: the probability of a miscount by one fringe is at most {risk:.1g} for each step between samples."
    return limits.of("fringes-counted").row(f"channel {name}", risk, "1", text)
