"""What legs, actuators, platform and base do."""

from __future__ import annotations

import re

from truing.report.diagnosis.findings import subject_words
from truing.report.numbers import rough, with_uncertainty
from truing.report.wordings.claim import Claim, Wording
from truing.report.wordings.followed import columns_words
from truing.report.wordings.parts import by, by_most, largest, only, told

# A shift is told with the sigma of parameters taken one by one where it is so many times that.
_TELLING = 2.0
_ATTACHMENTS = "Move one actuator at a time through its range and measure the targets at all attachments."
_TWO_TEMPERATURES = "at two temperatures that lie as far apart as the room allows."


def _actuators(claim: Claim) -> str:
    """``actuator 3`` or ``actuators 1 and 4`` or ``the actuators``."""
    return subject_words(claim.subject).replace("leg", "actuator", 1) or "the actuators"


def _legs(claim: Claim) -> str:
    return subject_words(claim.subject) or "the legs"


def _verb(claim: Claim, one: str, many: str) -> str:
    return one if re.fullmatch(r"leg\d+", claim.subject) else many


def _up_to(claim: Claim) -> str:
    found = claim.reach
    if found is None:
        return ""
    # Numbers that are known together alone would, taken one by one, leave a shift open that was measured.
    known = found.sigma is not None and 0.0 < found.sigma < found.largest / _TELLING
    far = with_uncertainty(found.largest, found.sigma, "um") if known else f"{rough(found.largest)} um"
    return f", by up to {far}"


def _deforms(claim: Claim) -> str:
    """The platform follows each leg's own actuator."""
    where = subject_words(claim.subject)
    out = " out of proportion to" if claim.cause == "platform-deformation-nonlinear" else " with"
    along = "" if claim.sizes else " along its z"
    if where:
        own = _verb(claim, "its own actuator", "their own actuators")
        return f"the platform deforms{along} at {where}{out} {own}{_up_to(claim)}"
    most = f", most at leg {claim.reach.legs[0]}" if claim.reach is not None else ""
    return f"the platform deforms{along} at each leg{out} that leg's actuator{most}{_up_to(claim)}"


def _deforms_with_all(claim: Claim) -> str:
    most = ""
    if claim.reach is not None:
        most = f", most between legs {claim.reach.legs[0]} and {claim.reach.legs[1]}"
    if not claim.sizes:
        return "the platform deforms along its z with all actuators"
    return f"the platform deforms with the actuators{most}{_up_to(claim)}"


def _driver(claim: Claim) -> str:
    driver = str(claim.fact("driver") or "a drive")
    return columns_words((f"{driver}_mm",)) if driver.startswith("rho") else f"the {driver}"


def _base(claim: Claim) -> str:
    sizes = ", ".join(f"{s.name.replace('_', ' ')} {told(s)}" for s in claim.sizes if s.number is not None)
    return f"the base deforms with {_driver(claim)}{': ' if sizes else ''}{sizes}"


def _base_alone(claim: Claim) -> str:
    if claim.fact("driver") == "temperature":
        return f"Measure the base alone {_TWO_TEMPERATURES}"
    return f"Move {_driver(claim)} alone through its range and measure the base."


def _gain(claim: Claim) -> str:
    size, further = only(claim, "gain")
    if size and _verb(claim, "one", ""):
        return f"{_actuators(claim)} moves {'further' if further else 'less far'} than it reads, by {size}"
    does = _verb(claim, "does not move by what it reads", "do not move by what they read")
    return f"{_actuators(claim)} {does}{by_most(claim, 'gain')}"


def _backlash(claim: Claim) -> str:
    size = by_most(claim, "backlash")
    return f"{_actuators(claim)} {_verb(claim, 'has', 'have')} backlash{size}{' to either side' if size else ''}"


