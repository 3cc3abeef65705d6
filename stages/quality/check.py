"""One check of a campaign's quality: a value, a limit, a verdict and one sentence."""

from __future__ import annotations

import math
from dataclasses import dataclass

PASS, WARN, FAIL, NOT_EVALUATED = "pass", "warn", "fail", "not evaluated"
COUNTED = "no time was recorded, or it merely counts"


@dataclass(frozen=True)
class Check:
    """One row of qa.parquet."""

    check: str
    subject: str
    value: float | None
    limit: float | None
    unit: str
    verdict: str
    message: str


def without(what: str, check: str, subject: str, why: str) -> Check:
    """A check that this campaign gives nothing to judge by; neither a pass nor a failure."""
    return Check(check, subject, None, None, "", NOT_EVALUATED, f"Not evaluated ({what}): {why}.")


def told(check: Check) -> Check:
    """A check as it is; not evaluated where too little was measured for its value to be a number."""
    if check.value is None or math.isfinite(check.value):
        return check
    return without("too little was measured", check.check, check.subject, "its value would be no number")
