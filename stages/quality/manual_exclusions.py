"""Check of manual exclusions: number of matched measurements, and entries that match none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc

from truing.quality.loading import LoadingView
from truing.report.numbers import listed
from truing.schemas.artifact import StoredTable, table_batches
from truing.stages.common.manual_decisions import manual_decisions
from truing.stages.quality.check import FAIL, PASS, WARN, Check, reported_check

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Acceptance, Overrule
    from truing.stages.declaration import Progress

_VERBS = {"exclude": "excluded", "keep": "kept"}
_NAMES = ("pose", "body", "target")  # of a point
_KEYS = ("run", "step", "channel", *_NAMES)


def decision_checks(view: LoadingView, settings: Campaign) -> Iterator[Check]:
    """Yield one row per [[exclude]] and [[keep]]; an entry that matches no reading warns."""
    for table, number, rule in _rules(settings):
        count = int(manual_decisions(view.steps, [rule], _VERBS[table]).chosen.sum())
        yield _check(table, number, rule, count, "reading")


def point_decision_checks(observations: pa.Table | StoredTable, settings: Campaign) -> Iterator[Check]:
    """Yield one row per [[exclude]] and [[keep]] on points; an entry without a pose concerns all poses."""
    for table, number, rule in _rules(settings):
        yield _check(table, number, rule, _points(observations, rule), "point")


def with_acceptances(found: Iterable[Check], accept: Sequence[Acceptance], progress: Progress) -> list[Check]:
    """Return the checks with the person who accepted their verdict, and one row per [[accept]]."""
    checks: list[Check] = []
    for check in map(reported_check, found):
        who = next((f"{entry.signed}: {entry.reason}" for entry in accept if _covers(entry, check)), None)
        checks.append(replace(check, accepted=who))
        progress(len(checks), 0, check.check)
    return [*checks, *_acceptances(checks, accept)]


def _covers(entry: Acceptance, check: Check) -> bool:
    """Return True if an acceptance concerns a verdict; without a subject it concerns all rows of its check."""
    return entry.check == check.check and entry.subject in (None, check.subject)


def _acceptances(checks: Sequence[Check], accept: Sequence[Acceptance]) -> Iterator[Check]:
    """Yield one row per [[accept]]; an entry that matches no check warns."""
    for number, entry in enumerate(accept, 1):
        rows = [check for check in checks if _covers(entry, check)]
        tripped = sum(check.verdict in (WARN, FAIL) for check in rows)
        named = f"{entry.check} {entry.subject or ''}".strip()
        text = f"{named}: {tripped} verdict{'s' * (tripped != 1)} accepted by {entry.signed}: {entry.reason}"
        if not rows:
            other_subjects = [check.subject for check in checks if check.check == entry.check and check.subject]
            known = f"; its subjects are {listed(other_subjects)}" if other_subjects else ""
            text = f"{named}: no check has this name{known}; nothing was accepted by {entry.signed}"
        yield Check("overruled", f"accept {number}", float(len(rows)), 1.0, "", PASS if rows else WARN, f"{text}.")


def _rules(settings: Campaign) -> Iterator[tuple[str, int, Overrule]]:
    for table, rules in (("exclude", settings.exclude), ("keep", settings.keep)):
        yield from ((table, number, rule) for number, rule in enumerate(rules, 1))


def _points(observations: pa.Table | StoredTable, rule: Overrule) -> int:
    """Return the number of points that a rule matches."""
    total = 0
    for table_batch in table_batches(observations, _NAMES):
        for key in _NAMES:
            value = getattr(rule, key)
            if value is not None:
                table_batch = table_batch.filter(pc.equal(table_batch.column(key).cast(pa.string()), str(value)))
        total += int(table_batch.num_rows)
    return total


def _check(table: str, number: int, rule: Overrule, count: int, what: str) -> Check:
    text = f"{_VERBS[table]} by {rule.signed}: {rule.reason}"
    message = (
        f"{_rule_words(rule)}: {count} {what}{'s' * (count > 1)} {text}."
        if count
        else f"{_rule_words(rule)}: no {what} has this name, so none was {_VERBS[table]} by {rule.signed}."
    )
    return Check("overruled", f"{table} {number}", float(count), 1.0, "", PASS if count else WARN, message)


def _rule_words(rule: Overrule) -> str:
    """Return the keys and values of a rule as in campaign.toml."""
    given = [f"{key} {value}" for key in _KEYS if (value := getattr(rule, key)) is not None]
    text = ", ".join(given) or "everything"
    return text[0].upper() + text[1:]
