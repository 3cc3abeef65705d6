"""What bodies and their targets do."""

from __future__ import annotations

import math

from truing.report.diagnosis.effect_units import told_size
from truing.report.diagnosis.findings import subject_words
from truing.report.wordings.claim import Claim, Wording
from truing.report.wordings.followed import product_words
from truing.report.wordings.parts import listed, with_sizes
from truing.schemas.covariates import own_name

_CAME_FROM, _TIMES, _TEMPERATURE = "approach ", "*", "temperature_c"


def _since(claim: Claim) -> str:
    pose = claim.fact("from_pose")
    return "" if pose in (None, "") else f" from pose {pose} on"


def _on_body(claim: Claim) -> str:
    return f" on {claim.fact('body')}" if claim.fact("body") else ""


def _moved(claim: Claim) -> str:
    who = f"{claim.subject or 'a target'}{_on_body(claim)}"
    parts = [size for name in ("dx", "dy", "dz") if (size := claim.size(name)) is not None]
    if not parts:
        return f"{who} sits elsewhere{_since(claim)}"
    apart = math.hypot(*(size.number or 0.0 for size in parts))
    sigma = max(size.sigma or 0.0 for size in parts)
    return f"{who} sits {told_size('dx', apart, sigma or None, parts[0].unit)} from its place{_since(claim)}"


def _look_at_target(claim: Claim) -> str:
    body = claim.fact("body")
    return f"Look whether {claim.subject} on {body} is loose or was touched, and survey {body} again."


def _swapped(claim: Claim) -> str:
    poses = claim.fact("poses") or ()
    names = poses.split() if isinstance(poses, str) else poses
    where = f" in poses {', '.join(map(str, names))}" if names else ""
    return f"{subject_words(claim.subject) or 'two targets'}{_on_body(claim)} carry each other's label{where}"


def _look_at_images(claim: Claim) -> str:
    return (
        f"Look at the images of the poses named: which of {listed(claim.fact('targets') or ('the targets',))} is which?"
    )


def _body(claim: Claim) -> str:
    return f"body {claim.subject}"


def _deforms(claim: Claim) -> str:
    terms, whole = claim.fact("terms") or (), claim.fact("whole")
    if not terms:
        return with_sizes(f"{_body(claim)} deforms", claim)
    if terms[0].startswith(_CAME_FROM):
        way = f"after {own_name(terms[0].removeprefix(_CAME_FROM))} went up than after it went down (hysteresis)"
        said = f"{_body(claim)} {'stands elsewhere' if whole else 'keeps another shape'} {way}"
    elif whole:
        said = f"{_body(claim)}, which should stand still, moves as a whole with {_terms(claim)}"
    else:
        or_time = ", or with time, which ran along with it" if claim.fact("with_time") else ""
        said = f"{_body(claim)} deforms with {_terms(claim)}{or_time}"
    return with_sizes(said, claim)


def _terms(claim: Claim) -> str:
    """What a body deforms with: columns, their squares and products, where another body is."""
    terms = claim.fact("terms")
    columns = list(dict.fromkeys(column for term in terms for column in term.split(_TIMES)))
    placed = columns[0].removesuffix(" x")
    if columns == [f"{placed} {axis}" for axis in "xyz"]:
        return f"where body {placed} is"
    names = ["the temperature" if column == _TEMPERATURE else own_name(column) for column in columns]
    if len(terms) == 1:
        return product_words(names * (2 if _TIMES in terms[0] and len(names) == 1 else 1))
    said = " and ".join(names)
    return f"{said}, not in proportion" if len(terms) > len(names) else said


def _alone(claim: Claim) -> str:
    column = own_name((claim.fact("columns") or ("what it follows",))[0].removeprefix(_CAME_FROM))
    return f"Change {column} alone, up and down through its range, and measure {claim.subject} at every step."


def _drifts(claim: Claim) -> str:
    whole = claim.fact("whole")
    if _since(claim):
        does = ", which should stand still, stands elsewhere" if whole else " keeps another shape"
        return with_sizes(f"{_body(claim)}{does}{_since(claim)}", claim)
    of_time = claim.fact("column") in (None, "time_s")
    how = (
        ", smoothly to and fro"
        if claim.fact("waves")
        else ", fast at first and slower later"
        if claim.fact("tau")
        else ""
    )
    if claim.fact("late"):
        start = claim.fact("start")
        how = f", from {start:.0f} s on" if of_time else f", from the {start:.0f}th on"
    over = f"{'time' if of_time else 'the order of the poses'}{how}"
    if whole:
        return with_sizes(f"{_body(claim)}, which should stand still, moves as a whole with {over}", claim)
    return with_sizes(f"the shape of {_body(claim)} drifts with {over}", claim)


def _wait(claim: Claim) -> str:
    if _since(claim):
        before = f"before pose {claim.fact('from_pose')}"
        return f"Look whether {claim.subject} was touched {before}, and survey it again."
    return f"Measure {claim.subject} again and again with nothing moved, until it has come to rest."


BODIES = {
    "target-moved": Wording("target moved", _moved, _look_at_target),
    "targets-swapped": Wording("targets swapped", _swapped, _look_at_images),
    "body-deformation": Wording("body deformation", _deforms, _alone),
    "body-drift": Wording("body drift", _drifts, _wait),
}
