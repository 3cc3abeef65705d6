"""Verdict on a campaign: one row per section, and a row for the whole that follows from the worst of them.

The page (its first line and the marks of its sections), the log, summary.json and the exit code use only these rows.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, untested_sections
from truing.schemas.verdict import CAMPAIGN, GATES, OF_SINGLE_EPOCHS, SECTIONS, ReasonCode

# Functions that assess each section, from the run's tables and from the verdicts before it.
_Assess = Callable[[Tables, Mapping[str, SectionVerdict]], SectionVerdict | None]
_ASSESSED_BY = (
    "truing.report.quality_section:belonging_verdict",
    "truing.report.quality_section:quality_verdict",
    "truing.report.diagnosis.adequacy:adequacy_verdict",
    "truing.report.diagnosis.verdict_sentences:simulation_verdict",
    "truing.report.diagnosis.verdict_sentences:diagnosis_verdict",
    "truing.report.diagnosis.pulls:pulls_verdict",
    "truing.report.chain_pulls:chain_pulls_verdict",
    "truing.report.calibration.section:calibration_verdict",
    "truing.report.sensor.calibration:calibration_verdict",
    "truing.report.transfer_section:transfer_verdict",
    "truing.report.calibration.requirements:requirements_verdict",
    "truing.report.sensor.positioning:positioning_verdict",
    "truing.report.diagnosis.pulls:changes_verdict",
    "truing.report.poses_section:poses_verdict",
    "truing.report.deformation_section:deformation_verdict",
    "truing.report.sensor.deformation:deformation_verdict",
)
# Order where nothing fails: the completeness of the model, then findings.
_LEADS = (
    *(
        "adequacy",
        "diagnosis",
        "simulation",
        "positioning",
        "pulls",
        "calibration",
        "transfer",
        "requirements",
        "changes",
    ),
    *("belonging", "quality", "poses"),
)
# Sections on the state of the machine: without any of them a campaign is not tested, however good its data are.
_OF_MACHINE = ("diagnosis", "positioning", "calibration", "requirements", "adequacy", "pulls")
# Reasons of untested sections that need action, because data recorded for them remain unused.
_TO_ACT_ON = (ReasonCode.NO_MECHANISM, ReasonCode.MODEL_DOES_NOT_FIT)


def section_verdicts(tables: Tables) -> dict[str, SectionVerdict]:
    """Return the verdicts on all sections with tables, in the order of ``SECTIONS``."""
    verdicts: dict[str, SectionVerdict] = {}
    absent = untested_sections(tables)
    for path in _ASSESSED_BY:
        module, _, function = path.partition(":")
        assess: _Assess = getattr(importlib.import_module(module), function)
        if (verdict := assess(tables, verdicts)) is not None and verdict.section not in absent:
            verdicts[verdict.section] = verdict
    return {name: verdicts[name] for name in SECTIONS if name in verdicts}


def leading(verdicts: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict that needs action first; None where there are none.

    Failures come first, those of the data before those of models; then what needs attention; then tests that were not
    made but could be; then what passes.
    """
    candidates = (
        *_verdicts_in_state(verdicts, RelationState.FAILS, SECTIONS),
        *_verdicts_in_state(verdicts, RelationState.ATTENTION, _attention_order(verdicts)),
        *(
            verdict
            for verdict in _verdicts_in_state(verdicts, RelationState.NOT_TESTED, _LEADS)
            if verdict.reason_code in _TO_ACT_ON
        ),
        *_verdicts_in_state(verdicts, RelationState.OK, _OF_MACHINE),
        *_verdicts_in_state(verdicts, RelationState.ATTENTION, ("deformation", "adequacy")),
        *_verdicts_in_state(verdicts, RelationState.NOT_TESTED, _OF_MACHINE),
        *_verdicts_in_state(verdicts, RelationState.OK, _LEADS),
        *_verdicts_in_state(verdicts, RelationState.NOT_TESTED, _LEADS),
    )
    return next(iter(candidates), None)


def _verdicts_in_state(
    verdicts: Mapping[str, SectionVerdict], state: RelationState, order: Iterable[str]
) -> list[SectionVerdict]:
    return [verdicts[name] for name in order if name in verdicts and verdicts[name].state == state]


def _attention_order(verdicts: Mapping[str, SectionVerdict]) -> tuple[str, ...]:
    """Return the order of sections that need attention; the diagnosis comes first if noise is declared wrong. Tables
    that hardly match come before a model that is incomplete because of it."""
    codes = {name: verdict.reason_code for name, verdict in verdicts.items()}
    if codes.get("adequacy") in OF_SINGLE_EPOCHS and codes.get("diagnosis") == ReasonCode.FOUND:
        return tuple(name for name in _LEADS if name != "adequacy")  # what was found comes first
    incomplete = "adequacy" in verdicts and verdicts["adequacy"].state != RelationState.OK
    if codes.get("belonging") == ReasonCode.DEPARTS and incomplete:
        return ("belonging", *_LEADS)
    wrong_noise = codes.get("diagnosis") == ReasonCode.NOISE
    below = codes.get("diagnosis") == ReasonCode.FOUND and codes.get("adequacy") == ReasonCode.BELOW_NOISE
    return ("diagnosis", *_LEADS) if wrong_noise or below else _LEADS


def verdict_frame(tables: Tables) -> pd.DataFrame:
    """Return the rows of verdict.parquet: the campaign's first, then a row per section."""
    verdicts = section_verdicts(tables)
    lead = leading(verdicts)
    nothing = SectionVerdict(
        CAMPAIGN, RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, "This run holds nothing that could be assessed."
    )
    campaign_verdict = nothing if lead is None else replace(lead, section=CAMPAIGN)
    rows = [{**_cells(campaign_verdict), "decided_by": None if lead is None else lead.section}]
    return pd.DataFrame([*rows, *({**_cells(verdict), "decided_by": None} for verdict in verdicts.values())])


def with_verdict(tables: Tables) -> Tables:
    """Return tables with the verdict, which is computed where a run has none."""
    return tables if "verdict" in tables else {**tables, "verdict": verdict_frame(tables)}


def _cells(verdict: SectionVerdict) -> dict[str, object]:
    return {
        "section": verdict.section,
        "state": verdict.state.value,
        "reason_code": verdict.reason_code.value,
        "value": verdict.value,
        "unit": verdict.unit,
        "limit": verdict.limit,
        "explanation": verdict.explanation,
    }


def gates(rows: Iterable[Mapping[str, object]]) -> list[str]:
    """Return the sections of rows of verdict.parquet whose failure makes the data unusable."""
    return [
        str(row["section"]) for row in rows if row["section"] in GATES and row["state"] == RelationState.FAILS.value
    ]
