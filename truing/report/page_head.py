"""Top of the page: the sentences that need action, and the first screen."""

from __future__ import annotations

import math

from truing.belonging.relation import RelationState
from truing.report.calibration.with_findings import choice_verdicts
from truing.report.chain_corrections import corrections
from truing.report.diagnosis.verdict_sentences import diagnosis_details
from truing.report.first_screen import first_screen, gross_errors_of_axis
from truing.report.numbers import in_suitable_unit, printed
from truing.report.page import NO_FACTS, CampaignFacts, PageHead, Verdict
from truing.report.section_verdict import SectionVerdict, verdict_rows
from truing.report.tables import Tables, table_or_none
from truing.report.verdict import with_verdict
from truing.schemas.verdict import CAMPAIGN, ReasonCode

_OF_AXES = {"A": "accuracy A", "B": "reversal B"}  # symbols of ISO 230-2
_FEW_AXES = 3
# Sections with a line of their own if they pass, and those that share one.
_OWN_LINE = ("diagnosis", "simulation", "positioning", "requirements", "changes", "quality")
_TOGETHER = {
    "belonging": "the data belong together",
    "adequacy": "the residuals of the final model look like noise",
    "pulls": "pulls are within tolerances",
    "calibration": "the calibration fits the data",
}
# Untested sections that need no action.
_SILENT = (ReasonCode.NO_READINGS,)


def build_head(campaign: str, tables: Tables, about: CampaignFacts = NO_FACTS) -> PageHead:
    """Return the sentences of the table ``verdict`` that need action, and the first screen."""
    rows = verdict_rows(with_verdict(tables))
    lines = tuple(_lines(rows, tables))
    has_first_sentence = bool(rows) and rows[CAMPAIGN].explanation == _explanation(rows, "positioning")
    tiles = (
        () if has_first_sentence else tuple(_positioning_tiles(tables))
    )  # the first sentence has these numbers already
    leading = 1 + len(corrections(tables, rows.get("adequacy")))
    return PageHead(campaign, lines, tiles, about, first_screen(tables, about), leading)


def _lines(rows: dict[str, SectionVerdict], tables: Tables) -> list[Verdict]:
    """Return the campaign's verdict, then sections that need attention, that pass, and that were not tested."""
    if not rows:
        return []
    lead = rows[CAMPAIGN]
    section_verdicts = [
        verdict for name, verdict in rows.items() if name != CAMPAIGN and verdict.explanation != lead.explanation
    ]
    corrected = corrections(tables, rows.get("adequacy"))
    leading = [(lead.mark, lead.explanation)]
    # A machine that agrees only after its geometry was corrected is not introduced as right.
    lines: list[Verdict] = [*corrected, *leading] if lead.state == RelationState.OK else [*leading, *corrected]
    details = diagnosis_details(tables)
    if lead.explanation == _explanation(rows, "diagnosis"):
        lines += details
    for verdict in sorted(section_verdicts, key=lambda verdict: _URGENCY[verdict.state]):
        if _has_line(verdict):
            lines.append((verdict.mark, verdict.explanation))
        if verdict.section == "diagnosis":
            lines += details
    lines += choice_verdicts(tables)
    if _has_untested_relation(tables):  # its own sentence names what was not tested
        lines += [(one.mark, one.explanation) for one in section_verdicts if _is_passed_belonging(one)]
        section_verdicts = [one for one in section_verdicts if not _is_passed_belonging(one)]
    return [*lines, *_passed_sections(section_verdicts)]


def _has_untested_relation(tables: Tables) -> bool:
    relations = table_or_none(tables, "belonging")
    return relations is not None and bool(relations["state"].eq(RelationState.NOT_TESTED.value).any())


def _is_passed_belonging(verdict: SectionVerdict) -> bool:
    return verdict.section == "belonging" and verdict.state == RelationState.OK


_URGENCY = {RelationState.FAILS: 0, RelationState.ATTENTION: 1, RelationState.OK: 2, RelationState.NOT_TESTED: 3}


def _explanation(rows: dict[str, SectionVerdict], section: str) -> str:
    return rows[section].explanation if section in rows else ""


def _has_line(section_verdict: SectionVerdict) -> bool:
    """Return True if a section has a line: every failure, and of the others those that readers look for."""
    if section_verdict.state == RelationState.FAILS:
        return True
    if section_verdict.state == RelationState.ATTENTION:
        return section_verdict.section != "deformation" and section_verdict.reason_code != ReasonCode.NOTHING_FOUND
    return section_verdict.section in _OWN_LINE and section_verdict.reason_code not in _SILENT


def _passed_sections(others: list[SectionVerdict]) -> list[Verdict]:
    named = [
        _TOGETHER[other.section] for other in others if other.section in _TOGETHER and other.state == RelationState.OK
    ]
    return [("pass", f"Other tests passed: {', '.join(named)}.")] if named else []


def _positioning_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Return accuracy and reversal of the first few positioned axes, each with its standard uncertainty."""
    rows = table_or_none(tables, "positioning")
    if rows is None:
        return []
    selected = rows[rows["subject"].isna() & rows["figure"].isin(list(_OF_AXES))]
    selected = selected[selected["run"].isin(selected["run"].unique()[:_FEW_AXES])]
    sigma = selected["sigma"] if "sigma" in selected else selected["value"] * math.nan
    shown = zip(selected["run"], selected["figure"], selected["value"], sigma, selected["unit"], strict=True)
    with_all = ", gross errors included" if gross_errors_of_axis(tables) else ""
    return [
        (f"{_OF_AXES[figure]}, {_run(run)}{with_all}", printed(in_suitable_unit(value, spread, unit)))
        for run, figure, value, spread, unit in shown
    ]


def _run(name: str | int) -> str:
    """Return the name of a run in words: ``run 1`` of a mere number."""
    return f"run {name}" if str(name).isdigit() else str(name)
