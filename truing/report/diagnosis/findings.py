"""How a finding of the diagnosis is said: one sentence of what, where, how large, how sure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from truing.report.diagnosis.effect_units import plain_size, size_text
from truing.report.numbers import plain, two_decimals, with_uncertainty

UNNAMED = ", and no cause of the catalogue explains it"
# Why a cause is suspected and not found, by its reason code.
DOUBTS = {
    "inadequate": "the model with everything that was accepted leaves more than noise, so the picture is incomplete",
    "unnamed": "something that no cause of the catalogue explains acts here as well, so this may be a part of that",
    "held-out": "it predicts what was held out worse than the model without it",
    "elsewhere": "parts of the campaign that were left out as a whole, predicted from the others, are less probable "
    "with it",
    "unpaid": "with it the simulation misses the measurement by no less",
}
# What a cause needs to be tested, by the reason code of a row that says it was not.
NEEDS = {
    "no-temperature": "a temperature (temperature_c) that changes in the course of the campaign",
    "no-time": "the times of the measurements (time_s)",
    "no-approach": "the same positions, approached from both directions, in a known order (time_s)",
    "no-drives": "what the body may follow: columns of configurations.csv that [campaign] drives names",
    "no-up": 'the direction of gravity ([measurement] up) in one frame ([bodies] reference, or frame = "campaign") in '
    "which bodies turn over",
    "no-still": "a body that should stand still ([bodies] still)",
    "few-poses": "12 poses or more, in a known order",
    "no-turns": "loads that are raised and lowered again, step by step",
    "no-payload": "six legs, what they carry (payload_kg), and which way is up ([measurement] up)",
    "no-tilt": "which way is up ([measurement] up), and a platform that tilts by a tenth of a radian",
}
# What an empty subject stands for, beside one of this kind.
_ALL = {"leg": "all legs", "load": "all loads", "channel": "all linear channels"}
# From this share on a name explains all that it competes for.
_ALL_OF_IT = 0.995
# How many parameters a sentence names before it says how many more there are.
_NAMED = 6


@dataclass(frozen=True)
class Facts:
    """What a sentence is made of; how far predictions miss in ``unit``, what was fitted and what was not in words.

    ``drive``: what predictions are made from, in words.

    ``clause``: what nature does, with its subject. ``parameters``, ``subject``, ``reason_code`` and ``rival`` as in the
    columns of these names. ``largest``: how far the effect moves anything that was measured, at most.
    """

    verdict: str
    clause: str
    parameters: Mapping[str, Mapping[str, Any]]
    p_value: float
    candidates: int
    rms_before: float | None
    rms_after: float | None
    held_out: tuple[float | None, float | None]
    floor: float
    reason_code: str
    rival: str
    detectable: str  # size that would have been seen, in words; empty where none is known
    unnamed: bool  # whether no cause of the catalogue explains it
    remark: str  # what limits the statement; empty where nothing does
    subject: str = ""
    share: float | None = None  # of a name in what it and effects without a name explain together
    odds: float | None = None  # indistinguishable: of the other over this one
    largest: float | None = None
    subjects: tuple[tuple[str, float], ...] = ()  # found: others that may be the subject, with the odds against each
    unit: str = "um"
    fitted_words: str = "the calibration poses"
    held_out_words: str = "held-out poses"
    drive: str = "the readings"


def explanation(facts: Facts) -> str:
    """Return what the diagnosis has to say of one candidate cause."""
    of_verdict = {
        "found": _found,
        "suspected": _suspected,
        "indistinguishable": _indistinguishable,
        "rejected": _rejected,
        "not testable": _hidden,
    }
    text = of_verdict[facts.verdict](facts)
    return " ".join(f"{text} {facts.remark}".split())


def detectable_words(parameter: str, size: float | None, unit: str) -> str:
    """Return a size that would have been seen, in words: ``gain_3 of 0.021 %``; empty where there is none."""
    return "" if size is None or size != size else f"{few(parameter)} of {plain_size(parameter, size, unit)}"


def few(parameters: str) -> str:
    """Return a cause's parameters by name, the first of them where a body has as many as its targets coordinates."""
    names = parameters.split()
    more = len(names) > 2 * _NAMED
    return f"{' '.join(names[:_NAMED])} and {len(names) - _NAMED} more" if more else parameters


def subject_words(subject: str) -> str:
    """Return a subject as a sentence names it: ``legs 1 and 4`` of ``leg1 leg4``, ``target P07``."""
    parts = subject.split()
    legs = [part.removeprefix("leg") for part in parts]
    if parts and all(part.startswith("leg") and part[3:].isdigit() for part in parts):
        return f"leg {legs[0]}" if len(legs) == 1 else f"legs {_and(legs)}"
    if parts[:1] == ["targets"]:
        return f"targets {_and(parts[1:])}"
    return subject


def _and(names: Sequence[str]) -> str:
    return names[-1] if len(names) < 2 else f"{', '.join(names[:-1])} and {names[-1]}"


def _share(facts: Facts) -> str:
    """What a name leaves to effects without a name, where that is worth a sentence."""
    if facts.share is None or facts.share >= _ALL_OF_IT:
        return ""
    return f" It explains {100.0 * facts.share:.0f} % of it; the rest follows no cause of the catalogue."


def _found(facts: Facts) -> str:
    unnamed = UNNAMED if facts.unnamed else ""
    return (
        f"The data show that {facts.clause}{unnamed}{_sizes(facts)}.{_reach(facts)}{_share(facts)} "
        f"{_improvement(facts)} By chance this happens with a probability of at most {facts.p_value:.2g}, "
        f"all {facts.candidates} candidates counted.{_elsewhere(facts)}"
    )


