"""Wordings of causes in mechanisms: legs, actuators, platform, base, other bodies and their targets."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from truing.report.diagnosis.effect_units import size_text
from truing.report.diagnosis.findings import subject_words
from truing.report.numbers import joined_names, rough, with_uncertainty
from truing.report.wordings.claim import (
    Claim,
    Wording,
    by_most,
    by_words,
    largest,
    largest_of_kind,
    listed,
    positive,
    size_in_words,
    with_sizes,
)
from truing.report.wordings.nonparametric_wordings import PARTS_OF_AXES, columns_words, product_words
from truing.schemas.covariates import own_name

# Least shift, over the sigma from uncorrelated parameters, for which that sigma is given.
_TELLING = 2.0
_ATTACHMENTS = "Move one actuator at a time through its range and measure the targets at all attachments."
_TWO_TEMPERATURES = "at two temperatures, as far apart as the room allows."

_CAME_FROM, _TIMES, _TEMPERATURE = "approach ", "*", "temperature_c"


def _actuators(claim: Claim) -> str:
    """Return ``actuator 3`` or ``actuators 1 and 4`` or ``the actuators``."""
    return subject_words(claim.subject).replace("leg", "actuator", 1) or "the actuators"


def _legs(claim: Claim) -> str:
    return subject_words(claim.subject) or "the legs"


def _verb(claim: Claim, singular: str, plural: str) -> str:
    return singular if re.fullmatch(r"leg\d+", claim.subject) else plural


def _up_to(claim: Claim) -> str:
    reach = claim.reach
    if reach is None:
        return ""
    # Strongly correlated parameters, treated as uncorrelated, would give far too large a sigma of the shift.
    known = reach.sigma is not None and 0.0 < reach.sigma < reach.largest / _TELLING
    far = with_uncertainty(reach.largest, reach.sigma, "um") if known else f"{rough(reach.largest)} um"
    return f", by up to {far}"


def _late(claim: Claim) -> str:
    size, late = largest_of_kind(claim, "lag")
    word, element = "late" if late else "early", claim.fact("element")
    if element is None:
        return f"the readings are {word} against the measured poses{by_words(size)}"
    if element:
        return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} is {word} against the commands{by_words(size)}"
    follows = ", or the axis follows them late" if late else ""
    return f"the readings are {word} against the commands{follows}{by_words(size)}"


def _deforms(claim: Claim) -> str:
    """Return the clause that the platform follows each leg's own actuator."""
    subject_text = subject_words(claim.subject)
    preposition = " nonlinearly with" if claim.cause == "platform-deformation-nonlinear" else " with"
    along = "" if claim.sizes else " along its z"
    if subject_text:
        verb = _verb(claim, "its own actuator", "their own actuators")
        return f"the platform deforms{along} at {subject_text}{preposition} {verb}{_up_to(claim)}"
    most = f", most at leg {claim.reach.legs[0]}" if claim.reach is not None else ""
    return f"the platform deforms{along} at each leg{preposition} that leg's actuator{most}{_up_to(claim)}"


def _deforms_with_all(claim: Claim) -> str:
    most = ""
    if claim.reach is not None:
        most = f", most between legs {claim.reach.legs[0]} and {claim.reach.legs[1]}"
    if not claim.sizes:
        return "the platform deforms along its z with all actuators"
    return f"the platform deforms with the actuators{most}{_up_to(claim)}"


def _in_plane(claim: Claim) -> str:
    """Return the clause that attachments shift across the platform's z with their own actuators."""
    subject, verb = subject_words(claim.subject), _verb(claim, "its own actuator", "their own actuators")
    text = (
        f"the platform deforms in its plane at {subject or 'each leg'} with {verb if subject else 'its own actuator'}"
    )
    size = largest((*claim.sizes_of("kappa_x"), *claim.sizes_of("kappa_y")))
    if size is None:
        return text
    _, axis, leg = size.name.split("_")
    return f"{text}, most at leg {leg} along the platform's {axis} ({size_in_words(size)})"


