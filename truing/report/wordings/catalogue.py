"""Wordings of all causes by id, and clauses of claims."""

from __future__ import annotations

import re
from dataclasses import replace

from truing.report.diagnosis.findings import subject_words
from truing.report.wordings.bench_wordings import BENCH
from truing.report.wordings.chain_wordings import CHAIN
from truing.report.wordings.claim import (
    Advice,
    AdviceKind,
    Claim,
    Wording,
    by_words,
    largest,
    largest_of_kind,
    positive,
    size_in_words,
    with_sizes,
)
from truing.report.wordings.mechanism_wordings import BODIES, MECHANISM
from truing.report.wordings.nonparametric_wordings import FOLLOWED, PARTS_OF_AXES

_STIR = "Measure the air temperature at three heights; mix the air with a fan and repeat some poses."
_FORMS = {
    "temperature": ("depends on the temperature", "depend on the temperature"),
    "scatter": ("scatters from pose to pose", "scatter from pose to pose"),
    "drift": ("drifts linearly with time", "drift linearly with time"),
    "settles": ("drifts with time, at a decreasing rate", "drift with time, at a decreasing rate"),
}


def _scale(claim: Claim) -> str:
    size, large = largest_of_kind(claim, "scale")
    verb = "travels" if claim.subject == "axis" else "reads"
    if not size:
        return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} {verb} with a scale error"
    return (
        f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} {verb} too {'far' if large else 'little'}{by_words(size)}"
    )


_LEADS = "as if lost motion were compensated too much, or deviations had the opposite sign"


def _lost_motion_clause(claim: Claim) -> str:
    half, lost = largest(claim.sizes_of("backlash")), "motion is lost between motor and load"
    leads = "after each reversal the load leads the motor"
    if half is None or half.number is None:
        return f"{leads}, {_LEADS}" if claim.is_negative else lost
    full_width = replace(half, value=2.0 * abs(half.number), sigma=None if half.sigma is None else 2.0 * half.sigma)
    sizes = f"{size_in_words(positive(half))} to either side, {size_in_words(full_width)} between both"
    if half.number < 0.0:
        return f"{leads}, by {sizes}, {_LEADS}"
    return f"{lost}, by {sizes}"


def _shift(claim: Claim) -> str:
    shift = largest(claim.sizes_of("shift"))
    size = "" if shift is None else size_in_words(shift)
    event = claim.fact("event")
    since = f" after the event {event}" if event else claim.since("row")
    return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} has a zero shift{since}{by_words(size)}"


def _periodic(claim: Claim) -> str:
    size, _ = largest_of_kind(claim, "amplitude")
    size = f" of amplitude {size}" if size else ""
    period = claim.size("period")
    over = f", with a period of {size_in_words(period)}" if period is not None else ""
    if claim.fact("aliased"):
        over = ", with a period that these commands do not determine"
    return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} has a periodic error{size}{over}"


def _growth(claim: Claim) -> str:
    size, grows = largest_of_kind(claim, "growth")
    verb = "grows" if grows else "shrinks"
    who = PARTS_OF_AXES.get(claim.subject, claim.subject)
    mean = claim.fact("reference_c")
    since = "" if mean is None else f", counted from the mean temperature of {mean:.1f} °C"
    return f"{who} {verb} with temperature, in proportion to the position{by_words(size)}{since}"


_RIGHT = {
    "axis": "the outside instrument follows the encoder at the load: the drive slips, or the encoder at the motor is "
    "wrong",
    "encoder load": "the outside instrument follows the encoder at the motor: the encoder at the load is wrong",
}


def _slip(claim: Claim) -> str:
    size, _ = largest_of_kind(claim, "slip")
    parted = f"the encoders at motor and load drift apart in proportion to the path travelled{by_words(size)}"
    if not claim.fact("is_witnessed"):
        return f"{parted}; no outside instrument shows which of the two is right"
    return f"{parted}; {_RIGHT[claim.subject]}"


def _repeat_event_advice(claim: Claim) -> str:
    event = claim.fact("event")
    again = f"Repeat the event ({event})" if event else "Switch the axis off and on, and reference it again"
    return f"{again}, with the same commands measured before and after."