def _elsewhere(facts: Facts) -> str:
    """Return what else may be the subject, as far as the data leave it open."""
    if not facts.subjects:
        return ""
    whole = next((words for kind, words in _ALL.items() if facts.subject.startswith(kind)), "the whole")
    texts = [f"{subject_words(subject) or whole} ({max(odds, 1.0):.1f} to 1)" for subject, odds in facts.subjects]
    return f" That it concerns {' or '.join(texts)} instead is less probable by these odds only."


def _suspected(facts: Facts) -> str:
    return (
        f"It may be that {facts.clause}{_sizes(facts)}.{_reach(facts)}{_share(facts)} "
        f"This is suspected, and not found: {DOUBTS[facts.reason_code]}. {_improvement(facts)}{_elsewhere(facts)}"
    )


def _indistinguishable(facts: Facts) -> str:
    odds = f" (odds of {facts.odds:.2g} to 1 against this one)" if facts.odds is not None else ""
    return (
        f"It may be that {facts.clause}{_sizes(facts)}; that explains the data as well as {facts.rival} does{odds}, "
        f"and this campaign cannot separate the two. {_improvement(facts)}"
    )


def _rejected(facts: Facts) -> str:
    if facts.reason_code == "held-out":
        return (
            f"The data do not bear out that {facts.clause}; it fits {facts.fitted_words} but predicts "
            f"{facts.held_out_words} worse. "
            f"{_improvement(facts)}"
        )
    if facts.reason_code == "contained":
        sizes = _sizes(facts)
        alone = f"; alone{sizes}" if sizes else ""
        return f"The data show that {facts.clause}, which is part of what is accepted and explains less{alone}."
    if facts.reason_code == "ended":
        return f"Whether {facts.clause} was not decided: the search was ended before (p = {facts.p_value:.2g})."
    shown = (
        f"The data do not show that {facts.clause} (p = {facts.p_value:.2g}, all {facts.candidates} candidates counted)"
    )
    if facts.detectable:
        return f"{shown}; {facts.detectable} would have been found with 80 % probability."
    return f"{shown}."


def _hidden(facts: Facts) -> str:
    """A candidate that could not have been seen: no word on whether it is there."""
    text = f"Whether {facts.clause} is not testable here: this campaign would have shown it at no plausible size"
    return f"{text}, only from {facts.detectable} on." if facts.detectable else f"{text}."


def missing_explanation(cause: str, reason_code: str) -> str:
    """Return what is said of a cause, as a noun, that was not tested for want of something."""
    return f"Not tested: {cause}. A test needs {NEEDS[reason_code]}."


def _reach(facts: Facts) -> str:
    if facts.largest is None:
        return ""
    return f" It moves what was measured by up to {plain(facts.largest)} {facts.unit}."


def _improvement(facts: Facts) -> str:
    if facts.rms_before is None or facts.rms_after is None:
        return ""
    unit = facts.unit
    missed = f"miss by {two_decimals(facts.rms_after)} {unit} rms with it, {two_decimals(facts.rms_before)} without"
    text = f"Predictions from {facts.drive} {missed}"
    before, after = facts.held_out
    if before is not None and after is not None:
        text += f" ({facts.held_out_words}: {two_decimals(after)} and {two_decimals(before)} {unit})"
    return f"{text}; noise alone leaves {two_decimals(facts.floor)} {unit}."


def _sizes(facts: Facts) -> str:
    """Return the parameters behind a colon, the most significant first where there are many."""
    ordered = list(facts.parameters.items())
    if len(ordered) > _NAMED:
        ordered.sort(key=lambda item: -_significance(item[1]))
    named = [_size(name, value) for name, value in ordered[:_NAMED]]
    more = len(ordered) - len(named)
    return f": {', '.join(named)}" + (f" and {more} smaller" if more else "") if named else ""


def _significance(value: Mapping[str, Any]) -> float:
    sigma = value.get("sigma")
    return abs(float(value["value"] or 0.0)) / float(sigma) if sigma else 0.0


def _size(name: str, value: Mapping[str, Any]) -> str:
    return f"{name} = {size_text(name, value['value'], value.get('sigma'), value.get('unit') or '')}"


def scatter_explanation(clause: str, p_value: float, doubt: str = "") -> str:
    """The sentences on a cause that moves nothing on average; ``doubt``: the reason code where it is only suspected."""
    text = f"It may be that {clause}" if doubt else f"The data show that {clause}"
    doubted = f" This is suspected, and not found: {DOUBTS[doubt]}." if doubt else ""
    return (
        f"{text} (p = {p_value:.1g}, corrected for all groups that were tried).{doubted} It moves nothing "
        "on average: what was measured there counts the less in all other findings, and no model predicts it."
    )


def noise_explanation(
    ratio: float, sigma: float, rms: float | None, floor: float, follows: Sequence[str] = (), unit: str = "um"
) -> str:
    """Return what is to be said of noise that is larger than declared, or in places; rms and floor in a unit."""
    left = f"where it would leave {two_decimals(floor)} {unit}."
    missed = f" Predictions miss by {two_decimals(rms)} {unit} rms {left}" if rms is not None else ""
    size = with_uncertainty(ratio, sigma)
    if follows:
        return (
            f"The noise is not the same everywhere: it follows {_and(follows)}, and is up to {size} times as large as "
            f"the declared noise. What was measured there counts the less, before any effect was looked for.{missed}"
        )
    return (
        f"What is left is {size} times as large as the declared noise, more than can be "
        f"put down to how well that is known: the instrument is noisier than declared, or something moves what "
        f"was measured that nothing in the catalogue explains.{missed}"
    )