def _driver(claim: Claim) -> str:
    driver = str(claim.fact("driver") or "a drive")
    return columns_words((f"{driver}_mm",)) if driver.startswith("rho") else f"the {driver}"


def _base(claim: Claim) -> str:
    sizes = ", ".join(f"{s.name.replace('_', ' ')} {size_in_words(s)}" for s in claim.sizes if s.number is not None)
    return f"the base deforms with {_driver(claim)}{': ' if sizes else ''}{sizes}"


def _single_drive_advice(claim: Claim) -> str:
    if claim.fact("driver") == "temperature":
        return f"Measure the base alone {_TWO_TEMPERATURES}"
    return f"Move {_driver(claim)} alone through its range and measure the base."


def _gain(claim: Claim) -> str:
    size, further = largest_of_kind(claim, "gain")
    if size and _verb(claim, "one", ""):
        return f"{_actuators(claim)} moves {'farther' if further else 'less'} than it reads, by {size}"
    does = _verb(claim, "has a gain error", "have gain errors")
    return f"{_actuators(claim)} {does}{by_most(claim, 'gain')}"


def _zero_shift(claim: Claim) -> str:
    size, is_positive = largest_of_kind(claim, "shift")
    since = claim.since()
    if not _verb(claim, "one", ""):
        return f"the zeros of {_actuators(claim)} shift{since}{by_most(claim, 'shift')}"
    by = f": position = reading {'+' if is_positive else '−'} {size}" if size else ""
    return f"the zero of {_actuators(claim)} shifts{since}{by}"


def _backlash(claim: Claim) -> str:
    sizes = claim.sizes_of("backlash")
    leads = claim.is_negative or (bool(sizes) and all((size.number or 0.0) < 0.0 for size in sizes))
    size = by_most(replace(claim, sizes=tuple(map(positive, sizes))) if leads else claim, "backlash")
    sides = " to either side" if size else ""
    if leads:
        verb, reason = (
            _verb(claim, "leads its reading", "lead their readings"),
            "as if backlash were compensated too much",
        )
        return f"{_actuators(claim)} {verb} after each reversal{size}{sides}, {reason}"
    return f"{_actuators(claim)} {_verb(claim, 'has', 'have')} backlash{size}{sides}"


def _periodic(claim: Claim) -> str:
    pitch = largest(claim.sizes_of("pitch"))
    over = f", with a pitch of {size_in_words(pitch)}" if pitch is not None else ""
    has = _verb(claim, "has a periodic error", "have periodic errors")
    return f"{_actuators(claim)} {has}{by_most(claim, 'amplitude')}{over}"


def _drift(claim: Claim) -> str:
    size, grows = largest_of_kind(claim, "drift")
    if size and _verb(claim, "one", ""):
        return f"{_legs(claim)} {'grows' if grows else 'shrinks'} by {size} over the campaign"
    return f"the length of {_legs(claim)} drifts over the campaign{by_most(claim, 'drift')}"


def _warm_legs(claim: Claim) -> str:
    sizes = claim.sizes_of("alpha")
    shrinks = bool(sizes) and all((size.number or 0.0) < 0.0 for size in sizes)
    verb = _verb(claim, "shrinks", "shrink") if shrinks else _verb(claim, "grows", "grow")
    size = by_most(replace(claim, sizes=tuple(map(positive, sizes))) if shrinks else claim, "alpha")
    return f"{_legs(claim)} {verb} with temperature, but the bodies do not{size}"


def _leg_deflection(claim: Claim) -> str:
    if not claim.subject:
        return f"all legs deflect equally under the weight that they carry{by_most(claim, 'compliance')}"
    deflect = _verb(claim, "deflects", "deflect")
    return f"{_legs(claim)} {deflect} under the weight on the legs, but the others do not{by_most(claim, 'compliance')}"


def _flexures(claim: Claim) -> str:
    size = largest(claim.sizes_of("flexure_length"))
    long = f" (flexure length by beam theory: {size_in_words(size)})" if size is not None else ""
    return f"bending of the flexures shifts the joints{long}"