_AXIS = {
    "scale-error": Wording(
        "scale error",
        _scale,
        "Measure the same commands with another instrument of known length or angle, over the whole travel.",
    ),
    "lost-motion": Wording(
        "lost motion",
        _lost_motion_clause,
        "Approach each command from both sides, by movements of several lengths, all longer than the lost motion.",
    ),
    "periodic-error": Wording(
        "periodic error",
        _periodic,
        "Move the axis through two periods or more, in steps of at most a tenth of one, and read every encoder.",
    ),
    "zero-shift": Wording("zero shift", _shift, _repeat_event_advice),
    "axis-growth": Wording(
        "growth with temperature",
        _growth,
        "Repeat the same commands over the whole travel at two temperatures, each after it has settled.",
    ),
    "encoders-disagree": Wording(
        "disagreement of the encoders",
        _slip,
        "Read both encoders and an outside instrument at one command, before and after ten movements over the whole "
        "travel.",
    ),
}


def _unstable(claim: Claim) -> str:
    elements = set(claim.fact("what") or ("c",))
    parts = ["principal distance"] * ("c" in elements) + ["principal point"] * bool(elements - {"c"})
    several = len(parts) > 1
    jumps = f"{'change' if several else 'changes'} at pose {claim.fact('from_pose')}"
    verb, verb_of_several = _FORMS.get(str(claim.fact("form")), (jumps, jumps))
    return with_sizes(f"the {' and the '.join(parts)} of {claim.subject} {verb_of_several if several else verb}", claim)


def _camera_test_advice(claim: Claim) -> str:
    return (
        f"Photograph a fixed field of targets with {claim.subject} before and after the suspected change, rolled by "
        "90 degrees in every second image, and determine its interior orientation each time."
    )


def _refraction_clause(claim: Claim) -> str:
    if claim.subject:
        pane = "looks through a pane of glass, which shifts oblique rays"
        return with_sizes(f"{claim.subject} {pane}", claim)
    if claim.fact("scale_height_m") is not None:
        bent = "measured shapes are bent as by a linear change of the refractive index of air with height"
        return with_sizes(f"{bent}, which residuals of rays do not show", claim)
    return with_sizes("rays are bent: the refractive index of the air changes nonlinearly with height", claim)


def _without_pane(claim: Claim) -> str:
    if not claim.subject:
        return _STIR
    return f"Repeat some poses without the pane before the lens of {claim.subject}, at two distances."


def _warm_bars(claim: Claim) -> str:
    if claim.fact("bar"):
        clause = f"scale bar {claim.fact('bar')} has a thermal expansion other than stated"
        return with_sizes(f"{clause}, compared with the other bars", claim)
    all_bars = "the scale bars have a thermal expansion other than stated"
    return with_sizes(f"{all_bars}, so that all measured lengths change by the same ratio", claim)


def _calibrate_bars(claim: Claim) -> str:
    if claim.fact("bar"):
        bars_text, them = f"bar {claim.fact('bar')}", "it"
    else:
        bars_text, them = "the bars", "one"
    return (
        f"Calibrate {bars_text} at two temperatures, or photograph {them} together with a bar of known "
        "expansion at both."
    )


RAYS = {
    "camera-instability": Wording("camera instability", _unstable, _camera_test_advice),
    "refraction": Wording("refraction", _refraction_clause, _without_pane),
    "scale-bar-temperature": Wording("scale bar temperature", _warm_bars, _calibrate_bars),
}

WORDINGS: dict[str, Wording] = {**MECHANISM, **BODIES, **BENCH, **_AXIS, **CHAIN, **RAYS, **FOLLOWED}


def cause_words(cause: str) -> str:
    """Return a cause as a noun, ``actuator gain``; a cause from a package by its id."""
    return WORDINGS[cause].noun if cause in WORDINGS else cause.replace("-", " ")


def cause_of_subject(cause: str, subject: str) -> str:
    """Return a cause with its subject, no word twice: ``compliance of joint elbow``, ``creep (load fz)``."""
    return noun_of_subject(cause_words(cause), subject)


