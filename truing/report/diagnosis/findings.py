"""Sentences on the findings of the diagnosis: cause, place, size, certainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from truing.report.diagnosis.effect_units import plain_size, size_text
from truing.report.numbers import count_text, joined_names, p_at_most, plain, rough, two_decimals, with_uncertainty
from truing.schemas.verdict import Relation

DECLARED_NOISE, SCATTER_OF_REPEATS = "the declared noise", "the scatter of repeated approaches"
ESTIMATED_NOISE = "the noise as estimated from the signals (none is declared)"
_NOISIER = {
    DECLARED_NOISE: "the instrument is noisier than declared",
    SCATTER_OF_REPEATS: "repeats share errors",
    ESTIMATED_NOISE: "that estimate is too small",
}
UNNAMED = ", and no cause of the catalogue explains it better"
# Reasons why a cause is only suspected, by reason code.
DOUBTS = {
    "inadequate": "the model with all accepted causes leaves more than noise or fails a test: it may be incomplete",
    "unnamed": "the data also show an effect that no catalogued cause explains, and this may be a part of it",
    "alternative": "other causes, or an effect without a name, may explain the same",
    "assumed": "it assumes unknown centres of mass at the origins of their links; declare com_mm or payload_com_mm",
    "weak": "the evidence is weak: it is hardly more probable than no effect, and more measurements would decide",
    "held-out": "it predicts held-out data worse than the model without it",
    "unconfirmed": "left-out parts of the campaign (runs, days, regions) that should show it are predicted no better "
    "with it",
    "elsewhere": "it predicts left-out parts of the campaign (runs, days, regions) worse than the model without it",
    "course": "an effect without a name on the same parts explains the data as well, or acts next to it",
    "not-random": "these errors are not random: they repeat, depend on an input, or consist mostly of a few large ones",
    "unpaid": "it does not reduce the error of the simulation",
}
# Data that a cause needs for its test, by the reason code of an untested row.
NEEDS = {
    "no-temperature": "a temperature (temperature_c) that changes in the course of the campaign",
    "no-time": "the times of the measurements (time_s)",
    "no-approach": "the same positions, approached from both directions, in a known order (time_s)",
    "no-drives": "inputs that may deform the body: columns of configurations.csv named in [campaign] drives",
    "no-up": 'the direction of gravity ([measurement] up) in one frame ([bodies] reference, or frame = "campaign") in '
    "which bodies turn over",
    "no-still": "a body that should stand still ([bodies] still)",
    "few-poses": "12 poses or more, in a known order",
    "no-turns": "loads that are raised and lowered again, step by step",
    "no-payload": "six legs, what they carry (payload_kg), and which way is up ([measurement] up)",
    "no-weight": "the direction of gravity ([mechanism] gravity), and masses of links or a payload (payload_kg)",
    "no-gravity": "the direction of gravity ([mechanism] gravity)",
    "no-waits": "times since the last motion that differ between poses: time_s, or a column since_motion_s",
    "one-encoder": "the readings of both encoders, at the motor and at the load",
    "even-path": "a path that does not grow evenly with time: pauses, and long and short movements in turn",
    "no-tilt": "which way is up ([measurement] up), and poses that tilt the platform by 0.1 rad",
}
# Meaning of an empty subject next to one of this kind.
_ALL = {"leg": "all legs", "load": "all loads", "channel": "all linear channels"}
# Share of a cause above which nonparametric effects are not mentioned.
_ALL_OF_IT = 0.995
# Odds against another subject from which the subject is as sure as a name: 9 of 10.
_SURE_ODDS = 9.0
# Number of parameters that a sentence names before it counts the others.
_NAMED = 6
# Standard deviations below which none of many parameters counts as determined.
_DETERMINED = 2.0
_SEVERAL_TIMES = 1.5  # growth from which a factor reads better than a percentage
IN_TURN = "rows left out in turn"  # of an axis without rows of verification


@dataclass(frozen=True)
class Facts:
    """Content of the sentences on one candidate; errors of predictions are in ``unit``, fitted and held-out data in
    words.

    ``drive``: inputs of the predictions, in words. ``clause``: physical effect with its subject. ``parameters``,
    ``subject``, ``reason_code`` and ``rival`` as in the columns of these names. ``largest``: largest change of any
    measured quantity.
    """

    verdict: str
    clause: str
    parameters: Mapping[str, Mapping[str, object]]
    p_value: float
    candidates: int
    rms_before: float | None
    rms_after: float | None
    held_out: tuple[float | None, float | None]
    floor: float | None
    reason_code: str
    rival: str
    detectable: str  # detectable size in words; empty where none is known
    unnamed: bool  # whether no cause of the catalogue explains it
    remark: str  # limits of the statement; empty where there are none
    subject: str = ""
    share: float | None = None  # share of a cause in what it and nonparametric effects explain together
    odds: float | None = None  # indistinguishable: odds of the rival over this cause
    largest: float | None = None
    subjects: tuple[tuple[str, float], ...] = ()  # found: other possible subjects, with the odds against each
    inputs: tuple[tuple[str, float], ...] = ()  # other possible inputs in words, with the odds against each
    unit: str = "um"
    fitted_words: str = "the calibration poses"
    held_out_words: str = "held-out poses"
    drive: str = "the readings"
    course: tuple[str, ...] | None = None  # inputs that an unnamed effect on the same parts follows
    is_course_beside: bool = False  # it acts next to the cause; otherwise it is as probable in its place
    held_out_growth: float | None = None  # of all held-out errors with it, in units of their noise
    floor_has_scatter: bool = False  # ``floor`` holds scatter that was found next to the declared noise


def explanation(facts: Facts) -> str:
    """Return the explanation of one candidate cause."""
    of_verdict = {
        "found": _found_clause,
        "suspected": _suspected,
        "indistinguishable": _indistinguishable,
        "rejected": _rejected,
        "not testable": _hidden,
    }
    text = of_verdict[facts.verdict](facts)
    return " ".join(f"{text} {facts.remark}".split())


def detectable_words(parameter: str, size: float | None, unit: str) -> str:
    """Return a detectable size in words: ``gain_3 of 0.021 %``; empty where there is none."""
    return "" if size is None or size != size else f"{few(parameter)} of {plain_size(parameter, size, unit)}"


def combination_words(coefficients: Mapping[str, float]) -> str:
    """Return a combination with its largest coefficients: ``0.71 K12 - 0.52 K15 and 34 smaller``."""
    ordered = sorted(coefficients.items(), key=lambda item: -abs(item[1]))
    text = " ".join(f"{'-' if c < 0 else '+'} {abs(c):.2f} {name}" for name, c in ordered[:_NAMED]).removeprefix("+ ")
    more = len(ordered) - _NAMED
    return f"{text} and {more} smaller" if more > 0 else text


def few(parameters: str) -> str:
    """Return a cause's parameters by name, only the first ones where there are many."""
    names = parameters.split()
    more = len(names) > 2 * _NAMED
    return f"{' '.join(names[:_NAMED])} and {len(names) - _NAMED} more" if more else parameters


