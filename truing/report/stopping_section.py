"""Section that answers whether measuring can stop: questions decided, and questions open to measurement."""

from __future__ import annotations

from collections.abc import Iterator

from truing.belonging.relation import RelationState
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.next_steps import NextStep, next_steps
from truing.report.numbers import count_text
from truing.report.page import ReportSection
from truing.report.section_verdict import SectionVerdict, verdict_rows
from truing.report.tables import Tables
from truing.report.verdict import with_verdict
from truing.schemas.needs import Need
from truing.schemas.verdict import GATES, ReasonCode

_TITLE = "Can I stop measuring?"
_NOT_DECIDED = "It is not decided whether the machine is accurate enough."
_TO_MEASURE = (("next", "What to measure next"),)
_OPEN = {Need.REQUIREMENT: "Undecided", Need.RIVAL: "Open question"}
_MODEL = ("adequacy", "pulls", "calibration")


def stop(tables: Tables) -> ReportSection | None:
    """Return the section; None where no cause was assessed."""
    rows = assessed_causes(tables)
    if not rows:
        return None
    verdicts, steps = verdict_rows(with_verdict(tables)), next_steps(rows, tables)
    open_points = _open_points(verdicts, steps)
    more = " ".join(_remaining(steps))
    if open_points:
        lead = "Not yet: the points below are open."
        see = _TO_MEASURE if steps else ()
        return ReportSection("stop", _TITLE, f"{lead} {more}".strip(), statements=open_points, see=see)
    requirement = verdicts.get("requirements")
    lead = "Yes: every requirement is decided, and no open question needs a measurement."
    if requirement is None or requirement.reason_code not in (ReasonCode.MET, ReasonCode.NOT_MET):
        why = requirement.explanation if requirement else ""
        lead = f"No open point needs a measurement. {_NOT_DECIDED} {why}".strip()
    return ReportSection("stop", _TITLE, f"{lead} {more}".strip())


def _remaining(steps: list[NextStep]) -> Iterator[str]:
    """Yield sentences on the benefit of further measurements if no point is open."""
    better, untested = (sum(step.need == need for step in steps) for need in (Need.PRECISION, Need.TESTABLE))
    if better:
        yield f"{count_text(better, 'proposal')} for further measurements would only make a known size more precise."
    if untested:
        kinds = "1 kind of cause" if untested == 1 else f"{untested} kinds of causes"
        yield f"{kinds} could not be tested with these data."


def _open_points(verdicts: dict[str, SectionVerdict], steps: list[NextStep]) -> tuple[tuple[str, str], ...]:
    """Return the open points of a campaign: failed data, a model that does not fit, undecided requirements, rivals."""
    failed = [verdicts[name] for name in (*GATES, *_MODEL) if name in verdicts]
    points = [(verdict.mark, verdict.explanation) for verdict in failed if verdict.state == RelationState.FAILS]
    return (*points, *(("next", f"{_OPEN[step.need]}: {step.purpose}.") for step in steps if step.need in _OPEN))
