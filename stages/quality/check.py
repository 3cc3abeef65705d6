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
    """Checks of a campaign as they come, what they rest on in words, tested relations, and tables that they suggest.

    ``why_not``: why nothing could be checked; empty where something was.
    """

    checks: Iterable[Check]
    read: str
    relations: Sequence[RelationTest] = ()
    suggested: Mapping[str, pa.Table] = field(default_factory=dict)
    why_not: str = ""


def without(what: str, check: str, subject: str, why: str) -> Check:
    """A check that this campaign gives nothing to judge by; neither a pass nor a failure."""
    return Check(check, subject, None, None, "", NOT_EVALUATED, f"Not evaluated ({what}): {why}.")


def reported_check(check: Check) -> Check:
    """A check as it is; not evaluated where too little was measured for its value to be a number."""
    if check.value is None or math.isfinite(check.value):
        return check
    return without("too little was measured", check.check, check.subject, "its value is not a number")


@dataclass(frozen=True)
class Limit:
    """What values of one check are held against, in their own unit; own: what the campaign set, in words."""

    check: str
    warn: float | None
    fail: float | None
    below: bool
    own: str

    def verdict(self, value: float) -> str:
        """Of a value; a limit itself is still within."""
        return FAIL if self._trips(value, self.fail) else WARN if self._trips(value, self.warn) else PASS

    def row(self, subject: str, value: float, unit: str, message: str, *, counts: bool = True) -> Check:
        """The row of a value, with the limit that its verdict rests on; ``counts``: it can trip at all."""
        verdict = self.verdict(value) if counts else PASS
        first = self.fail if self.warn is None else self.warn
        limit = self.fail if verdict == FAIL else first
        return Check(self.check, subject, value, limit, unit, verdict, message + self.own)

    def _trips(self, value: float, limit: float | None) -> bool:
        return limit is not None and (value < limit if self.below else value > limit)


@dataclass(frozen=True)
class CampaignLimits:
    """The limits of a kind of campaign; given: those of its own, by check."""

    kind: str
    given: Mapping[str, SetLimits] = field(default_factory=dict)

    @cached_property
    def _declared(self) -> dict[str, CheckLimits]:
        return settable(self.kind)

    def of(self, check: str, per: float = 1.0) -> Limit:
        """The limits of a check; per: what one of its declared unit is in that of the values."""
        declared, own = self._declared[check], self.given.get(check, SetLimits())
        warn, fail = in_force(declared, own)
        texts = [
            f"{verb} {declared.words(limit)} (by default {'never' if default is None else declared.words(default)})"
            for verb, limit, default in (("warns", warn, declared.warn), ("fails", fail, declared.fail))
            if limit is not None and limit != default
        ]
        why = f": {own.reason.rstrip('.')}" if own.reason else ""
        return Limit(
            check,
            None if warn is None else warn * per,
            None if fail is None else fail * per,
            declared.below,
            f" Limit set by the campaign: {', '.join(texts)}{why}." if texts else "",
        )


class InstalledCheck(DeclaredCheck, Protocol):
    """A check of an installed package: its declaration, and the rows that it returns."""

    def checks(self, tables: Mapping[str, pa.Table], settings: Campaign, limits: CampaignLimits) -> Iterable[Check]:
        """Rows of qa.parquet from the tables and settings that stage qa reads."""


def checks_installed(tables: Mapping[str, pa.Table], settings: Campaign) -> Iterator[Check]:
    """The rows of all checks that installed packages add to this kind of campaign."""
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    for one in installed_checks(settings.campaign.kind).values():
        yield from cast(InstalledCheck, one).checks(tables, settings, limits)
