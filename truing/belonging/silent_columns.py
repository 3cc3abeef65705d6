"""Columns without response to loads that should move them: noise in place of a main response."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind, named_shortly
from truing.belonging.responses import Responses
from truing.belonging.slip_search import ExpectedResponse

DEPARTS = np.log(2.0)  # log ratio of main responses to the expected ones, in most runs
_MAIN = 0.3  # least share of the largest possible response that makes a response a main one
_LINEAR = 0.1
_NO_RESPONSE, _SURELY = 0.1, 3.0  # share of the expected response, and sigmas, below which a column shows none


def silent_columns(
    every: Responses,
    clear: Responses,
    expected: ExpectedResponse,
    columns: Sequence[RecordedColumn],
    runs: Sequence[str],
) -> tuple[RecordSlip, ...]:
    """Return the columns that show hardly any of a main response, one slip each, where most main responses are right.

    Such a response is not among the clear ones: next to it there is only noise.
    """
    main, share, wanted = main_responses(clear, expected)
    if not main.any() or np.median(scaled_misses(share, wanted)[main]) > DEPARTS:
        return ()
    silent, found = are_silent(every, expected), []
    for k in np.unique(every.column[silent]).tolist():
        where = tuple(runs[run] for run in np.unique(every.run[silent & (every.column == k)]).tolist())
        found.append(RecordSlip(SlipKind.SILENT, columns[k].quantity, (columns[k].name, *where)))
    return tuple(found)


def are_silent(measured: Responses, expected: ExpectedResponse) -> Mask:
    """Return True for main responses (C,) of which hardly any is there."""
    main, share, wanted = main_responses(measured, expected)
    sigma = measured.sigma / expected.possible(measured.column, measured.direction)
    return np.asarray(main & (np.abs(share) + _SURELY * sigma < _NO_RESPONSE * np.abs(wanted)))


def silent_test(relation: str, slips: tuple[RecordSlip, ...], tried: int = 0) -> RelationTest:
    """Return the failed test of a relation in which columns show no response."""
    subject = named_shortly(slips[0].subjects)
    return RelationTest(relation, RelationState.FAILS, "slip", subject, 100.0, None, None, "%", slips, tried=tried)


def scaled_misses(share: Array, wanted: Array) -> Array:
    """Return the differences of responses and expectations, shares of the possible ones, by ratios above a tenth."""
    return np.asarray(np.abs(np.arcsinh(share / _LINEAR) - np.arcsinh(wanted / _LINEAR)))


def main_responses(measured: Responses, expected: ExpectedResponse) -> tuple[Mask, Array, Array]:
    """Return True for main responses (C,), and responses and expectations as shares of the largest possible ones."""
    possible = expected.possible(measured.column, measured.direction)
    wanted = expected.expected(measured.column, measured.direction) / possible
    return np.abs(wanted) > _MAIN, measured.size / possible, wanted