def subject_words(subject: str) -> str:
    """Return a subject in a sentence: ``legs 1 and 4`` of ``leg1 leg4``, ``joints a and b``, ``target P07``."""
    parts = subject.split()
    legs = [part.removeprefix("leg") for part in parts]
    if parts and all(part.startswith("leg") and part[3:].isdigit() for part in parts):
        return f"leg {legs[0]}" if len(legs) == 1 else f"legs {joined_names(legs)}"
    if len(parts) > 2 and set(parts[::2]) == {"joint"}:
        return f"joints {joined_names(parts[1::2])}"
    if len(parts) == 2 and parts[0] in ("joint", "link") and parts[1].lower().startswith(parts[0]):
        return parts[1]  # its name says what it is
    if parts[:1] == ["targets"]:
        return f"targets {joined_names(parts[1:])}"
    return subject


def _share(facts: Facts) -> str:
    """Return the share left to nonparametric effects, if it is worth a sentence."""
    if facts.share is None or facts.share >= _ALL_OF_IT:
        return ""
    return f" It explains {100.0 * facts.share:.0f} % of the effect; no catalogued cause explains the rest."


def _found_clause(facts: Facts) -> str:
    unnamed = UNNAMED if facts.unnamed else ""
    is_open = any(odds < _SURE_ODDS for _, odds in facts.subjects)
    certainty = "Most probably," if is_open else "The data show that"
    return (
        f"{certainty} {facts.clause}{unnamed}{_sizes(facts)}.{_largest_change(facts)}{_share(facts)} "
        f"{_improvement(facts)} Probability by chance: {p_at_most(facts.p_value)}, "
        f"corrected for {facts.candidates} tests.{_other_subjects(facts)}"
    )


def _other_subjects(facts: Facts) -> str:
    """Return the other possible subjects, or inputs, that the data leave open."""
    if facts.inputs:
        inputs = ", ".join(f"{words} ({max(odds, 1.0):.1f} to 1)" for words, odds in facts.inputs)
        return f" Other possible inputs, with the odds against each: {inputs}."
    if not facts.subjects:
        return ""
    all_subjects = next((words for kind, words in _ALL.items() if facts.subject.startswith(kind)), "the whole machine")
    texts = [
        f"{subject_words(subject) or all_subjects} ({max(odds, 1.0):.1f} to 1)" for subject, odds in facts.subjects
    ]
    return f" Other possible subjects, with the odds against each: {', '.join(texts)}."


