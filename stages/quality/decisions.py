"""Check of manual exclusions: number of matched measurements, and entries that match none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc

from truing.quality.loading import LoadingView
from truing.report.numbers import listed
from truing.stages.common.overruled import decided
from truing.stages.quality.check import FAIL, PASS, WARN, Check, reported_check

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Acceptance, Overrule
    from truing.stages.declaration import Progress

_VERBS = {"exclude": "excluded", "keep": "kept"}
_KEYS = ("run", "step", "channel", "pose", "body", "target")


def overruled(view: LoadingView, settings: Campaign) -> Iterator[Check]:
    """A row per [[exclude]] and [[keep]]; one that names nothing that was read warns, for it does nothing."""
    for table, number, rule in _rules(settings):
        count = int(decided(view.steps, [rule], _VERBS[table]).chosen.sum())
        yield _check(table, number, rule, count, "reading")


def overruled_points(observations: pa.Table, settings: Campaign) -> Iterator[Check]:
    """The same of points of bodies, in any pose where none is named."""
    for table, number, rule in _rules(settings):
        yield _check(table, number, rule, _points(observations, rule), "point")


def assessed(found: Iterable[Check], accept: Sequence[Acceptance], progress: Progress) -> list[Check]:
    """The checks with who accepted their verdict, and a row per [[accept]]."""
    checks: list[Check] = []
    for check in map(reported_check, found):
        who = next((f"{entry.signed}: {entry.reason}" for entry in accept if _covers(entry, check)), None)
        checks.append(replace(check, accepted=who))
        progress(len(checks), 0, check.check)
    return [*checks, *_acceptances(checks, accept)]


def _covers(entry: Acceptance, check: Check) -> bool:
    """Whether an acceptance concerns a verdict; one without a subject concerns all of its check."""
    return entry.check == check.check and entry.subject in (None, check.subject)


def _acceptances(checks: Sequence[Check], accept: Sequence[Acceptance]) -> Iterator[Check]:
    """A row per [[accept]]; one that concerns no verdict warns, for it does nothing."""
    for number, entry in enumerate(accept, 1):
        rows = [check for check in checks if _covers(entry, check)]
        tripped = sum(check.verdict in (WARN, FAIL) for check in rows)
        named = f"{entry.check} {entry.subject or ''}".strip()
        text = f"{named}: {tripped} verdict{'s' * (tripped != 1)} accepted by {entry.signed}: {entry.reason}"
        if not rows:
            others = [check.subject for check in checks if check.check == entry.check and check.subject]
            known = f"; its subjects are {listed(others)}" if others else ""
            text = f"{named}: no check has this name{known}; nothing was accepted by {entry.signed}"
        yield Check("overruled", f"accept {number}", float(len(rows)), 1.0, "", PASS if rows else WARN, f"{text}.")


def _rules(settings: Campaign) -> Iterator[tuple[str, int, Overrule]]:
    for table, rules in (("exclude", settings.exclude), ("keep", settings.keep)):
        yield from ((table, number, rule) for number, rule in enumerate(rules, 1))


def _points(observations: pa.Table, rule: Overrule) -> int:
    """How many points a rule names."""
    found = observations
    for key in ("body", "target", "pose"):
        value = getattr(rule, key)
        if value is not None:
            found = found.filter(pc.equal(found.column(key).cast(pa.string()), str(value)))
    return int(found.num_rows)


def _check(table: str, number: int, rule: Overrule, count: int, what: str) -> Check:
    text = f"{_VERBS[table]} by {rule.signed}: {rule.reason}"
    message = (
        f"{_named(rule)}: {count} {what}{'s' * (count > 1)} {text}."
        if count
        else f"{_named(rule)}: no {what} is so called, and none was {_VERBS[table]} by {rule.signed}."
    )
    return Check("overruled", f"{table} {number}", float(count), 1.0, "", PASS if count else WARN, message)


def _named(rule: Overrule) -> str:
    """What a rule names, as campaign.toml has it."""
    given = [f"{key} {value}" for key in _KEYS if (value := getattr(rule, key)) is not None]
    text = ", ".join(given) or "everything"
    return text[0].upper() + text[1:]