def _scale(claim: Claim) -> str:
    per_k = claim.size("scale_per_k")
    if per_k is not None or claim.fact("form") not in (None, "constant"):
        return f"measured lengths change with temperature{by_words(size_in_words(per_k)) if per_k is not None else ''}"
    size, large = largest_of_kind(claim, "scale")
    if not size:
        return "measured lengths have a scale error"
    return f"measured lengths are too {'large' if large else 'small'}, by {size}"


def _heat(claim: Claim) -> str:
    sizes = {size.name.removeprefix("alpha").lstrip("_"): size_in_words(size) for size in claim.sizes}
    who = "base, platform and legs grow"
    if claim.fact("form") == "bodies":
        who = f"body {claim.subject} grows" if claim.subject else "all bodies grow equally"
    if len(sizes) == 1:
        return f"{who} with temperature, by {next(iter(sizes.values()))}"
    how = ", each by a different amount" if claim.fact("form") == "apart" else ""
    if not sizes:
        return f"{who} with temperature{how}"
    return f"bodies grow with temperature: {', '.join(f'{part} {size}' for part, size in sizes.items())}"


def _approach_scatter_clause(claim: Claim) -> str:
    """Return the clause on actuators whose position scatters from pose to pose: subject, poses and size."""
    who = f"body {claim.fact('body')}" if claim.fact("body") else _actuators(claim)
    if claim.fact("joint") is not None:
        who = claim.subject or "all joints"
    how = "from pose to pose"
    if claim.fact("element") is not None:
        how = "at each approach"
        who = "the load behind the motor" if claim.subject else "the axis about its command"
    approach_text = {1: " when approached from below", -1: " when approached from above"}.get(
        claim.fact("direction") or 0, ""
    )
    poses = [claim.fact(name) for name in ("from_pose", "to_pose")]
    when = "" if poses[0] in (None, "") else f" from pose {poses[0]} to pose {poses[1]}"
    size, _ = largest_of_kind(claim, "scatter")
    far = by_words(f"{size} (standard deviation)") if size else ""
    return f"the position of {who} scatters {how}{approach_text}{when}{far}"


MECHANISM = {
    "approach-scatter": Wording(
        "scatter of approach",
        _approach_scatter_clause,
        "Approach one of these poses ten times, and one of the others, and compare their scatter.",
    ),
    "platform-deformation-linear": Wording("platform deformation linear", _deforms, _ATTACHMENTS),
    "platform-deformation-matrix": Wording("platform deformation matrix", _deforms_with_all, _ATTACHMENTS),
    "platform-deformation-nonlinear": Wording(
        "platform deformation nonlinear",
        _deforms,
        "Move one actuator at a time, in at least five steps, and measure the targets at all attachments.",
    ),
    "in-plane-deformation": Wording("in-plane deformation of the platform", _in_plane, _ATTACHMENTS),
    "base-deformation": Wording("base deformation", _base, _single_drive_advice),
    "actuator-gain": Wording(
        "actuator gain",
        _gain,
        "Move one actuator at a time through its range and measure its carriage, not the platform.",
    ),
    "actuator-backlash": Wording(
        "actuator backlash",
        _backlash,
        "Approach the same poses from below and from above, by movements much longer than the backlash.",
    ),
    "actuator-periodic-error": Wording(
        "actuator periodic error",
        _periodic,
        "Move one actuator in steps of a tenth of the pitch through two turns and measure its carriage.",
    ),
    "reading-lag": Wording(
        "lag of readings",
        _late,
        "Repeat the same path at half the speed, or measure at standstill: only an error by a lag gets smaller.",
    ),
    "actuator-zero-shift": Wording(
        "shift of an actuator's zero",
        _zero_shift,
        "Move the actuator to its reference mark and compare the mark with its reading; check its coupling, and its "
        "encoder for lost counts.",
    ),
    "leg-drift": Wording(
        "leg drift",
        _drift,
        "Return to one pose every 15 minutes, for as long as the campaign took.",
    ),
    "leg-thermal": Wording(
        "leg thermal", _warm_legs, "Repeat some poses at two temperatures and measure targets along the legs."
    ),
    "leg-compliance": Wording(
        "compliance of legs",
        _leg_deflection,
        "Measure a few poses without and with a known mass on the platform.",
    ),
    "flexure-shift": Wording(
        "flexure shift", _flexures, "Measure poses with the largest tilts of the platform, in all directions."
    ),
    "measurement-scale": Wording(
        "measurement scale",
        _scale,
        "Measure a second scale bar of known length and known expansion in a few poses.",
    ),
    "thermal-expansion": Wording("thermal expansion", _heat, f"Repeat some poses {_TWO_TEMPERATURES}"),
}


