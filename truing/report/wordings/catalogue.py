"""The wordings of all causes by their ids, and what is said of a claim by them."""

from __future__ import annotations

from truing.report.diagnosis.findings import subject_words
from truing.report.wordings.axis_wordings import AXIS
from truing.report.wordings.bench_wordings import BENCH
from truing.report.wordings.body_wordings import BODIES
from truing.report.wordings.claim import Advice, AdviceKind, Claim, Wording
from truing.report.wordings.followed import FOLLOWED
from truing.report.wordings.mechanism_wordings import MECHANISM
from truing.report.wordings.parts import with_sizes
from truing.report.wordings.ray_wordings import RAYS

WORDINGS: dict[str, Wording] = {**MECHANISM, **BODIES, **BENCH, **AXIS, **RAYS, **FOLLOWED}


def cause_words(cause: str) -> str:
    """A cause as a noun: ``actuator gain``; one of a lab's own by its id."""
    return WORDINGS[cause].noun if cause in WORDINGS else cause.replace("-", " ")


def clause(claim: Claim) -> str:
    """What nature does, to complete "The data show that ..."; a cause of a lab's own brings its words."""
    if claim.cause in WORDINGS:
        return WORDINGS[claim.cause].clause(claim)
    return with_sizes(claim.words or cause_words(claim.cause), claim)


def own_clause(says: str, subject: str) -> str:
    """The clause that a cause of a lab's own brings, with its subject."""
    return f"{says} ({subject_words(subject)})" if subject else says


def confirming(claim: Claim, otherwise: str = "") -> Advice:
    """What to measure to confirm a cause; ``otherwise``: what one that is not the project's own says of it."""
    said = WORDINGS[claim.cause].advice if claim.cause in WORDINGS else otherwise
    return Advice(AdviceKind.CONFIRM, said if isinstance(said, str) else said(claim))
