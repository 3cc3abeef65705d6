"""Section of the quality checks, and the verdicts on consistency and quality of the data."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.belonging import RELATIONS, listed
from truing.report.column_heads import Head, schema_head
from truing.report.numbers import count_text, printed, quantity
from truing.report.page import Listing, ReportSection
from truing.report.reasons import why_no_quality
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, cell, table_or_none
from truing.schemas.quality_checks import WITHHOLDING
from truing.schemas.verdict import ReasonCode

_ORDER = {"fail": 0, "warn": 1, "pass": 2, "not evaluated": 3}
_HEADS = (
    Head("verdict", "Result of the check: pass, warn, fail or not evaluated."),
    schema_head("check"),
    Head("subject", "Body, target, channel or run that the row concerns; a dash for the whole campaign."),
    Head("value", "Quantity that the check compares with its limit."),
    Head("limit", "Limit of the value for this verdict."),
    Head("result", "Result of the check in one or two sentences."),
)
_ACCEPTED_BY = Head("accepted by", "Person who accepted the verdict, with the reason in campaign.toml.")
# Longer listings of warnings are folded.
_OPEN = 12


def qa(tables: Tables) -> ReportSection | None:
    """Return the section of all checks with their verdicts, failed ones first and accepted ones separately."""
    if "qa" not in tables:
        return None
    if not len(tables["qa"]):
        return ReportSection("qa", "Quality", why_no_quality(tables), state="not evaluated")
    qa = tables["qa"].assign(order=tables["qa"]["verdict"].map(_ORDER)).sort_values("order", kind="stable")
    accepted = accepted_verdicts(qa)
    listings = [
        _checks(qa[(qa["verdict"] == "fail") & ~accepted], "Failed"),
        _checks(qa[accepted], "Accepted by a person", (_ACCEPTED_BY,)),
        _checks(qa[(qa["verdict"] == "warn") & ~accepted], "Warnings"),
        _checks(qa, f"All {count_text(len(qa), 'check')}", folded=True),
    ]
    counts = qa[~accepted]["verdict"].value_counts()  # same count as in the head of the page, the log and the exit code
    texts = [f"{counts[v]} {v}" for v in _ORDER if v in counts]
    lead = ", ".join([*texts, *([f"{int(accepted.sum())} accepted"] if accepted.any() else [])])
    shown = tuple(x for x in listings if x.rows)
    return ReportSection("qa", "Quality", f"{count_text(len(qa), 'check')}: {lead}.", listings=shown)


def belonging_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the consistency of the campaign's tables: relations tested and not tested."""
    qa, relations = table_or_none(tables, "qa"), table_or_none(tables, "belonging")
    failed = None if qa is None else qa[qa["verdict"].eq("fail") & _withholding_rows(qa) & ~accepted_verdicts(qa)]
    if failed is not None and len(failed):
        return _contradicting_tables(failed)
    if relations is None:
        return None
    by_state = {state: relations[relations["state"].eq(state.value)] for state in RelationState}
    odd = by_state[RelationState.ATTENTION]
    odd = odd[odd["accepted"].isna()]
    if len(odd):
        first = odd.iloc[0]
        text = _warning(qa, str(first["relation"])) or f"Needs attention (see Quality): {_relation_names(odd)}."
        numbers = _number(first["misfit"]), cell(first["unit"]) or None, _number(first["limit"])
        return SectionVerdict("belonging", RelationState.ATTENTION, ReasonCode.DEPARTS, text, *numbers)
    untested = by_state[RelationState.NOT_TESTED]
    partly = set(untested["relation"]) & set(by_state[RelationState.OK]["relation"])
    not_tested = f" Not tested: {_relation_names(untested, partly)}." if len(untested) else ""
    if not len(by_state[RelationState.OK]):
        text = f"It was not tested whether the tables belong together.{not_tested}"
        return SectionVerdict("belonging", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    tested = _relation_names(by_state[RelationState.OK], partly)
    text = f"The data belong together, as far as tested: {tested}.{not_tested}"
    return SectionVerdict("belonging", RelationState.OK, ReasonCode.BELONG, text)


def _warning(qa: pd.DataFrame | None, check: str) -> str:
    """Return the text of a check that warns; empty where no check of this name does."""
    if qa is None:
        return ""
    messages = qa.loc[qa["check"].eq(check) & qa["verdict"].eq("warn"), "message"]
    return printed(str(messages.iloc[0])) if len(messages) else ""


def _withholding_rows(qa: pd.DataFrame) -> pd.Series:
    return qa["check"].isin(list(WITHHOLDING))


def _contradicting_tables(failed: pd.DataFrame) -> SectionVerdict:
    """Return in words the failed checks by which the tables contradict each other, with findings and remedies."""
    sentences = []
    for name, group in failed.groupby("check", sort=False):
        check = WITHHOLDING[str(name)]
        more = f" ({len(group) - 1} more, see Quality.)" if len(group) > 1 else ""
        first = f"Quality check {name} failed: {printed(group['message'].iloc[0])}{more}"
        do = printed(check.to_do.replace("`", ""))
        sentences.append(f"{first} {do} Until then {check.stages_withheld} are not evaluated.")
    return _of_checks("belonging", RelationState.FAILS, ReasonCode.DO_NOT_BELONG, " ".join(sentences), failed)


def _relation_names(relations: pd.DataFrame, partly: Collection[str] = ()) -> str:
    """Return relations in words, those of ``partly``, which were tested for some subjects only, with their subjects."""
    words = []
    for name, rows in relations.groupby("relation", sort=False):
        subjects = [str(subject) for subject in rows["subject"] if subject] if name in partly else []
        words.append(RELATIONS[str(name)].lower() + (f" ({listed(subjects)})" if subjects else ""))
    return listed(words, sep="; ")


def _of_checks(
    section: str, state: RelationState, code: ReasonCode, text: str, checks: pd.DataFrame | None = None
) -> SectionVerdict:
    """Return a verdict with the figures of the first of some checks."""
    if checks is None or not {"value", "unit", "limit"} <= set(checks):
        return SectionVerdict(section, state, code, text)
    first = checks.iloc[0]
    return SectionVerdict(
        section, state, code, text, _number(first["value"]), cell(first["unit"]) or None, _number(first["limit"])
    )


def _number(value: Any) -> float | None:
    return None if value is None or value != value else float(value)


def quality_verdict(tables: Tables, before: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on all checks of quality; consistency checks belong to another verdict."""
    if "qa" not in tables:
        return None
    qa = tables["qa"]
    if not len(qa):
        why = why_no_quality(tables)
        text = f"Quality not evaluated: {why[:1].lower()}{why[1:]}"
        return SectionVerdict("quality", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    accepted = accepted_verdicts(qa)
    also = (
        f" {count_text(int(accepted.sum()), 'failed check')} accepted by a person (see Quality)."
        if accepted.any()
        else ""
    )
    failed, warned = (qa[(qa["verdict"] == v) & ~accepted] for v in ("fail", "warn"))
    if len(failed):
        return _of_checks(
            "quality", RelationState.FAILS, ReasonCode.CHECK_FAILED, _failed_words(failed, qa, also), failed
        )
    if len(warned):
        others = warned[~_withholding_rows(warned)]
        first = f"First: {printed(others['message'].iloc[0])}" if len(others) else "See Quality."
        needs = "needs" if len(warned) == 1 else "need"
        text = f"No quality check failed; {len(warned)} of {len(qa)} {needs} attention. {first}{also}"
        return _of_checks("quality", RelationState.ATTENTION, ReasonCode.CHECK_WARNS, text, warned)
    if (qa["verdict"] == "not evaluated").all():
        text = f"None of the {len(qa)} quality checks could be evaluated.{also}"
        return SectionVerdict("quality", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    none_of_them = "The one quality check neither" if len(qa) == 1 else f"None of the {len(qa)} quality checks"
    text = f"{none_of_them} failed {'nor' if len(qa) == 1 else 'or'} gave a warning.{also}"
    return SectionVerdict("quality", RelationState.OK, ReasonCode.CHECKS_HOLD, text)


def _failed_words(failed: pd.DataFrame, qa: pd.DataFrame, also: str) -> str:
    failed_checks = failed[~_withholding_rows(failed)]  # the others belong to the verdict on consistency
    if not len(failed_checks):
        return f"{len(failed)} of {len(qa)} quality checks failed (see Quality).{also}"
    more = f" {len(failed) - 1} more, see Quality." if len(failed) > 1 else ""
    return f"{len(failed)} of {len(qa)} quality checks failed. {printed(failed_checks['message'].iloc[0])}{more}{also}"


def accepted_verdicts(qa: pd.DataFrame) -> pd.Series:
    """Return True for rows of ``qa`` that a person accepted."""
    return qa["accepted"].notna() if "accepted" in qa else qa["verdict"].isna()


def _checks(qa: pd.DataFrame, caption: str, more: tuple[str, ...] = (), folded: bool = False) -> Listing:
    rows = tuple(
        (
            r.verdict,
            r.check,
            cell(r.subject),
            quantity(r.value, r.unit),
            quantity(r.limit, r.unit),
            printed(r.message),
            *([cell(r.accepted)] if more else []),
        )
        for r in qa.itertuples()
    )
    marks = tuple("accepted" if more else "none" if v == "not evaluated" else v for v in qa["verdict"])
    title = f"{caption} ({len(rows)})" if len(rows) > _OPEN and not folded else caption
    return Listing((*_HEADS, *more), rows, marks, title, folded or len(rows) > _OPEN, "qa.parquet")