def noun_of_subject(noun: str, subject: str) -> str:
    """Return a noun with its subject: ``creep (load fz)``; ``compliance of joint elbow`` if the noun names its kind."""
    subject_text = subject_words(subject)
    kind = subject_text.split()[0].removesuffix("s") if subject_text else ""
    if match := re.fullmatch(rf"(.+) of (?:an? |the )?{re.escape(kind)}s?", noun) if kind else None:
        return f"{match[1]} of {subject_text}"
    head, _, tail = noun.partition(" ")
    if head == kind and tail in _OF_KINDS:
        return f"{tail} of {subject_text}"
    return f"{noun} ({subject_text})" if subject_text else noun


def parameter_of_cause(parameter: str, cause: str, subject: str) -> str:
    """Return a parameter with its cause and subject: ``amplitude (periodic error, axis)``, ``drift of leg 3``."""
    cause_name = cause_of_subject(cause, subject)
    if set(parameter.split()) <= set(cause_words(cause).split()):
        return cause_name
    inner = cause_name.removesuffix(")").replace(" (", ", ")  # no brackets within brackets
    return f"{parameter} ({inner})"


# Quantities in nouns such as "joint gain" and "leg drift".
_OF_KINDS = frozenset({"backlash", "clearance", "deformation", "drift", "gain", "offset", "stiffness"})


def clause(claim: Claim) -> str:
    """Return the clause on a claim that completes "The data show that ..."; causes from packages bring
    their own words."""
    if claim.cause in WORDINGS:
        return WORDINGS[claim.cause].clause(claim)
    return with_sizes(claim.words or cause_words(claim.cause), claim)


def own_clause(clause: str, subject: str) -> str:
    """Return the clause that a cause from a package brings, with its subject."""
    return f"{clause} ({subject_words(subject)})" if subject else clause


def confirming(claim: Claim, otherwise: str = "") -> Advice:
    """Return the measurement that confirms a cause; ``otherwise``: that of a cause from a package."""
    text = WORDINGS[claim.cause].advice if claim.cause in WORDINGS else otherwise
    return Advice(AdviceKind.CONFIRM, text if isinstance(text, str) else text(claim))


# Causes whose clause needs a subject or a column, or is about one of several kinds of subject.
_MEANINGS = {
    "base-deformation": "the base deforms with a recorded column, such as a temperature",
    "actuator-zero-shift": "the zero of an actuator shifts from some pose on",
    "leg-compliance": "the legs deflect under the weight that they carry",
    "thermal-expansion": "one or several bodies grow with temperature",
    "noise-burst": "the data scatter more for some time than in the rest of the campaign",
    "body-deformation": "a body deforms with a recorded column",
    "body-jump": "all targets of a platform or base are displaced together against its joints from some pose on",
    "body-drift": "the shape of a body drifts with time",
    "leg-stiffness": "the stiffness of a leg differs from the simulated one",
    "thermal-drift": "one linear channel, or all, depend on the temperature",
    "abbe-offset": "the beam of one linear channel, or of all, passes off the origin, so it measures rotation too",
    "dead-path": "one linear channel, or all, have a dead path without compensation for the air",
    "scale-error": "an axis or one of its encoders has a scale error",
    "periodic-error": "an axis or one of its encoders has a periodic error",
    "zero-shift": "an axis or one of its encoders has a zero shift",
    "axis-growth": "an axis, an encoder or the instrument grows with temperature, in proportion to the position",
    "link-bending": "a link bends under the weight that it carries",
    "link-growth": "one link, or all, grow with temperature",
    "base-drift": "the base moves steadily relative to the instrument, from the first to the last pose",
    "joint-jump": "the zero of a joint shifts from some pose on",
    "base-jump": "the base is displaced from some pose on",
    "tool-jump": "a tool is displaced on its flange from some pose on, with all that is measured on it",
    "joints-exchanged": "the readings of two joints are in each other's column",
    "camera-instability": "the principal distance of a camera changes at some pose",
    "unexplained": "the data depend on recorded columns in a form that no named cause has",
}


def cause_meaning(cause: str) -> str:
    """Return one sentence on a cause in general, without subject and size; empty for a cause from a package."""
    if cause not in WORDINGS:
        return ""
    subject = "a joint" if cause in CHAIN else ""
    words = _MEANINGS.get(cause) or clause(Claim(cause=cause, subject=subject))
    return f"{words[:1].upper()}{words[1:]}."