def _on_body(claim: Claim) -> str:
    return f" on {claim.fact('body')}" if claim.fact("body") else ""


def _displacement_clause(claim: Claim) -> str:
    who = f"{claim.subject or 'a target'}{_on_body(claim)}"
    parts = [size for name in ("dx", "dy", "dz") if (size := claim.size(name)) is not None]
    if not parts:
        return f"{who} is displaced{claim.since()}"
    distance = math.hypot(*(size.number or 0.0 for size in parts))
    sigma = max(size.sigma or 0.0 for size in parts)
    return f"{who} is displaced by {size_text('dx', distance, sigma or None, parts[0].unit)}{claim.since()}"


def _check_target_advice(claim: Claim) -> str:
    body = claim.fact("body")
    return f"Check whether {claim.subject} on {body} is loose or was touched, and survey {body} again."


def _swapped(claim: Claim) -> str:
    poses = claim.fact("poses") or ()
    names = poses.split() if isinstance(poses, str) else poses
    poses_text = f" in poses {', '.join(map(str, names))}" if names else ""
    return f"{subject_words(claim.subject) or 'two targets'}{_on_body(claim)} have exchanged labels{poses_text}"


def _check_images_advice(claim: Claim) -> str:
    return f"Check in the images of these poses which of {listed(claim.fact('targets') or ('the targets',))} is which."


def _body(claim: Claim) -> str:
    return f"body {claim.subject}"


def _body_deforms(claim: Claim) -> str:
    terms, fact = claim.fact("terms") or (), claim.fact("whole")
    if not terms:
        return with_sizes(f"{_body(claim)} deforms", claim)
    if terms[0].startswith(_CAME_FROM):
        column = own_name(terms[0].removeprefix(_CAME_FROM))
        quantity = "position" if fact else "shape"
        text = f"the {quantity} of {_body(claim)} depends on whether {column} went up or down before (hysteresis)"
    elif fact:
        text = f"{_body(claim)}, declared stationary, moves as a whole with {_terms(claim)}"
    else:
        or_time = ", or with time, which changed together with it" if claim.fact("with_time") else ""
        text = f"{_body(claim)} deforms with {_terms(claim)}{or_time}"
    return with_sizes(text, claim)


def _terms(claim: Claim) -> str:
    """Return the terms of a body's deformation: columns, their squares and products, place of another body."""
    terms = claim.fact("terms")
    columns = list(dict.fromkeys(column for term in terms for column in term.split(_TIMES)))
    placed = columns[0].removesuffix(" x")
    if columns == [f"{placed} {axis}" for axis in "xyz"]:
        return f"the position of body {placed}"
    names = ["the temperature" if column == _TEMPERATURE else own_name(column) for column in columns]
    if len(terms) == 1:
        return product_words(names * (2 if _TIMES in terms[0] and len(names) == 1 else 1))
    text = joined_names(names)
    return f"{text}, nonlinearly" if len(terms) > len(names) else text


def _single_change_advice(claim: Claim) -> str:
    column = own_name((claim.fact("columns") or ("the input",))[0].removeprefix(_CAME_FROM))
    return f"Change only {column}, up and down through its range, and measure {claim.subject} at every step."


