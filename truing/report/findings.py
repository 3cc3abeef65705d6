"""How a finding of the diagnosis is said: one sentence of what, where, how large, how sure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from truing.report.numbers import with_uncertainty

# How many parameters a sentence names before it says how many more there are.
_NAMED = 6


@dataclass(frozen=True)
class Facts:
    """What a sentence is made of; lengths in um."""

    verdict: str
    says: str
    parameters: Mapping[str, Mapping[str, Any]]
    p_value: float
    candidates: int
    rms_before: float | None
    rms_after: float | None
    held_out: tuple[float | None, float | None]
    floor: float
    reason: str  # indistinguishable: from which cause; rejected: "held-out" or "contained"
    detectable: str  # size that would have been seen, in words; empty where none is known
    unnamed: bool  # whether no cause of the catalogue explains it
    remark: str  # what limits the statement; empty where nothing does


def explanation(facts: Facts) -> str:
    """Return what the diagnosis has to say of one candidate cause."""
    said = {"found": _found, "indistinguishable": _indistinguishable, "rejected": _rejected}[facts.verdict](facts)
    return f"{said} {facts.remark}".strip()


def _found(facts: Facts) -> str:
    unnamed = ", and no cause of the catalogue explains it" if facts.unnamed else ""
    return (
        f"The data show that {facts.says}{unnamed}: {_sizes(facts)}. {_improvement(facts)} "
        f"By chance this happens with a probability of at most {facts.p_value:.2g}, "
        f"all {facts.candidates} candidates counted."
    )


def _indistinguishable(facts: Facts) -> str:
    return (
        f"That {facts.says} would explain the data as well as {facts.reason} does, and this campaign cannot separate "
        f"the two: {_sizes(facts)}. {_improvement(facts)}"
    )


def _rejected(facts: Facts) -> str:
    if facts.reason == "held-out":
        return (
            f"That {facts.says} fits the calibration poses but predicts the held-out ones worse. {_improvement(facts)}"
        )
    if facts.reason == "contained":
        return f"That {facts.says} is part of what is accepted, which explains more; alone: {_sizes(facts)}."
    shown = (
        f"The data do not show that {facts.says} (p = {facts.p_value:.2g}, all {facts.candidates} candidates counted)"
    )
    if facts.detectable:
        return f"{shown}; {facts.detectable} would have been found with 80 % probability."
    return f"{shown}; this campaign could not have shown it at any plausible size."


def _improvement(facts: Facts) -> str:
    if facts.rms_before is None or facts.rms_after is None:
        return ""
    said = f"Predictions from the readings miss by {facts.rms_after:.2f} um rms with it, {facts.rms_before:.2f} without"
    before, after = facts.held_out
    if before is not None and after is not None:
        said += f" (held-out poses: {after:.2f} and {before:.2f} um)"
    return f"{said}; noise alone leaves {facts.floor:.2f} um."


def _sizes(facts: Facts) -> str:
    """Return the parameters, the most significant first where there are many."""
    ordered = list(facts.parameters.items())
    if len(ordered) > _NAMED:
        ordered.sort(key=lambda item: -_significance(item[1]))
    named = [_size(name, value) for name, value in ordered[:_NAMED]]
    more = len(ordered) - len(named)
    return ", ".join(named) + (f" and {more} smaller" if more else "")


def _significance(value: Mapping[str, Any]) -> float:
    sigma = value["sigma"]
    return abs(float(value["value"] or 0.0)) / float(sigma) if sigma else 0.0


def _size(name: str, value: Mapping[str, Any]) -> str:
    unit = "" if value["unit"] == "1" else str(value["unit"])
    return f"{name} = {with_uncertainty(float(value['value'] or 0.0), value['sigma'], unit)}"


def noise_explanation(ratio: float, sigma: float, rms: float | None, floor: float) -> str:
    """Return what is to be said of noise that is larger than declared; rms and floor in um."""
    missed = f" Predictions miss by {rms:.2f} um rms where it would leave {floor:.2f} um." if rms is not None else ""
    return (
        f"What is left is {with_uncertainty(ratio, sigma)} times as large as the declared noise, more than can be "
        f"put down to how well that is known: the instrument is noisier than declared, or something moves the points "
        f"that nothing in the catalogue explains.{missed}"
    )
