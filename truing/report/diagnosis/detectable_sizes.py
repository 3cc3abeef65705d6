"""Detectable sizes: the smallest size of each cause that the campaign would have shown."""

from __future__ import annotations

import re

import pandas as pd

from truing.report.chain_corrections import estimates_zeros
from truing.report.column_heads import CAUSE, PARAMETER, Head
from truing.report.diagnosis.assessed_causes import FOUND, NOT_TESTABLE, REJECTED, SUSPECTED, AssessedCause
from truing.report.diagnosis.effect_units import plain_size, stem
from truing.report.diagnosis.findings import few, subject_words
from truing.report.numbers import count_text, printed
from truing.report.page import Listing, ReportSection
from truing.report.tables import Tables, cell, table_or_none
from truing.report.wordings.catalogue import cause_words

_TITLE = "Smallest detectable effects"
_COMPONENT = r"(moment|force|offset|arm)_[xyz](?:_\w+)?"
_OFFSET = "joint-offset"
_NEVER, _HELD = "not at any plausible size", "part of what was found"
_BEYOND = "only beyond plausible sizes"


def hidden(rows: list[AssessedCause], tables: Tables) -> ReportSection:
    """Return the smallest detectable sizes, cause by cause, with every subject below."""
    table = table_or_none(tables, "detectable")
    if table is None:
        why = "The smallest detectable sizes were not computed in this run."
        reported = _in_words(rows)
        return ReportSection(
            "hidden", _TITLE, why, listings=(reported,) if reported.rows else (), state="not evaluated"
        )
    table = table.assign(subject=table["subject"].map(cell), words=size_words(table))
    contained_causes = {row.cause for row in rows if row.reason_code == "contained"}
    table.loc[table["cause"].isin(contained_causes) & table["size"].isna(), "words"] = _HELD
    accepted_causes = {row.cause for row in rows if row.verdict in (FOUND, SUSPECTED)}
    table.loc[table["cause"].isin(accepted_causes) & table["size"].isna(), "words"] = _BEYOND
    return ReportSection(
        "hidden", _TITLE, _opening_sentences(table, tables), listings=(_by_cause(table, rows), _full_listing(table))
    )


def size_words(table: pd.DataFrame) -> list[str]:
    """Return the size of each row of detectable.parquet in words."""
    return [
        printed(plain_size(str(name), float(size), cell(unit))) if size == size else _NEVER
        for name, size, unit in zip(table["parameter"], table["size"], table["unit"], strict=True)
    ]


def _opening_sentences(table: pd.DataFrame, tables: Tables) -> str:
    power = float(table["power"].median())
    text = f"An effect of the size shown would have been found with a probability of {100 * power:.0f} %; smaller "
    text += "effects may be present."
    never = [cause for cause, group in table.groupby("cause", sort=False) if (group["words"] == _NEVER).all()]
    if _OFFSET in never and estimates_zeros(tables):
        never.remove(_OFFSET)
        text += " Zeros of joints within their tolerances are not tested but estimated: section Chain lists them."
    if never:
        text += f" This campaign cannot show {', '.join(cause_words(str(c)) for c in never)} at any plausible size."
    return text


def _by_cause(table: pd.DataFrame, rows: list[AssessedCause]) -> Listing:
    """Return a row per cause and kind of parameter, from its best subject to its worst."""
    verdicts = {row.cause: row.verdict for row in reversed(rows)}
    cells = tuple(
        (
            cause_words(str(cause)),
            str(parameter),
            _subject_words(part),
            *_from_to(part),
            verdicts.get(str(cause), "–"),
        )
        for (cause, parameter), part in _kinds(table)
    )
    heads = (
        CAUSE,
        PARAMETER,
        Head("concerns", "Part of the machine that the parameter concerns: the whole, or each leg, target or axis."),
        Head("detectable from, best subject", "Smallest size that would be found, at the part that shows it best."),
        Head("worst subject", "Smallest size that would be found, at the part that shows it worst."),
        Head("result", "Decision of the diagnosis on this cause."),
    )
    caption = "The smallest size that would have been found, for the subjects that show it best and worst"
    marks = tuple("found" if row[-1] == FOUND else "none" for row in cells)
    return Listing(heads, cells, marks, caption, held_by="detectable.parquet")


def _kinds(table: pd.DataFrame) -> list[tuple[tuple[object, object], pd.DataFrame]]:
    kinds = [_kind(str(name)) for name in table["parameter"]]
    grouped = table.assign(kind=kinds).groupby(["cause", "kind", "unit"], sort=False, dropna=False)
    return [((cause, kind), of_kind) for (cause, kind, _), of_kind in grouped]


def _kind(parameter: str) -> str:
    """Return the kind of a parameter, equal in every leg or axis: ``moment`` of all components and forms of one."""
    first = parameter.partition(" ")[0]
    component = re.fullmatch(_COMPONENT, first)
    return component[1] if component else stem(first)


def _subject_words(table: pd.DataFrame) -> str:
    subjects = list(dict.fromkeys(table["subject"]))
    if len(subjects) == 1:
        return subject_words(subjects[0]) or "the whole"
    single = [str(subject) for subject in subjects if subject]
    kinds = {subject.split()[0].rstrip("0123456789") for subject in single}
    noun = kinds.pop() if len(kinds) == 1 else "subject"
    text = count_text(len(single), noun if not noun.endswith("s") else "subject")
    return text if len(single) == len(subjects) else f"the whole, {text}"


def _from_to(table: pd.DataFrame) -> tuple[str, str]:
    known = table.dropna(subset="size")
    if not len(known):
        return str(table["words"].iloc[0]), str(table["words"].iloc[0])
    best, worst = known.loc[known["size"].idxmin(), "words"], known.loc[known["size"].idxmax(), "words"]
    return str(best), str(worst) if len(known) == len(table) else _NEVER


def _full_listing(table: pd.DataFrame) -> Listing:
    rows = tuple(
        (cause_words(r.cause), subject_words(r.subject), few(str(r.parameter)), r.words, f"{100 * r.power:.0f} %")
        for r in table.itertuples()
    )
    heads = (
        CAUSE,
        Head("subject", "Leg, target or axis that the row concerns; a dash for the whole machine."),
        PARAMETER,
        Head("detectable from", "Smallest size of the effect that is found with the stated probability."),
        Head("with probability", "Probability that the diagnosis finds an effect of this size."),
    )
    return Listing(heads, rows, (), "Every cause and subject", True, "detectable.parquet")


_SAYS = Head("what the data say", "Result of the assessment in words.")


def _in_words(rows: list[AssessedCause]) -> Listing:
    """Return the sizes from the explanations of rejected causes, where there is no table."""
    reported = tuple((row.name, printed(row.explanation)) for row in rows if row.verdict in (REJECTED, NOT_TESTABLE))
    return Listing((CAUSE, _SAYS), reported, (), "What was not found", True, "diagnosis.parquet")