def _suspected(facts: Facts) -> str:
    return (
        f"It may be that {facts.clause}{_sizes(facts)}.{_largest_change(facts)}{_share(facts)} "
        f"This is suspected, not confirmed: {_doubt(facts)}. {_improvement(facts)}{_other_subjects(facts)}"
    )


def doubt_text(reason_code: str, held_out_growth: float | None = None) -> str:
    """Return the reason why a cause is only suspected; ``held_out_growth``: factor of all held-out errors with it."""
    text = DOUBTS[reason_code]
    if reason_code != "held-out" or held_out_growth is None:
        return text
    growth = (
        f"by a factor of {held_out_growth:.2g}"
        if held_out_growth >= _SEVERAL_TIMES
        else f"by {100.0 * (held_out_growth - 1.0):.2g} %"
    )
    return f"{text}: all held-out errors together, each in units of its noise, grow {growth}"


def _doubt(facts: Facts) -> str:
    """Return the reason why a cause is only suspected."""
    if facts.course is None:
        return doubt_text(facts.reason_code, facts.held_out_growth)
    course = f"depends on {joined_names(facts.course)}" if facts.course else "wanders or jumps in time"
    alternative = "acts next to it" if facts.is_course_beside else "is about as probable in its place"
    return f"an effect without a name on the same parts that {course} {alternative}"


def _indistinguishable(facts: Facts) -> str:
    odds = f" (odds of {facts.odds:.2g} to 1 against this one)" if facts.odds is not None else ""
    as_well = "as well" if facts.odds is None or facts.odds <= 1.0 else "nearly as well"
    return (
        f"It may be that {facts.clause}{_sizes(facts)}. This explains the data {as_well} as {facts.rival}{odds}, "
        f"and this campaign cannot distinguish the two. {_improvement(facts)}"
    )


def _rejected(facts: Facts) -> str:
    if facts.reason_code == "held-out":
        return (
            f"The data do not confirm that {facts.clause}: this fits {facts.fitted_words}, but predicts "
            f"{facts.held_out_words} worse. "
            f"{_improvement(facts)}"
        )
    if facts.reason_code == "contained":
        sizes = _sizes(facts)
        sizes_alone = f"; alone{sizes}" if sizes else ""
        return f"The data show that {facts.clause}. This is part of an accepted cause and explains less{sizes_alone}."
    if facts.reason_code == "ended":
        return f"It is undecided whether {facts.clause}: the search ended without it (p = {facts.p_value:.2g})."
    shown = (
        f"The data do not show that {facts.clause} (p = {facts.p_value:.2g}, corrected for {facts.candidates} tests)"
    )
    if facts.detectable:
        return f"{shown}; {facts.detectable} would have been found with a probability of 80 %."
    return f"{shown}."


def _hidden(facts: Facts) -> str:
    """Return the explanation of a candidate that the campaign could not have shown."""
    text = f"These data cannot test whether {facts.clause}: they would not show it at any plausible size"
    return f"{text}, only from {facts.detectable} upwards." if facts.detectable else f"{text}."


def missing_explanation(cause: str, reason_code: str) -> str:
    """Return the explanation of a cause, as a noun, that was not tested for lack of data."""
    return f"Not tested: {cause}. A test needs {NEEDS[reason_code]}."


def _largest_change(facts: Facts) -> str:
    if facts.largest is None:
        return ""
    return f" It changes measured values by up to {plain(facts.largest)} {facts.unit}."


def _improvement(facts: Facts) -> str:
    if facts.rms_before is None or facts.rms_after is None:
        return ""
    unit = facts.unit
    sizes = f"{two_decimals(facts.rms_after)} {unit} with it and {two_decimals(facts.rms_before)} {unit} without"
    text = f"The rms error of predictions from {facts.drive} is {sizes}"
    before, after = facts.held_out
    if before is not None and after is not None:
        text += f" ({facts.held_out_words}: {two_decimals(after)} and {two_decimals(before)} {unit})"
    if facts.floor is None:
        return f"{text}."
    noise = "noise and the scatter found here give" if facts.floor_has_scatter else "noise alone gives"
    return f"{text}; {noise} {two_decimals(facts.floor)} {unit}."


