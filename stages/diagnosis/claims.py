"""Causes as the wordings of the report take them: by their settings, in what JSON can hold."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.wordings.catalogue import own_clause
from truing.report.wordings.claim import Claim

if TYPE_CHECKING:
    from truing.simulation.cause import Cause


def claim_of(cause: Cause, legs: int) -> Claim:
    """Return a cause of a mechanism with that many legs, without its sizes."""
    settings = {"step": str(cause.step), **cause.settings()}
    return Claim(
        cause=cause.id,
        subject=cause.subject,
        follows=cause.follows(legs),
        settings={name: _plain(value) for name, value in settings.items()},
        words=own_clause(cause.says, cause.subject) if cause.says else "",
    )


def _plain(value: Any) -> Any:
    """A setting as JSON holds it; None for what is not finite."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
