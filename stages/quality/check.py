"""One quality check: value, verdict and sentence, and its limits by default or from the campaign."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, cast

from truing.schemas.quality_check import CheckLimits, DeclaredCheck
from truing.schemas.quality_checks import in_force, installed_checks, settable
from truing.schemas.sections import SetLimits

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.belonging.relation import RelationTest
    from truing.schemas.campaign import Campaign

PASS, WARN, FAIL, NOT_EVALUATED = "pass", "warn", "fail", "not evaluated"
COUNTED = "no time was recorded, or it is only a counter"


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
    accepted: str | None = None  # by whom, and why


@dataclass(frozen=True)
class CheckResults:
    """Checks of a campaign, a description of their input, tested relations and suggested tables.

    ``why_not`` is the reason why nothing could be checked; otherwise empty.
    """

    checks: Iterable[Check]
    read: str
    relations: Sequence[RelationTest] = ()
    suggested: Mapping[str, pa.Table] = field(default_factory=dict)
    why_not: str = ""


def not_evaluated(check_text: str, check: str, subject: str, why: str) -> Check:
    """Return a check without a verdict, because the campaign lacks the data for it."""
    return Check(check, subject, None, None, "", NOT_EVALUATED, f"Not evaluated ({check_text}): {why}.")


def reported_check(check: Check) -> Check:
    """Return the check; as not evaluated if its value is not a number because too little was measured."""
    if check.value is None or math.isfinite(check.value):
        return check
    return not_evaluated("too little was measured", check.check, check.subject, "its value is not a number")


@dataclass(frozen=True)
class Limit:
    """Limits of one check in the unit of its values; ``own``: limits set by the campaign, in words."""

    check: str
    warn: float | None
    fail: float | None
    below: bool
    own: str

    def verdict(self, value: float) -> str:
        """Return the verdict on a value; a value equal to a limit passes."""
        return FAIL if self._trips(value, self.fail) else WARN if self._trips(value, self.warn) else PASS

    def row(self, subject: str, value: float, unit: str, message: str, *, counts: bool = True) -> Check:
        """Return the row of qa.parquet for a value, with the limit used; ``counts`` is False if the value may not trip
        a limit."""
        verdict = self.verdict(value) if counts else PASS
        first = self.fail if self.warn is None else self.warn
        limit = self.fail if verdict == FAIL else first
        return Check(self.check, subject, value, limit, unit, verdict, message + self.own)

    def _trips(self, value: float, limit: float | None) -> bool:
        return limit is not None and (value < limit if self.below else value > limit)


@dataclass(frozen=True)
class CampaignLimits:
    """Limits of all checks of a kind of campaign; ``given``: those set by the campaign, by check."""

    kind: str
    given: Mapping[str, SetLimits] = field(default_factory=dict)

    @cached_property
    def _declared_limits(self) -> dict[str, CheckLimits]:
        return settable(self.kind)

    def of(self, check: str, per: float = 1.0) -> Limit:
        """Return the limits of a check; ``per``: its declared unit in units of the values."""
        declared, set_limits = self._declared_limits[check], self.given.get(check, SetLimits())
        warn, fail = in_force(declared, set_limits)
        texts = [
            f"{verb} {declared.words(limit)} (by default {'never' if default is None else declared.words(default)})"
            for verb, limit, default in (("warns", warn, declared.warn), ("fails", fail, declared.fail))
            if limit is not None and limit != default
        ]
        why = f": {set_limits.reason.rstrip('.')}" if set_limits.reason else ""
        return Limit(
            check,
            None if warn is None else warn * per,
            None if fail is None else fail * per,
            declared.below,
            f" Limit set by the campaign: {', '.join(texts)}{why}." if texts else "",
        )


class InstalledCheck(DeclaredCheck, Protocol):
    """Check of an installed package: its declaration and its rows."""

    def checks(self, tables: Mapping[str, pa.Table], settings: Campaign, limits: CampaignLimits) -> Iterable[Check]:
        """Return rows of qa.parquet from the tables and settings that stage qa reads."""


def checks_installed(tables: Mapping[str, pa.Table], settings: Campaign) -> Iterator[Check]:
    """Yield the rows of all checks that installed packages add to this kind of campaign."""
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    for installed_check in installed_checks(settings.campaign.kind).values():
        yield from cast(InstalledCheck, installed_check).checks(tables, settings, limits)


def gross_error_count(gross: int, readings: int) -> str:
    """Return the number of gross errors in words: ``1 of 186 readings is a gross error``."""
    return f"{gross} of {readings} readings {'is a gross error' if gross == 1 else 'are gross errors'}"