def _periodic(claim: Claim) -> str:
    pitch = largest(claim.sizes_of("pitch"))
    over = f", with a pitch of {told(pitch)}" if pitch is not None else ""
    return f"{_actuators(claim)} {_verb(claim, 'errs', 'err')} periodically{by_most(claim, 'amplitude')}{over}"


def _drift(claim: Claim) -> str:
    size, grows = only(claim, "drift")
    if size and _verb(claim, "one", ""):
        return f"{_legs(claim)} {'grows' if grows else 'shrinks'} by {size} over the campaign"
    drifts = _verb(claim, "drifts", "drift")
    return f"{_legs(claim)} {drifts} in length over the campaign{by_most(claim, 'drift')}"


def _warm_legs(claim: Claim) -> str:
    grow = _verb(claim, "grows", "grow")
    return f"{_legs(claim)} {grow} with temperature and the bodies do not{by_most(claim, 'alpha')}"


def _flexures(claim: Claim) -> str:
    size = largest(claim.sizes_of("flexure_length"))
    long = f": {told(size)} long as beam theory has it" if size is not None else ""
    return f"the flexures shift the joints as they bend{long}"


def _scale(claim: Claim) -> str:
    per_k = claim.size("scale_per_k")
    if per_k is not None or claim.fact("form") not in (None, "constant"):
        return f"measured lengths change with temperature{by(told(per_k)) if per_k is not None else ''}"
    size, large = only(claim, "scale")
    if not size:
        return "measured lengths are off by one factor"
    return f"measured lengths are too {'large' if large else 'small'}, by {size}"


def _heat(claim: Claim) -> str:
    sizes = {size.name.removeprefix("alpha").lstrip("_"): told(size) for size in claim.sizes}
    who = "base, platform and legs grow"
    if claim.fact("form") == "bodies":
        who = f"body {claim.subject} grows" if claim.subject else "all bodies grow alike"
    if len(sizes) == 1:
        return f"{who} with temperature, by {next(iter(sizes.values()))}"
    each = ", each by a share of its own" if claim.fact("form") == "apart" else ""
    if not sizes:
        return f"{who} with temperature{each}"
    return f"bodies grow with temperature: {', '.join(f'{part} {size}' for part, size in sizes.items())}"


MECHANISM = {
    "platform-deformation-linear": Wording("platform deformation linear", _deforms, _ATTACHMENTS),
    "platform-deformation-matrix": Wording("platform deformation matrix", _deforms_with_all, _ATTACHMENTS),
    "platform-deformation-nonlinear": Wording(
        "platform deformation nonlinear",
        _deforms,
        "Move one actuator at a time, in at least five steps, and measure the targets at all attachments.",
    ),
    "base-deformation": Wording("base deformation", _base, _base_alone),
    "actuator-gain": Wording(
        "actuator gain",
        _gain,
        "Move one actuator at a time through its range and measure its carriage itself, not the platform.",
    ),
    "actuator-backlash": Wording(
        "actuator backlash",
        _backlash,
        "Approach the same poses from below and from above, by movements far longer than the gap.",
    ),
    "actuator-periodic-error": Wording(
        "actuator periodic error",
        _periodic,
        "Move one actuator in steps of a tenth of the pitch through two turns and measure its carriage.",
    ),
    "leg-drift": Wording(
        "leg drift",
        _drift,
        "Return to one pose every quarter of an hour, nothing else moved, for as long as the campaign took.",
    ),
    "leg-thermal": Wording(
        "leg thermal", _warm_legs, "Repeat some poses at two temperatures and measure targets along the legs."
    ),
    "flexure-shift": Wording(
        "flexure shift", _flexures, "Measure poses that tilt the platform as far as it goes, to either side."
    ),
    "measurement-scale": Wording(
        "measurement scale",
        _scale,
        "Measure a second scale bar of known length and known expansion in a few poses.",
    ),
    "thermal-expansion": Wording("thermal expansion", _heat, f"Repeat some poses {_TWO_TEMPERATURES}"),
}
