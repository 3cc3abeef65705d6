"""Wordings of causes that act on an open chain: joints, links and base."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from truing.report.diagnosis.findings import subject_words
from truing.report.numbers import listed
from truing.report.wordings.claim import (
    Claim,
    ParameterSize,
    Wording,
    by_words,
    largest,
    largest_of_kind,
    positive,
    size_in_words,
    with_sizes,
)

_CLEAR = 3.0  # standard deviations of a length that is reported


def _owner(claim: Claim) -> str:
    words = subject_words(claim.subject).strip()
    return f"a {words}" if words in ("joint", "link") else words or "the chain"


def _joint(claim: Claim) -> str:
    return _owner(claim) if claim.subject else "each joint"


def _of_joint(advice: str) -> Callable[[Claim], str]:
    """Return an advice with the joints that a claim concerns in place of ``{}``."""
    return lambda claim: advice.format(_joint(claim))


def _by_kind(turns: str, slides: str) -> Callable[[Claim], str]:
    """Return an advice with the joints in place of ``{}``: one for joints that turn, another for those that slide."""
    return lambda claim: (slides if claim.fact("is_angle") is False else turns).format(_joint(claim))


def _offset(claim: Claim) -> str:
    alike = claim.fact("alike")
    owners = " or ".join([_owner(claim), *map(subject_words, alike or ())])
    same = "; one motion belongs to either" if alike else ""
    return f"the zero of {owners} is wrong{_signed(claim, 'offset')}{same}"


def _shifted(claim: Claim) -> str:
    return f"the zero of {_owner(claim)} shifts{claim.since()}{_signed(claim, 'shift')}"


def _signed(claim: Claim, kind: str) -> str:
    """Return ``: motion = reading − 0.18 ± 0.01 deg``; empty without a size."""
    size, is_positive = largest_of_kind(claim, kind)
    return f": motion = reading {'+' if is_positive else '−'} {size}" if size else ""


def _gain(claim: Claim) -> str:
    size, large = largest_of_kind(claim, "gain")
    if not size:
        return f"{_owner(claim)} has a gain error: its motion is not equal to its reading"
    return f"{_owner(claim)} moves {'farther' if large else 'less far'} than it reads{by_words(size)}"


def _backlash(claim: Claim) -> str:
    size, lags = largest_of_kind(claim, "backlash")
    sides = " to either side" if size else ""
    if claim.is_negative or (size and not lags):
        reason = "as if backlash were compensated too much"
        return f"{_owner(claim)} leads its reading after each reversal{by_words(size)}{sides}, {reason}"
    return f"{_owner(claim)} has backlash{by_words(size)}{sides}"


def _settling(claim: Claim) -> str:
    named = "share" if claim.fact("form") == "share of the movement" else "lag"
    size, tau, wait = claim.size(named), claim.size("tau"), claim.size("shortest_wait")
    text = f"{_owner(claim)} still settles after its movements when it is measured"
    if size is None or tau is None or wait is None:
        return text
    share_text = " of the movement" if named == "share" else ""
    short = "short of" if (size.number or 0.0) > 0.0 else "beyond"
    return (
        f"{text}: {size_in_words(wait)} after a movement it is "
        f"{size_in_words(positive(size))}{share_text} {short} its end, "
        f"and approaches it with a time constant of {size_in_words(tau)}"
    )


def _compliance(claim: Claim) -> str:
    clause = f"{_owner(claim)} deflects under the weight that it carries"
    text = with_sizes(clause, replace(claim, sizes=claim.sizes[:1]))
    parts = claim.fact("parts") if claim.fact("free") else ()  # a link and an axis each
    links = dict.fromkeys(part[: -len(" x")] for part in parts or ())
    return f"{text}, next to unknown centres of mass of {listed(list(links))}" if links else text


def _bending(claim: Claim) -> str:
    return with_sizes(f"{_owner(claim)} bends under the weight that it carries", claim)


def _other_gravity(claim: Claim) -> str:
    direction = str(claim.fact("direction") or "")
    if not direction:
        return "joints deflect as if gravity acted along another direction than declared"
    joints = listed([str(name) for name in claim.settings.get("joints") or ()])
    owner = f"of {joints} " if joints else ""
    if claim.fact("is_opposite"):
        return (
            f"the deflection {owner}is opposite to the weight: either gravity acts along {direction} of the base (did "
            f"you mean gravity along {direction}?), or the controller corrects more deflection than there is"
        )
    return (
        f"the deflection {owner}follows weight along {direction} of the base, and not along the declared gravity (did "
        f"you mean gravity along {direction}?)"
    )


def _gravity_advice(claim: Claim) -> str:
    corrected = " Check also whether the controller corrects deflections." if claim.fact("is_opposite") else ""
    return (
        "Check how the machine is mounted, and write the direction of gravity in the frame of its base to [mechanism]."
        f"{corrected}"
    )


def _other_weight(claim: Claim) -> str:
    """Return the words of a factor of the payload, or of all masses, and of units that it can be."""
    links = "masses of the links"
    part, other = (links, "payload") if claim.fact("part") == "links" else ("payload", links)
    size, units = claim.size("factor"), str(claim.fact("units") or "").split()
    one, other_one = ("ones", "others") if part == links else ("one", "another")
    much = other_one
    if size is not None and size.number is not None:
        much = f"{size_in_words(size)} times the declared {one}"
    asked = f" (did you mean {part} in {' or '.join(units)}?)" if units else ""
    return f"{_owner(claim)} deflects as if the {part} were {much}, with the {other} as declared{asked}"


def _tilt(claim: Claim) -> str:
    about = f" about its {claim.fact('about')} axis" if claim.fact("about") else ""
    return with_sizes(f"the column that carries {_owner(claim)} tilts{about} under the moment of its load", claim)


def _sag(claim: Claim) -> str:
    return with_sizes(f"{_owner(claim)} deflects under the weight of links whose masses are not given", claim)


def _growth(claim: Claim) -> str:
    if not claim.subject:
        return with_sizes("all links grow with temperature", claim)
    who = " or ".join([_owner(claim), *map(subject_words, claim.fact("alike") or ())])
    return with_sizes(f"{who} grows with temperature{_which_length(claim)}", claim)


def _which_length(claim: Claim) -> str:
    """Return the growing length in words, if it is not the whole of one link."""
    alike, between = claim.fact("alike"), subject_words(" ".join(claim.fact("between") or ()))
    if not alike:
        return f" along the axis of joint {claim.fact('along')}" if claim.fact("along") else ""
    if not between:
        return " (they are parts of one rigid link)"
    axes = "axes" if between.startswith("joints") else "axis"
    direction_text = f"along the {axes} of" if claim.fact("turns") else "not turned by"
    many = "either" if len(alike) == 1 else "any of them"
    return f" (a length {direction_text} {between} belongs to {many}; the growth is stated for {_owner(claim)})"


def _eccentric(claim: Claim) -> str:
    return with_sizes(f"the reading of {_owner(claim)} has an error once per turn{_or_another(claim)}", claim)


def _or_another(claim: Claim) -> str:
    return (
        ", or with another number of periods (these readings do not distinguish them)" if claim.fact("aliased") else ""
    )


def _order(claim: Claim) -> float | None:
    """Return the fitted order, or that of the candidate."""
    size = claim.size("order")
    order = claim.fact("order") if size is None else size.value
    return None if order is None else float(order)


def _harmonic(claim: Claim) -> str:
    order = _order(claim)
    times = f"{order:.4g} times" if order is not None else "several times"
    return with_sizes(f"the motion of {_owner(claim)} has an error {times} per turn{_or_another(claim)}", claim)


def _pitch(claim: Claim) -> str:
    period = _period_mm(claim)
    every = f"every {period:.4g} mm" if period is not None else "along its travel"
    open_ = ", or every other length that these readings do not distinguish" if claim.fact("aliased") else ""
    return with_sizes(f"the motion of {_owner(claim)} has an error that repeats {every}{open_}", claim)


def _period_mm(claim: Claim) -> float | None:
    """Return the fitted or the known period; None of a searched one that is not fitted yet."""
    size, order = claim.size("period"), claim.fact("order")
    if size is not None:
        return size.number
    return None if order is None or claim.fact("beside") else 2e3 * math.pi / float(order)


def _pitch_advice(claim: Claim) -> str:
    period = _period_mm(claim)
    step = "a tenth of its pitch" if period is None else f"{period / 10.0:.2g} mm"
    return (
        f"Move {_joint(claim)} alone in 40 steps of {step}, and measure a target or an interferometer's reflector on "
        "it. The error repeats with its period."
    )


def _curve(claim: Claim) -> str:
    size = largest(tuple(size for size in claim.sizes if size.name.startswith("largest")))
    who, up_to = _owner(claim), f", by up to {size_in_words(size)}" if size else ""
    if claim.subject.split().count("joint") > 1:
        return f"{who} deviate from their readings by repeatable curves{up_to}"
    return f"{who} deviates from its reading by a repeatable curve{up_to}"


def _guideway(claim: Claim) -> str:
    size, axis = largest(tuple(size for size in claim.sizes if size.name == "largest")), claim.fact("axis")
    up_to = f", by up to {size_in_words(size)}" if size else ""
    if claim.fact("error") == "turn":
        return f"the carriage of {_owner(claim)} turns about its {axis} axis along the travel{up_to}"
    along = f" along its {axis} axis" if axis else ""
    return f"the carriage of {_owner(claim)} leaves its straight line{along}{up_to}"


def _drift(claim: Claim) -> str:
    return f"the base moves steadily relative to the instrument, from the first to the last pose{_displacement(claim)}"


def _jump(claim: Claim) -> str:
    return f"the base is displaced{claim.since()}{_displacement(claim)}"


def _knocked(claim: Claim) -> str:
    who = _owner(claim)
    return f"{who}, with all that is measured on it, is displaced{claim.since()}{_displacement(claim)}"


def _displacement(claim: Claim) -> str:
    """Return shift of the origin and rotation where they are clear: ``, by 97 um at its origin``. Their effect on
    measured values is smaller, because a constant part of it belongs to the unknown place of the base."""
    shift, turn = (_length(claim, names) for names in (("dx", "dy", "dz"), ("turn_x", "turn_y", "turn_z")))
    parts = [f"by {shift} at its origin"] * bool(shift) + [f"turned by {turn}"] * bool(turn)
    return f", {' and '.join(parts)}" if parts else ""


def _length(claim: Claim, names: tuple[str, ...]) -> str:
    """Return the length of a vector with one standard deviation; empty where it is below three of them."""
    sizes = [size for size in map(claim.size, names) if size is not None and size.number is not None]
    length = math.hypot(*(size.number or 0.0 for size in sizes))
    if length == 0.0:
        return ""
    sigma = math.hypot(*((size.number or 0.0) * (size.sigma or 0.0) for size in sizes)) / length
    return size_in_words(ParameterSize("shift", length, sigma, sizes[0].unit)) if length > _CLEAR * sigma else ""


def _longer(claim: Claim) -> str:
    size, long = largest_of_kind(claim, "shift")
    end = claim.fact("end")
    distances_text = f"distances of {end}" if end else "all distances"
    much = f" by {size}" if size else ""
    return f"{distances_text} are read too {'long' if long else 'short'}{much}{claim.since()}"


def _exchanged(claim: Claim) -> str:
    names = [part for part in claim.subject.split() if part != "joint"]
    return f"the readings of joints {' and '.join(names)} are in each other's column"


_LOADED = "Repeat the same poses with another known payload. The deflection changes in proportion to the load."
_TURNING = _of_joint(
    "Move {} alone through its range in steps of 10 degrees, and measure a target far from its axis. "
    "The error repeats with every turn."
)


def _turning_advice(claim: Claim) -> str:
    order = _order(claim)
    step = 10.0 if order is None else min(10.0, 36.0 / order)
    return (
        f"Move {_joint(claim)} alone in 40 steps of {step:.2g} degrees, and measure a target far from its axis. "
        "The error repeats with its period."
    )


_CURVE = _by_kind(
    "Move {} alone through its range in steps of 2 degrees, and measure a target far from its axis; repeat it "
    "after a full turn. A curve that does not repeat has another cause than the encoder's scale.",
    "Move {} alone along its travel in 100 equal steps, and measure a target or an interferometer's reflector on it; "
    "repeat it. A curve that does not repeat has another cause than the scale.",
)
CHAIN = {
    "joint-offset": Wording(
        "joint offset",
        _offset,
        _by_kind(
            "Move {} to its zero mark, and compare its reading with a level or a pin.",
            "Move {} to its zero mark, and compare its reading with a stop or a gauge block.",
        ),
    ),
    "joint-gain": Wording(
        "joint gain",
        _gain,
        _by_kind(
            "Turn {} alone by a known angle, and compare the angle with its reading.",
            "Move {} alone by a known length, and compare the length with its reading.",
        ),
    ),
    "joint-backlash": Wording(
        "joint backlash",
        _backlash,
        _of_joint("Move {} to the same readings from both sides, ten times each."),
    ),
    "joint-settling": Wording(
        "settling of a joint",
        _settling,
        _of_joint(
            "Move {} alone over much of its range, and measure one target 1, 2, 5, 10, 30 and 60 s after it stops."
        ),
    ),
    "joint-jump": Wording(
        "jump of a joint's zero",
        _shifted,
        _of_joint(
            "Move {} to its reference mark and compare the mark with its reading; check its coupling, and its encoder "
            "for lost counts."
        ),
    ),
    "joint-eccentricity": Wording("eccentricity of a joint", _eccentric, _TURNING),
    "joint-harmonic": Wording("harmonic error of a joint", _harmonic, _turning_advice),
    "joint-pitch-error": Wording("periodic error of a slide", _pitch, _pitch_advice),
    "joint-error-curve": Wording("error curve of a joint", _curve, _CURVE),
    "guideway-error": Wording(
        "guideway error of a slide",
        _guideway,
        _of_joint(
            "Move {} alone along its travel, and measure three targets far apart on its carriage, or use a level and "
            "a straightedge. Targets far apart distinguish a rotation from a shift."
        ),
    ),
    "joint-compliance": Wording("compliance of a joint", _compliance, _LOADED),
    "link-bending": Wording("bending of a link", _bending, _LOADED),
    "joint-sag": Wording(
        "sag of a joint",
        _sag,
        "Give the masses of the links in the description, or repeat the same poses with two known payloads: "
        "only these separate the compliance from the weight.",
    ),
    "gravity-direction": Wording(
        "direction of gravity",
        _other_gravity,
        _gravity_advice,
    ),
    "weight-factor": Wording(
        "ratio of payload and masses",
        _other_weight,
        "Weigh the payload, and repeat the same poses without it. Masses and payload_kg are in kg.",
    ),
    "column-tilt": Wording(
        "tilt of a column",
        _tilt,
        "Place a level or three targets on the base, and stretch the arm to four sides with a known payload.",
    ),
    "link-growth": Wording("growth of links", _growth, "Repeat the same poses at two temperatures at least 5 K apart."),
    "base-drift": Wording(
        "drift of the base", _drift, "Measure three targets on the base at the start, in the middle and at the end."
    ),
    "base-jump": Wording(
        "jump of the base", _jump, "Measure three targets on the base at every tenth pose, and check its bolts."
    ),
    "tool-jump": Wording(
        "jump of a tool",
        _knocked,
        "Check the tool's bolts and whether it was touched or exchanged, and survey it again.",
    ),
    "distance-offset": Wording(
        "offset of distances",
        _longer,
        "Measure one known length, or one pose, before and after each series; note when the instrument was switched or "
        "a reflector exchanged.",
    ),
    "joints-exchanged": Wording(
        "exchanged joints", _exchanged, "Compare the columns with the robot's own display, in one pose."
    ),
}
