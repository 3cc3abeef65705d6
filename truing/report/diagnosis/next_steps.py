"""Next measurements in order of urgency, from all tables of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from truing.report.calibration.requirements import (
    assessed_noun,
    chosen_requirements,
    interval_words,
    unmeasured_components,
)
from truing.report.diagnosis.assessed_causes import NOT_TESTABLE, RIVAL, SUSPECTED, AssessedCause, accepted_of
from truing.report.diagnosis.shortcomings import decisive_measurements
from truing.report.numbers import approximate_duration, count_text, printed
from truing.report.section_verdict import verdict_rows
from truing.report.tables import Row, Tables, cell, table_or_none
from truing.report.verdict import with_verdict
from truing.report.wordings.catalogue import cause_words
from truing.report.wordings.claim import AdviceKind
from truing.schemas.needs import Need
from truing.schemas.verdict import ReasonCode

_OF_ADVICE: dict[str, Need] = {AdviceKind.SEPARATE: Need.RIVAL, AdviceKind.ANOTHER: Need.RIVAL}
_UNNAMED = "unexplained"
_PLANS = ("next_poses", "next_loads")
_FIGURES = ("measurements", "duration_s", "sigma_now", "sigma_expected", "odds_expected")
_AIMS = {
    Need.REQUIREMENT: "to decide {}",
    Need.RIVAL: "to separate {} from its rivals",
    Need.PRECISION: "to determine {} more precisely",
}


@dataclass(frozen=True)
class NextStep:
    """One measurement to make next: need, subject and words, with figures where they were computed.

    ``short``: the words without what a table on the page holds, empty where none does; ``figures`` by column of
    next_measurements.parquet, ``unit`` that of figures with their own unit.
    """

    need: Need
    purpose: str
    words: str
    short: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    unit: str = ""

    @property
    def short_text(self) -> str:
        """Short words, or the full ones."""
        return self.short or self.words

    @property
    def aim_text(self) -> str:
        """Number, duration and aim of the measurements where they were computed, or else the short words."""
        total, duration_s = self.figures.get("measurements"), self.figures.get("duration_s")
        if total is None or self.need not in _AIMS:
            return self.short_text
        takes = "" if duration_s is None else f" ({approximate_duration(duration_s)})"
        return f"Make {count_text(int(total), 'further measurement')}{takes} {_AIMS[self.need].format(self.purpose)}."


def next_steps(rows: list[AssessedCause], tables: Tables) -> list[NextStep]:
    """Return all possible next measurements, the most urgent first."""
    reported = [NextStep(Need.RIVAL, *both) for both in decisive_measurements(rows, tables)]
    steps = [*_requirements(tables), *reported, *_findings(rows, tables), *_untested(rows)]
    once = {(step.need, step.words): step for step in steps}
    return sorted(once.values(), key=lambda step: step.need.rank)


def next_measurements_frame(steps: list[NextStep]) -> pd.DataFrame:
    """Return the rows of next_measurements.parquet."""
    rows: list[dict[str, object]] = [
        {"rank": rank, "need": step.need.value, "purpose": step.purpose, "next_measurement": step.words}
        | {"unit": step.unit or None, **step.figures}
        for rank, step in enumerate(steps, 1)
    ]
    return pd.DataFrame(rows, columns=["rank", "need", "purpose", "next_measurement", *_FIGURES, "unit"])


def _requirements(tables: Tables) -> Iterator[NextStep]:
    """Yield the poses that decide requirements whose interval contains the limit; nothing if no model fits."""
    if unseen := unmeasured_components(tables):
        yield NextStep(
            Need.REQUIREMENT, f"requirement {unseen[0]}", _measurement_of(unseen, is_axis="axis_errors" in tables)
        )
    requirements = chosen_requirements(tables)
    verdict = verdict_rows(with_verdict(tables)).get("requirements")
    if requirements is None or "measurements" not in requirements or verdict is None:
        return
    if verdict.reason_code == ReasonCode.MODEL_DOES_NOT_FIT:
        return
    undecided = requirements[requirements["verdict"] == "undecided"].sort_values(
        "measurements", ascending=False, na_position="last"
    )
    pace_s, several = _pace(tables), int(undecided["measurements"].notna().sum())
    noun = assessed_noun(requirements)
    for row in undecided.itertuples():
        if pd.isna(row.measurements):
            present, _, required = interval_words(row)
            words = (
                f"No practical number of {noun}s decides it: the error of {row.component} is too close to its limit. "
            )
            words += f"Its 95 % interval is {present}; the limit is {required}."
            yield NextStep(Need.REQUIREMENT, f"requirement {row.component}", words)
        else:
            yield _deciding_measurements(row, pace_s, several, "row" if "axis_errors" in tables else noun)


def _measurement_of(components: list[str], *, is_axis: bool) -> str:
    """Return the measurement that shows errors in components of the tip of a chain, or of an axis."""
    quantity = "the axis by an outside instrument" if is_axis else "a target or a pose of the tip"
    if not is_axis and any(name.startswith("r") for name in components):
        quantity = "poses of the tip, or three targets on it that are not on one line"
    return f"To evaluate the requirement on {', '.join(components)}, measure {quantity}."


_ALL_OVER = {"row": "the travel", "pose": "the workspace", "run": "the range"}
_VERIFICATION = ", with role verification"
_ROLES = {"row": _VERIFICATION, "pose": _VERIFICATION, "run": " (with role verification if others have it)"}


def _deciding_measurements(row: Row, pace_s: float | None, several: int, noun: str) -> NextStep:
    """Return the measurements that decide one requirement; they also serve the others if ``several`` are undecided.

    noun: row of an axis, pose, or run of a force sensor.
    """
    total = int(row.measurements)
    takes = "" if pace_s is None else f" ({approximate_duration(total * pace_s)} at the pace of this campaign)"
    text = (
        f"To decide whether {row.component} meets its requirement, measure {count_text(total, f'further {noun}')} "
        "spread over "
    )
    text += f"{_ALL_OVER[noun]}{_ROLES[noun]}{takes}."
    text += f" The same {noun}s also decide the other requirements." if several > 1 else ""
    present, predicted, required = interval_words(row)
    given = f"The 95 % interval of its error is now {present}; the limit is {required}. "
    given += (
        f"The interval becomes {predicted} if errors are as large as in the {int(row.poses_judged)} {noun}s so far."
    )
    figures = {"measurements": float(total)} | ({} if pace_s is None else {"duration_s": total * pace_s})
    return NextStep(Need.REQUIREMENT, f"requirement {row.component}", f"{text} {given}", figures=figures)


def _pace(tables: Tables) -> float | None:
    """Return the median time from one pose to the next, s; None where unknown, or where times number the poses."""
    table = table_or_none(tables, "configurations")
    if table is None or "time_s" not in table:
        return None
    steps = np.diff(np.sort(table["time_s"].dropna().to_numpy(float)))
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) and not np.all(steps == 1.0) else None


def _findings(rows: list[AssessedCause], tables: Tables) -> Iterator[NextStep]:
    """Yield the measurements for each finding: first to separate it from rivals, last those that no repeats can
    provide."""
    accepted = accepted_of(rows)
    alternatives = [row for row in rows if row.verdict == RIVAL and not (accepted and row.advice_kind in _OF_ADVICE)]
    for row in sorted([*accepted, *alternatives], key=lambda row: row.advice_kind == AdviceKind.IN_VAIN):
        if row.then:
            yield _of_finding(row, tables)


def _of_finding(row: AssessedCause, tables: Tables) -> NextStep:
    """Return the measurement for a finding; a nonparametric or suspected one is to be separated from its rivals."""
    doubted = row.verdict in (SUSPECTED, RIVAL) or row.cause == _UNNAMED
    need = _OF_ADVICE.get(row.advice_kind, Need.RIVAL if doubted else Need.PRECISION)
    plan = _plan(row.next_purpose, tables)
    if plan is None:
        return NextStep(need, row.in_sentence, printed(row.then), printed(row.in_short))
    figures = {name: float(plan[name]) for name in _FIGURES if name in plan and pd.notna(plan[name])}
    return NextStep(need, row.in_sentence, printed(row.then), printed(row.in_short), figures, cell(plan.get("unit")))


def _plan(purpose: str, tables: Tables) -> pd.Series | None:
    """Return the last row of a purpose's table, with its totals; None where it has none."""
    known = [table for name in _PLANS if (table := table_or_none(tables, name)) is not None and "need" in table]
    of_purpose = [table[table["purpose"] == purpose] for table in known if purpose]
    return next((table.iloc[-1] for table in of_purpose if len(table)), None)


def _untested(rows: list[AssessedCause]) -> Iterator[NextStep]:
    """Yield the measurements that would show causes which this campaign can show for no subject."""
    shown = {row.cause for row in rows if row.verdict != NOT_TESTABLE}
    first = {row.cause: row for row in reversed(rows) if row.cause not in shown and row.then}
    for cause, row in reversed(first.items()):
        yield NextStep(Need.TESTABLE, cause_words(cause), printed(row.then))
