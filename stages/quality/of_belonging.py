"""Tested relations as quality checks: one check per relation and subject."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from truing.belonging.relation import State, Tested
from truing.report.belonging import message
from truing.stages.quality.check import FAIL, NOT_EVALUATED, PASS, WARN, Check, without

_VERDICTS = {State.OK: PASS, State.ATTENTION: WARN, State.FAILS: FAIL, State.NOT_TESTED: NOT_EVALUATED}


def belonging_checks(tested: Iterable[Tested]) -> Iterator[Check]:
    """Yield the check of every tested relation."""
    for one in tested:
        verdict = _VERDICTS[one.state]
        value, limit = (None, None) if verdict == NOT_EVALUATED else (one.misfit, one.limit)
        yield Check(one.relation, one.subject, value, limit, one.unit, verdict, message(one))


def without_contradiction(checks: Iterable[Check], tested: Iterable[Tested]) -> Iterator[Check]:
    """Yield checks; exchanged rows are not told of signals that do not belong to their loads as they stand."""
    apart = any(one.relation == "signals-against-loads" and one.state == State.FAILS for one in tested)
    deferred = False
    for check in checks:
        if not apart or check.check != "exchanged-rows":
            yield check
        elif not deferred:
            deferred = True
            yield without("belonging", "exchanged-rows", "", "signals do not belong to loads (signals-against-loads)")
