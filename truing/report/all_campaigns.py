"""Page of all campaigns of one call, the worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from truing.belonging.relation import RelationState
from truing.report.column_heads import Head, schema_head
from truing.report.numbers import count_text, listed
from truing.report.page import Listing, PageHead, ReportSection, Verdict
from truing.report.reference import reference
from truing.report.rendering.render import render_page

if TYPE_CHECKING:
    from truing.arrays import TableRow

_NAMED = 5
_NONE = "no verdict"
_MARKS = {
    RelationState.FAILS: "fail",
    RelationState.ATTENTION: "warn",
    RelationState.OK: "pass",
    RelationState.NOT_TESTED: "none",
    _NONE: "fail",
}
_SAID = {
    _NONE: "without a verdict",
    RelationState.FAILS: "with a verdict that fails",
    RelationState.ATTENTION: "with a verdict that needs attention",
    RelationState.NOT_TESTED: "that could not be tested",
    RelationState.OK: "without objection",
}
_CAMPAIGN = schema_head("campaign")
_VERDICT = Head("verdict", "State of the campaign's verdict; no verdict where the run left none.")
_DECIDED_BY = Head("decided by", "Section of the report whose state the verdict takes.")
_HEADS = (
    _CAMPAIGN,
    _VERDICT,
    _DECIDED_BY,
    Head("reason", "Reason of the verdict; without a verdict, the first problem that was printed."),
    schema_head("failed checks"),
    schema_head("exit code"),
    schema_head("stages run"),
    schema_head("processor time", "processor_s"),
)


def campaigns_page(rows: Sequence[TableRow], links: Sequence[str]) -> str:
    """Return the page; ``rows``: of the table ``campaigns``, the worst first; ``links``: address of each report."""
    states = Counter(map(_state, rows))
    tiles = (("campaigns", f"{len(rows):,}"), *((state, f"{states[state]:,}") for state in _SAID if states[state]))
    head = PageHead(count_text(len(rows), "campaign"), tuple(_verdicts(rows)), tiles)
    sections = [_campaigns(rows, links), _deciding(rows)]
    explained = reference(sections)
    return render_page(head, [*sections, *([explained] if explained else [])])


def _state(row: TableRow) -> str:
    return row["campaign_state"] or _NONE


def _verdicts(rows: Sequence[TableRow]) -> Iterator[Verdict]:
    """Yield one sentence per state that occurs, with the names of its first campaigns."""
    for state, state_text in _SAID.items():
        names = [row["campaign"] for row in rows if _state(row) == state]
        if names:
            yield _MARKS[state], f"{count_text(len(names), 'campaign')} {state_text}: {listed(names, _NAMED)}."


def _campaigns(rows: Sequence[TableRow], links: Sequence[str]) -> ReportSection:
    listing = Listing(
        _HEADS,
        tuple(map(_cells, rows)),
        tuple(_MARKS[_state(row)] for row in rows),
        held_by="campaigns.parquet",
        links=tuple(links),
    )
    lead = "The worst first; a name leads to its report. A click on a head sorts by it."
    return ReportSection("campaigns", "Campaigns", lead, listings=(listing,))


def _cells(row: TableRow) -> tuple[str, ...]:
    return (
        row["campaign"],
        _state(row),
        row["decided_by"] or "",
        row["explanation"] or _problem(row),
        row["failed_checks"] or "",
        str(row["exit_code"]),
        str(row["stages_run"]),
        f"{row['processor_s']:.2f} s",
    )


def _problem(row: TableRow) -> str:
    more = row["problems"] - 1
    return (row["problem"] or "") + (f" (and {count_text(more, 'more problem')})" if more > 0 else "")


def _deciding(rows: Sequence[TableRow]) -> ReportSection:
    """Number of campaigns whose verdict each section of the report decides."""
    decided = Counter((_state(row), row["decided_by"] or "") for row in rows)
    heads = (_VERDICT, _DECIDED_BY, Head("campaigns", "Number of campaigns with this verdict by this section."))
    cells = [(state, section, f"{number:,}") for (state, section), number in decided.most_common()]
    listing = Listing(heads, tuple(cells), tuple(_MARKS[state] for state, *_ in cells))
    return ReportSection("deciding", "What decides", "The section that decides each verdict.", listings=(listing,))
