"""Readings and signals of a bench that a person left out or kept, by run, step and channel, and with a reason."""

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
class Decided:
    """Which readings and signals (B, 6 + S) a person decided on, and in which words (B, 6 + S)."""

    chosen: Mask
    words: NDArray[np.object_]

    @property
    def readings(self) -> Mask:
        """Which readings (B, 6)."""
        return self.chosen[:, : len(CHANNELS)]

    @property
    def signals(self) -> Mask:
        """Which signals (B, S)."""
        return self.chosen[:, len(CHANNELS) :]


def chosen_by(
    shape: tuple[int, ...], rules: Iterable[Overrule], verb: str, names: Callable[[Overrule], Mask]
) -> tuple[Mask, NDArray[np.object_]]:
    """What rules choose of an array of a shape, as ``names`` tells of each rule, and in which words.

    verb: excluded, or kept.
    """
    chosen, words = np.zeros(shape, bool), np.full(shape, "", dtype=object)
    for rule in rules:
        own = names(rule)
        chosen |= own
        words[own] = f"{verb} by {rule.signed}: {rule.reason}"
    return chosen, words


def exclusion_row(number: int, rule: Overrule, subject: str, change: Array, over: Array) -> dict[str, object]:
    """What is told of any [[exclude]], by number from 1, and a subject that it concerns.

    change, over (N,): what taking it back changes, in a unit and in sigmas; NaN where there is nothing to compare with.
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


def decided(steps: RecordedSteps, rules: Sequence[Overrule], verb: str) -> Decided:
    """What rules choose of the readings and signals that there are; verb: excluded, or kept."""
    there = np.isfinite(np.concatenate([steps.reading, steps.signal], 1))
    return Decided(*chosen_by(there.shape, rules, verb, lambda rule: matched(steps, rule) & there))


def matched(steps: RecordedSteps, rule: Overrule) -> Mask:
    """Which readings and signals (B, 6 + S) a rule names; an absent key stands for all, and poses have none."""
    channels = (*CHANNELS, *steps.signals)
    if any(key is not None for key in (rule.pose, rule.body, rule.target)):
        return np.zeros((len(steps.run), len(channels)), bool)
    runs = np.array([rule.run is None or str(rule.run) == str(run) for run in steps.runs], bool)
    of_step = (steps.step == rule.step) if rule.step is not None else np.ones(len(steps.run), bool)
    of_channel = np.array([rule.channel in (None, channel) for channel in channels], bool)
    return np.asarray((runs[steps.run] & of_step)[:, None] & of_channel)


def without_excluded(steps: RecordedSteps, settings: Campaign) -> tuple[RecordedSteps, Decided]:
    """The steps without what a person left out, and that; their loads were applied all the same."""
    out = decided(steps, settings.exclude, "excluded")
    reading = np.where(out.readings, np.nan, steps.reading)
    return replace(steps, reading=reading, signal=np.where(out.signals, np.nan, steps.signal)), out


def excluded_words(out: Decided) -> str:
    """How much a person left out; empty where nothing."""
    counts = {"reading": int(out.readings.sum()), "signal": int(out.signals.sum())}
    text = " and ".join(f"{n} {what}{'s' * (n > 1)}" for what, n in counts.items() if n)
    return f"{text} excluded by a person" if text else ""
