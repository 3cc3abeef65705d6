"""Do the readings of a loaded platform follow its loads as its simulation predicts?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from truing.belonging.plausible_slips import Column, slips_of_all_loads, slips_of_columns, slips_of_run_loads
from truing.belonging.relation import FORCE_UNITS, Slip, SlipKind, State, Tested
from truing.belonging.responses import Responses, responses
from truing.belonging.signals_of_loads import Recorded
from truing.belonging.slip_search import Candidate, Expected, clear, explain, hidden

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RELATION = "loads-against-readings"
_DEPARTS, _NO_SUCH = np.log(2.0), np.log(3.0)  # of a main response over the expected one, in most runs
_MAIN = 0.3  # share of what is possible from which a response is a main one
_LINEAR = 0.1
_EVERYWHERE = 0.5  # share of the main responses
_RANGE = 0.003  # largest load over the declared range: no campaign is planned for so little


def against_simulation(steps: Recorded, columns: Sequence[Column], seen: Array) -> Tested:
    """Return how readings follow loads, of which each column shows seen (K, 6): its row of the simulated compliance."""
    found = clear(responses(steps.load, steps.run, steps.value), len(columns))
    if not len(found):
        return Tested(RELATION, State.NOT_TESTED, "no-response")
    expected = by_compliance(seen)
    overall = list(_of_all(found, columns, steps.runs, expected))
    each = list(slips_of_run_loads(found, steps.runs, expected))
    broad = [one for one in overall if not one.slip.subjects]
    others = [one for one in overall if one.slip.subjects]
    told = explain(found, expected, [*others, *each], broad)
    if told.slips:
        return Tested(
            RELATION,
            State.FAILS,
            "slip",
            _subject(told.slips),
            100.0 * told.before,
            100.0 * told.after,
            None,
            "%",
            told.slips,
            told.rivals,
            told.tried,
        )
    unseen = hidden(found, expected, [one for one in overall if not _is_of_a_run(one, steps.runs)])
    unseen = (*unseen, *_hardly_answering(found, expected, steps.runs))
    state, reason = _departure(found, expected)
    before = 100.0 * told.before
    return Tested(RELATION, state, reason, "", before, None, None, "%", (), (), told.tried, unseen)


def by_compliance(seen: Array) -> Expected:
    """Return what columns should answer by their rows (K, 6) of a compliance (6, 6) whose diagonal bounds the rest."""
    gives = np.sqrt(np.maximum(np.abs(np.diag(seen)), 1e-300))
    return Expected(seen, np.maximum(gives, np.abs(seen / gives).max(axis=1)), gives)


def against_range(load: Array, largest: Array) -> Tested | None:
    """Return a campaign whose loads (N, 6) are no more than a trace of the declared range (6,), NaN where none is."""
    share = np.abs(load).max(axis=0, initial=0.0) / largest
    loaded = np.isfinite(share) & (share > 0.0)
    if not loaded.any() or np.max(share[loaded]) > _RANGE:
        return None
    most = float(np.max(share[loaded]))
    fitting = [factor for factor in FORCE_UNITS if 0.1 <= factor * most <= 1.0 + 1e-9]
    slips = tuple(Slip(SlipKind.UNIT, "load", (), factor) for factor in fitting[:1])
    return Tested(
        RELATION, State.ATTENTION, "trace-of-range", "", 100.0 * most, None, 100.0 * _RANGE, "%", slips, tried=1
    )


def untested(reason: str) -> Tested:
    """Return the relation where nothing predicts the readings: no unit of all loads, and no sign of them, can show."""
    unseen = (Slip(SlipKind.UNIT, "load"), Slip(SlipKind.SIGN, "load"))
    return Tested(RELATION, State.NOT_TESTED, reason, hidden=unseen)


def _of_all(
    found: Responses, columns: Sequence[Column], runs: Sequence[str], expected: Expected
) -> Iterator[Candidate]:
    return chain(slips_of_all_loads(found), slips_of_columns(found, columns, runs, expected, of_all=True))


def _is_of_a_run(candidate: Candidate, runs: Sequence[str]) -> bool:
    return any(name in runs for name in candidate.slip.subjects)


def _subject(slips: Sequence[Slip]) -> str:
    names = list(dict.fromkeys(name for slip in slips for name in slip.subjects))
    return ", ".join(names) if len(names) <= 3 else ""


def _hardly_answering(found: Responses, expected: Expected, runs: Sequence[str]) -> tuple[Slip, ...]:
    """What nobody sees in runs that no channel answers clearly which was read in them."""
    main = _main(found, expected)[0]
    idle = tuple(runs[run] for run in np.unique(found.run).tolist() if not main[found.run == run].any())
    return tuple(Slip(kind, "reading", idle) for kind in (SlipKind.UNIT, SlipKind.SIGN)) if idle else ()


def _main(found: Responses, expected: Expected) -> tuple[Mask, Array, Array]:
    """Which responses (C,) should be main ones, and responses and expectations in shares of what is possible."""
    possible = expected.of_column[found.column] * np.linalg.norm(found.direction * expected.of_load, axis=1)
    wanted = np.sum(expected.matrix[found.column] * found.direction, axis=1) / possible
    return np.abs(wanted) > _MAIN, found.size / possible, wanted


def _departure(found: Responses, expected: Expected) -> tuple[State, str]:
    """Whether most main responses are far from what is expected, though no slip explains it."""
    main, share, wanted = _main(found, expected)
    if not main.any():
        return State.NOT_TESTED, "no-main-response"
    off = np.abs(np.arcsinh(share / _LINEAR) - np.arcsinh(wanted / _LINEAR))[main]
    if np.quantile(off, _EVERYWHERE) > _NO_SUCH:
        return State.FAILS, "no-slip"
    each = [np.median(off[found.run[main] == run]) for run in np.unique(found.run[main])]
    return (State.ATTENTION, "departs") if max(each) > _DEPARTS else (State.OK, "agrees")
