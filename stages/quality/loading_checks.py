"""The checks of a loading campaign, and how they share the budget of chance.

As in ``checks``: what fails by chance shares ``[qa] false_alarm``; what only warns is held at ten times its share.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from truing.quality.answers import answers, signal_answers, turned_round
from truing.quality.loading import LoadingView
from truing.stages.quality.check import Check, without
from truing.stages.quality.limits import CampaignLimits
from truing.stages.quality.of_decisions import overruled
from truing.stages.quality.of_labels import exchanged_channels
from truing.stages.quality.of_readings import drift, gross_errors, jumps, noise, repeatability, signs, units
from truing.stages.quality.of_signals import signal_checks
from truing.stages.quality.of_steps import load_range, pauses, readings_there, runs_whole, steps_there
from truing.stages.quality.of_surroundings import surroundings_checks
from truing.stages.quality.of_time import time_unit
from truing.stages.quality.of_zeros import run_zeros, zero_return

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_CHANCE_CHECKS = 3  # noise, signs, exchanged rows: the failing checks that chance can trip


def loading_checks(view: LoadingView, settings: Campaign, limits: CampaignLimits) -> Iterator[Check]:
    """Every check: of the programme, channel by channel, of the surroundings, of signals."""
    share = settings.qa.false_alarm / _CHANCE_CHECKS
    yield from overruled(view, settings)
    yield steps_there(view, limits)
    yield runs_whole(view)
    yield pauses(view, limits)
    table = "interferometer" if view.channels else "signals"
    yield time_unit(view.steps.time_s, view.steps.run, table, "step", is_counted=view.is_counted)
    yield from load_range(view, settings.loading, limits)
    if view.channels:
        yield from _of_readings(view, settings, share, limits)
    else:
        yield without("readings", "completeness", "", "the campaign holds no readings of the platform's motion")
    turned: frozenset[int] = frozenset()
    if view.steps.signals:
        found = signal_answers(view)
        yield from signs(view, found, "signals", 0.5 * share)
        turned = frozenset(found.run[turned_round(found, 0.5 * share)].tolist())
    yield from signal_checks(view, settings, turned, share)


def _of_readings(view: LoadingView, settings: Campaign, share: float, limits: CampaignLimits) -> Iterator[Check]:
    yield from readings_there(view, limits)
    found = answers(view)
    yield from units(view, found)
    yield from signs(view, found, "readings", 0.5 * share)
    yield from exchanged_channels(view)
    yield from run_zeros(view)
    each = share / len(view.channels)
    for channel in view.channels:
        yield gross_errors(view, channel, limits)
        yield noise(channel, each)
        yield drift(view, channel, 10.0 * each)
        yield zero_return(view, channel, 10.0 * each)
        yield repeatability(view, channel, 10.0 * each)
    yield from jumps(view, 10.0 * share)
    reference = settings.mechanism.reference_temperature_c
    yield from surroundings_checks(view, settings.interferometer, reference, limits)
