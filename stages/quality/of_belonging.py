"""Tested relations as quality checks: one check per relation and subject."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from stages.quality.check import FAIL, NOT_EVALUATED, PASS, WARN, Check
from truing.belonging.relation import State, Tested
from truing.report.belonging import message

_VERDICTS = {State.OK: PASS, State.ATTENTION: WARN, State.FAILS: FAIL, State.NOT_TESTED: NOT_EVALUATED}


def belonging_checks(tested: Iterable[Tested]) -> Iterator[Check]:
    """Yield the check of every tested relation."""
    for one in tested:
        verdict = _VERDICTS[one.state]
        value, limit = (None, None) if verdict == NOT_EVALUATED else (one.misfit, one.limit)
        yield Check(one.relation, one.subject, value, limit, one.unit, verdict, message(one))