def _sizes(facts: Facts) -> str:
    """Return the parameters after a colon, the most significant first where there are many.

    Coefficients of an unnamed effect have no meaning of their own.
    """
    if facts.unnamed:
        return ""
    ordered = list(facts.parameters.items())
    if len(ordered) > _NAMED and max(_significance(value) for _, value in ordered) < _DETERMINED:
        largest = max(ordered, key=lambda item: _significance(item[1]))
        return f": none of its {len(ordered)} parameters is determined alone, only combinations are ({_size(*largest)})"
    if len(ordered) > _NAMED:  # the clause names an onset, which has no size
        ordered = sorted((item for item in ordered if item[1].get("sigma")), key=lambda item: -_significance(item[1]))
    named = [_size(name, value) for name, value in ordered[:_NAMED]]
    more = len(ordered) - len(named)
    return f": {', '.join(named)}" + (f" and {more} smaller" if more else "") if named else ""


def _significance(value: Mapping[str, Any]) -> float:
    sigma = value.get("sigma")
    return abs(float(value["value"] or 0.0)) / float(sigma) if sigma else 0.0


def _size(name: str, value: Mapping[str, Any]) -> str:
    return f"{name} = {size_text(name, value['value'], value.get('sigma'), value.get('unit') or '')}"


_FINE_PATTERN = (
    " No pose was repeated: an error that repeats, with features finer than the distances between poses, would look "
    "the same."
)


def scatter_explanation(clause: str, p_value: float, doubt: str = "", *, is_repeated: bool = True) -> str:
    """Return the sentences on a cause without mean effect; ``doubt``: the reason code if it is only suspected;
    ``is_repeated``: whether a pose was measured again, so that what repeats would show."""
    text = f"It may be that {clause}" if doubt else f"The data show that {clause}"
    doubted = f" This is suspected, not confirmed: {DOUBTS[doubt]}." if doubt else ""
    return (
        f"{text} (p = {p_value:.1g}, corrected for all groups that were tried).{doubted} It causes no mean shift: "
        "these measurements have less weight in all other findings, and no model predicts the scatter."
        f"{'' if is_repeated else _FINE_PATTERN}"
    )


def single_errors_explanation(subject: str, number: int, ratio: float, p_value: float) -> str:
    """Return the sentences on single large errors of one input: their number, the largest over a typical one."""
    return (
        f"The errors of {subject} are mostly small, but large in {count_text(number, 'pose')}: up to {rough(ratio)} "
        f"times a typical one (p = {p_value:.1g} if they were normal). They depend on nothing that was recorded. "
        "No cause of the catalogue describes them, and no model predicts them."
    )


def single_errors_advice(subject: str) -> str:
    """Return the measurement that would explain single large errors of one input."""
    return f"Move {subject} to the same reading ten times, from both sides, and read its encoder at each stop."


@dataclass(frozen=True)
class NoiseFacts:
    """Noise that is larger than declared, or that differs between places; rms error and noise floor in ``unit``.

    ``ratio`` with ``sigma``: residuals over ``expected``, a noise in words. With ``inputs`` on which the noise depends,
    it is the largest noise over the smallest; with ``channel``, the noise of this channel over that of the others.
    """

    ratio: float
    sigma: float
    rms: float | None
    floor: float | None
    unit: str = "um"
    inputs: Sequence[str] = ()
    channel: str = ""
    expected: str = DECLARED_NOISE
    floor_has_scatter: bool = False  # as in `Facts`


def noise_explanation(facts: NoiseFacts) -> str:
    """Return the sentences on noise that is larger than declared, or that differs between places."""
    is_uniform = not (facts.channel or facts.inputs)
    missed = ""
    if facts.rms is not None and facts.floor is not None:
        by_noise = f"{facts.expected} gives" if is_uniform else "the noise as estimated here gives"
        if is_uniform and facts.floor_has_scatter:
            by_noise = f"{facts.expected} and the scatter found here give"
        missed = f" The rms error of predictions is {two_decimals(facts.rms)} {facts.unit}; "
        missed += f"{by_noise} {two_decimals(facts.floor)} {facts.unit}."
    size = with_uncertainty(facts.ratio, facts.sigma)
    weighted = "Noisier measurements had less weight in the search for causes."
    if facts.channel:
        return (
            f"The noise is not uniform: that of {facts.channel} is {size} times that of the others. {weighted}{missed}"
        )
    if facts.inputs:
        return (
            f"The noise is not uniform: it depends on {joined_names(facts.inputs)}. Where it is largest, it is {size} "
            f"times as large as where it is smallest. {weighted}{missed}"
        )
    noisier = _NOISIER[facts.expected]
    return (
        f"The residuals are {size} times {facts.expected}, which is more than the uncertainty of that noise "
        f"explains. Either {noisier}, or an effect outside the catalogue acts.{missed}"
    )


def expected_noise(relation: str, *, is_declared: bool = True) -> str:
    """Return the noise that a search compared residuals with, by the relation that it tested."""
    if relation == Relation.TARGETS_POSITIONS:
        return SCATTER_OF_REPEATS
    return DECLARED_NOISE if is_declared else ESTIMATED_NOISE