def _drifts(claim: Claim) -> str:
    fact = claim.fact("whole")
    if claim.since():
        change_text = (
            f"{_body(claim)}, declared stationary, is displaced" if fact else f"the shape of {_body(claim)} changed"
        )
        return with_sizes(f"{change_text}{claim.since()}", claim)
    of_time = claim.fact("column") in (None, "time_s")
    how = (
        ", in smooth waves" if claim.fact("waves") else ", fast at first and slower later" if claim.fact("tau") else ""
    )
    if claim.fact("late"):
        start = claim.fact("start")
        how = f", from {start:.0f} s on" if of_time else f", from number {start:.0f} on"
    over = f"{'time' if of_time else 'the order of the poses'}{how}"
    if fact:
        return with_sizes(f"{_body(claim)}, declared stationary, moves as a whole with {over}", claim)
    return with_sizes(f"the shape of {_body(claim)} drifts with {over}", claim)


def _jumps(claim: Claim) -> str:
    return with_sizes(f"all targets of {_body(claim)} are displaced together against its joints{claim.since()}", claim)


def _wait(claim: Claim) -> str:
    if claim.since():
        before = f"before pose {claim.fact('from_pose')}"
        return f"Check whether {claim.subject} was touched {before}, and survey it again."
    return f"Measure {claim.subject} repeatedly without moving anything, until it no longer changes."


def _gravity_clause(claim: Claim) -> str:
    """Return the clause on shifts with the direction of gravity, with their size."""
    fact, body = claim.fact("one"), claim.fact("body") or claim.subject or "a body"
    if fact:
        size = claim.size(f"{fact}_sag")
        return f"target {fact} on {body} sags with gravity{by_words(size_in_words(size)) if size is not None else ''}"
    if claim.fact("form") == "free":
        return with_sizes(f"the targets on {body} shift with the direction of gravity in its frame", claim)
    size = largest(tuple(size for size in claim.sizes if size.name.endswith("_sag")))
    most = f", most {size.name.removesuffix('_sag')} ({size_in_words(size)})" if size is not None else ""
    return f"the targets on {body} sag with gravity, each by a different amount{most}"


def _turn_over(claim: Claim) -> str:
    body = claim.fact("body") or claim.subject or "the body"
    return f"Measure {body} in a few orientations and upside down, with nothing else moved: sag changes its sign."


def _bursts(claim: Claim) -> str:
    """Return the clause on a time in which all points scattered more, with its size."""
    size = claim.size("noise_ratio")
    more, like = (f"{size_in_words(size)} times as much", "as") if size is not None else ("more", "than")
    if claim.fact("run") not in (None, ""):
        scattering = str(claim.fact("channel"))
        several = scattering in ("displacements", "signals")
        read = (
            f"all {scattering} scatter"
            if several
            else f"{'signal' if scattering[:1] == 'v' else 'channel'} {scattering} scatters"
        )
        return f"{read} {more} in run {claim.fact('run')} {like} in the other runs"
    ends = [claim.fact(name) for name in ("from_pose", "to_pose")]
    poses = "for some time" if ends[0] in (None, "") else f"from pose {ends[0]} to pose {ends[1]}"
    return f"all points scatter {more} {poses} {like} in the other poses, as by vibration"


BODIES = {
    "noise-burst": Wording(
        "temporary noise",
        _bursts,
        "Check what ran near the machine at that time and how loads were applied; repeat some of these measurements.",
    ),
    "gravity-sag": Wording("sag under gravity", _gravity_clause, _turn_over),
    "target-moved": Wording("target moved", _displacement_clause, _check_target_advice),
    "targets-swapped": Wording("targets swapped", _swapped, _check_images_advice),
    "body-deformation": Wording("body deformation", _body_deforms, _single_change_advice),
    "body-drift": Wording("body drift", _drifts, _wait),
    "body-jump": Wording("displaced targets of a body", _jumps, _wait),
}
