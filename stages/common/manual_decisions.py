"""Readings and signals of a bench that a person excluded or kept, by run, step and channel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.estimation.interferometry.recorded_steps import CHANNELS, RecordedSteps

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Overrule


@dataclass(frozen=True)
class ManualDecisions:
    """Masks and reasons (B, 6 + S) of the readings and signals that a person decided on."""

    chosen: Mask
    words: NDArray[np.object_]

    @property
    def readings(self) -> Mask:
        """Mask (B, 6) of readings."""
        return self.chosen[:, : len(CHANNELS)]

    @property
    def signals(self) -> Mask:
        """Mask (B, S) of signals."""
        return self.chosen[:, len(CHANNELS) :]


def chosen_by(
    shape: tuple[int, ...], rules: Iterable[Overrule], verb: str, names: Callable[[Overrule], Mask]
) -> tuple[Mask, NDArray[np.object_]]:
    """Mask and reasons of the entries of an array that rules match, by ``names`` of each rule.

    verb: excluded, or kept.
    """
    chosen, words = np.zeros(shape, bool), np.full(shape, "", dtype=object)
    for rule in rules:
        rule_names = names(rule)
        chosen |= rule_names
        words[rule_names] = f"{verb} by {rule.signed}: {rule.reason}"
    return chosen, words


def exclusion_row(number: int, rule: Overrule, subject: str, change: Array, over: Array) -> dict[str, object]:
    """Row on an [[exclude]], by number from 1, and one subject.

    change, over (N,): effect of its removal, in a unit and in sigmas; NaN if there is no comparison.
    """
    reported = np.isfinite(change)
    return {
        "entry": f"exclude {number}",
        "subject": subject,
        "by": rule.by,
        "decided_on": None if rule.on is None else str(rule.on),
        "reason": rule.reason,
        "largest_change": float(change[reported].max()) if reported.any() else None,
        "over_sigma": float(over[reported].max()) if reported.any() else None,
    }


def manual_decisions(steps: RecordedSteps, rules: Sequence[Overrule], verb: str) -> ManualDecisions:
    """Readings and signals that rules match; verb: excluded, or kept."""
    is_recorded = np.isfinite(np.concatenate([steps.reading, steps.signal], 1))
    return ManualDecisions(*chosen_by(is_recorded.shape, rules, verb, lambda rule: matched(steps, rule) & is_recorded))


def matched(steps: RecordedSteps, rule: Overrule) -> Mask:
    """Mask (B, 6 + S) of readings and signals that a rule matches; an absent key matches all, poses match none."""
    channels = (*CHANNELS, *steps.signals)
    if any(key is not None for key in (rule.pose, rule.body, rule.target)):
        return np.zeros((len(steps.run), len(channels)), bool)
    runs = np.array([rule.run is None or str(rule.run) == str(run) for run in steps.runs], bool)
    of_step = (steps.step == rule.step) if rule.step is not None else np.ones(len(steps.run), bool)
    of_channel = np.array([rule.channel in (None, channel) for channel in channels], bool)
    return np.asarray((runs[steps.run] & of_step)[:, None] & of_channel)


def without_excluded(steps: RecordedSteps, settings: Campaign) -> tuple[RecordedSteps, ManualDecisions]:
    """Steps without excluded readings, and the exclusions; the loads of these steps still count."""
    out = manual_decisions(steps, settings.exclude, "excluded")
    reading = np.where(out.readings, np.nan, steps.reading)
    return replace(steps, reading=reading, signal=np.where(out.signals, np.nan, steps.signal)), out


def excluded_words(out: ManualDecisions) -> str:
    """Number of excluded readings and signals in words; empty for none."""
    counts = {"reading": int(out.readings.sum()), "signal": int(out.signals.sum())}
    text = " and ".join(f"{n} {noun}{'s' * (n > 1)}" for noun, n in counts.items() if n)
    return f"{text} excluded by a person" if text else ""
