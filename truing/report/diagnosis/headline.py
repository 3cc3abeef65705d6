"""What was found in one clause that a busy person reads: who, what, how large; and what modelling it brings."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from truing.report.diagnosis.compared import compared
from truing.report.diagnosis.findings import UNNAMED, subject_words
from truing.report.diagnosis.judged import FOUND, Judged
from truing.report.diagnosis.overall import overall
from truing.report.diagnosis.reach import reach
from truing.report.numbers import printed, rough, sign, with_uncertainty
from truing.report.wordings import catalogue
from truing.report.wordings.followed import columns_words

if TYPE_CHECKING:
    from truing.report.tables import Tables


def clause(row: Judged, tables: Tables) -> str:
    """What was found and how large it is, without a full stop."""
    if row.is_noise:
        return printed(_noise(row))
    said = catalogue.clause(replace(row, reach=reach(row, tables)))
    unnamed = UNNAMED if row.cause == "unexplained" and row.verdict == FOUND else ""
    return printed(f"{said[:1].upper()}{said[1:]}{unnamed}")


def gain(found: list[Judged], tables: Tables) -> str:
    """What modelling all that was found brings: ``brings verification errors from 34 to 8 µm, noise floor 7``."""
    told_of = overall(found, tables, held_out=True) or overall(found, tables, held_out=False)
    if told_of is None:
        return ""
    what = compared(tables).held_out_errors if told_of.held_out else "errors"
    floor = f", noise floor {rough(told_of.floor)}" if told_of.floor is not None else ""
    if told_of.is_below_noise:
        floor += f" (below it beyond chance: {told_of.why_below})"
    return f"{_change(what, told_of.before, told_of.after)} {sign(told_of.unit)}".rstrip() + floor


def _change(what: str, before: float, after: float) -> str:
    if rough(before) == rough(after):
        return f"leaves {what} at {rough(after)}"
    return f"{'brings' if after < before else 'takes'} {what} from {rough(before)} to {rough(after)}"


def _noise(row: Judged) -> str:
    size = row.size("noise_ratio")
    times = with_uncertainty(size.number or 0.0, size.sigma) if size is not None else "–"
    if row.follows:
        return f"The noise follows {columns_words(row.follows)} and is up to {times} times what was declared"
    whose = f" of {subject_words(row.subject)}" if row.subject else ""
    return f"The measurement{whose} is {times} times as noisy as declared"
