"""The section of the requirements: whether the calibrated mechanism is as accurate as was asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.report.calibration.calibrations import Key, called, chosen_calibration, rows_of, shown_calibration
from truing.report.calibration.requirement_figure import requirement_bars
from truing.report.numbers import count, in_one_unit, plain
from truing.report.page import Listing, Section
from truing.report.reasons import why_no_requirement
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

_TITLE = "Requirements"
_MARKS = {"meets": "pass", "fails": "fail", "undecided": "warn"}
_COMPONENTS = {"rx": "tilt about x", "ry": "tilt about y", "rz": "turn about z"}
_HEADS = ("component", "required", "95 of 100 poses below", "interval (95 %)", "in parts of the limit")


def requirements(tables: Tables) -> Section | None:
    """Each component with its limit, its error, the interval of that error, and the verdict."""
    if "requirements" not in tables:
        return None
    judged = filled(tables, "requirements")
    if judged is None:
        return Section("requirements", _TITLE, why_no_requirement(tables), state="not evaluated")
    key = shown_calibration(tables, judged)
    own = rows_of(judged, key)
    figures = []
    if own["error"].notna().any() and own["requirement"].notna().any():
        words = "An interval that crosses the limit leaves it undecided: more or better poses would decide."
        figures.append((requirement_bars(own, key), words))
    listings = [_judged(own, key)]
    others = judged.drop(index=own.index)
    if len(others):
        listings.append(_others(others))
    verdicts = set(own["verdict"])
    state = "fail" if "fails" in verdicts else "pass" if verdicts == {"meets"} else "not evaluated"
    state = "undecided" if state == "not evaluated" and "undecided" in verdicts else state
    return Section("requirements", _TITLE, _lead(own, key), tuple(figures), tuple(listings), state)


def _lead(own: pd.DataFrame, key: Key) -> str:
    said = f"{tally(own)}, predicted by {called(key)}."
    return " ".join([said, *(_open_or_failed(r) for r in own.itertuples() if r.verdict in ("fails", "undecided"))])


def _open_or_failed(r: Any) -> str:
    """One requirement that is not met, or undecided, with its numbers."""
    what, asked, error, interval, _ = _sizes(r)
    words = "not met" if r.verdict == "fails" else "undecided"
    return f"{what}: 95 of 100 poses stay below {error} (95 % interval: {interval}), asked for {asked}: {words}."


def tally(own: pd.DataFrame) -> str:
    """``2 of 5 requirements met, 1 failed, 2 undecided``."""
    judged = own[own["verdict"] != "not evaluated"]
    counts = judged["verdict"].value_counts()
    if not len(judged):
        return f"None of {count(len(own), 'requirement')} could be evaluated"
    said = f"{counts.get('meets', 0)} of {count(len(judged), 'requirement')} met"
    words = {"fails": "not met", "undecided": "undecided"}
    return ", ".join([said, *(f"{counts[v]} {word}" for v, word in words.items() if v in counts)])


def chosen_requirements(tables: Tables) -> pd.DataFrame | None:
    """The requirements as judged with the chosen calibration; None where none was judged."""
    judged = filled(tables, "requirements")
    if judged is None:
        return None
    key = chosen_calibration(tables)
    own = rows_of(judged, key) if key is not None else judged.iloc[:0]
    own = own[own["verdict"] != "not evaluated"]
    return own if len(own) else None


def _judged(own: pd.DataFrame, key: Key) -> Listing:
    idle = own["verdict"] == "not evaluated"
    if idle.any() and "message" in own:
        remarks: list[tuple[str, ...]] = [(cell(message),) for message in own["message"].where(idle, "")]
        heads: tuple[str, ...] = ("verdict", *_HEADS, "why")
    else:
        remarks, heads = [()] * len(own), ("verdict", *_HEADS)
    rows = tuple((r.verdict, *_sizes(r), *remark) for r, remark in zip(own.itertuples(), remarks, strict=True))
    return Listing(heads, rows, _marks(own), f"With {called(key)}", held_by="requirements.parquet")


def _others(others: pd.DataFrame) -> Listing:
    rows = tuple((r.verdict, r.model, r.deformation, *_sizes(r)) for r in others.itertuples())
    heads = ("verdict", "model", "deformation", *_HEADS)
    return Listing(heads, rows, _marks(others), "With every other calibration", True, "requirements.parquet")


def _marks(own: pd.DataFrame) -> tuple[str, ...]:
    return tuple(_MARKS.get(verdict, "none") for verdict in own["verdict"])


def _sizes(r: Any) -> tuple[str, ...]:
    asked, error, lower, upper = in_one_unit([r.requirement, r.error, r.lower, r.upper], cell(r.unit))
    interval = "–" if "–" in (lower, upper) else f"{lower} to {upper}"
    return _COMPONENTS.get(r.component, r.component), asked, error, interval, plain(r.error / r.requirement)
