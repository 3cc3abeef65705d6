"""What a single axis and its encoders do."""

from __future__ import annotations

from truing.report.wordings.claim import Claim, Wording
from truing.report.wordings.parts import by, only

PARTS_OF_AXES = {
    "axis": "the transmission of the axis, or an encoder that no reading here tells from it,",
    "encoder load": "the encoder at the load",
    "encoder motor": "the encoder at the motor",
    "instrument": "the outside instrument",
}


def _scale(claim: Claim) -> str:
    size, large = only(claim, "scale")
    verb = "travels" if claim.subject == "axis" else "reads"
    if not size:
        return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} {verb} too far or too little by one factor"
    return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} {verb} too {'far' if large else 'little'}{by(size)}"


def _lost(claim: Claim) -> str:
    size, _ = only(claim, "backlash")
    sides = " to either side" if size else ""
    return f"motion is lost between motor and load{by(size)}{sides}"


def _shift(claim: Claim) -> str:
    size, _ = only(claim, "shift")
    event, pose = claim.fact("event"), claim.fact("from_pose")
    since = f" after the event {event}" if event else f" from row {pose} on" if pose not in (None, "") else ""
    return f"{PARTS_OF_AXES.get(claim.subject, claim.subject)} stands off by a constant{since}{by(size)}"


def _look_at_event(claim: Claim) -> str:
    event = claim.fact("event")
    again = f"Repeat the event ({event})" if event else "Switch the axis off and on, and reference it again"
    return f"{again}, with the same commands measured before and after."


AXIS = {
    "scale-error": Wording(
        "scale error",
        _scale,
        "Measure the same commands with another instrument of known length or angle, over the whole travel.",
    ),
    "lost-motion": Wording(
        "lost motion",
        _lost,
        "Approach the same commands from both sides, by movements far longer than the gap, and read both encoders.",
    ),
    "zero-shift": Wording("zero shift", _shift, _look_at_event),
}
