"""Verdicts of several runs side by side: quality, requirements, accuracy, and the error classes of a sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.report.calibration.calibrations import called as calibration_words
from truing.report.calibration.calibrations import chosen_calibration, figures_by_calibration
from truing.report.calibration.requirement_section import chosen_requirements, tally
from truing.report.comparison.compared_runs import Comparison
from truing.report.numbers import plain, quantity, sign, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_NONE = "–"
_ORDER = ("fail", "warn", "not evaluated", "pass")
_ACCURACY = {
    "position_mean_verification": ("position error, mean of held-out poses", "um"),
    "position_max_verification": ("position error, largest of held-out poses", "um"),
    "orientation_mean_verification": ("orientation error, mean of held-out poses", "arcsec"),
    "position_mean_calibration": ("position error, mean of fitted poses", "um"),
    "orientation_mean_calibration": ("orientation error, mean of fitted poses", "arcsec"),
}


def quality_words(found: Comparison) -> list[tuple[str, str]]:
    """How the checks of quality went in each run."""
    counts = [_counts(run.tables) for run in found.runs]
    bad = [f"{run.label} ({own['fail']})" for run, own in zip(found.runs, counts, strict=True) if own["fail"]]
    looks = [f"{run.label} ({own['warn']})" for run, own in zip(found.runs, counts, strict=True) if own["warn"]]
    said = []
    if bad:
        said.append(("fail", f"Quality checks failed in {', '.join(bad)}: look there before believing a change."))
    if looks:
        said.append(("warn", f"Quality checks that call for a look: {', '.join(looks)}."))
    return said or [("pass", "No quality check failed or calls for a look in any run.")]


def _counts(tables: Tables) -> dict[str, int]:
    """How many checks of each verdict that nobody has accepted."""
    qa = filled(tables, "qa")
    if qa is None:
        return dict.fromkeys(_ORDER, 0)
    own = qa[qa["accepted"].isna()] if "accepted" in qa else qa
    return {verdict: int((own["verdict"] == verdict).sum()) for verdict in _ORDER}


def quality(found: Comparison) -> Section:
    """How many checks of each verdict, and every check that was not passed in each of the runs."""
    counts = [_counts(run.tables) for run in found.runs]
    totals = [(verdict, *(str(own[verdict]) for own in counts)) for verdict in _ORDER]
    told: dict[tuple[str, str], dict[int, str]] = {}
    for place, run in enumerate(found.runs):
        qa = filled(run.tables, "qa")
        for r in () if qa is None else qa.itertuples():
            told.setdefault((r.check, r.subject or ""), {})[place] = _check(r)
    differing = {
        key: own for key, own in told.items() if any(w.startswith(("fail", "warn", "accepted")) for w in own.values())
    }
    rows = [(*key, *(own.get(k, _NONE) for k in range(len(found.runs)))) for key, own in differing.items()]
    marks = [_mark(row[2:]) for row in rows]
    labels = tuple(run.label for run in found.runs)
    listings = (
        Listing(("verdict", *labels), tuple(totals), _ORDER, "Checks of each verdict"),
        Listing(("check", "subject", *labels), tuple(rows), tuple(marks), "Checks that call for a look in some run"),
    )
    lead = "Each run's checks, by its own limits; its own page says what each one means."
    return Section("quality", "Quality side by side", lead, listings=tuple(x for x in listings if x.rows))


def _check(r: Any) -> str:
    accepted = getattr(r, "accepted", None)
    verdict = "accepted" if isinstance(accepted, str) else r.verdict
    value = quantity(r.value, r.unit)
    return verdict if value == _NONE else f"{verdict} ({value})"


def _mark(cells: tuple[str, ...]) -> str:
    return next((mark for mark in ("fail", "warn") if any(told.startswith(mark) for told in cells)), "none")


def requirement_words(found: Comparison) -> list[tuple[str, str]]:
    """How many requirements each run met; nothing where none has any."""
    own = [(run.label, chosen_requirements(run.tables)) for run in found.runs]
    known = [(label, table) for label, table in own if table is not None and len(table)]
    if not known:
        return []
    failed = any((table["verdict"] == "fails").any() for _, table in known)
    open_ = any((table["verdict"] == "undecided").any() for _, table in known)
    said = "; ".join(f"{label}: {tally(table)}" for label, table in known)
    return [("fail" if failed else "warn" if open_ else "pass", f"{said}.")]


def accuracy(found: Comparison) -> Section | None:
    """The calibration that each run chose, how accurate it is, and whether that is what was asked for."""
    keys = [chosen_calibration(run.tables) for run in found.runs]
    if all(key is None for key in keys):
        return None
    rows = [("chosen calibration", *(calibration_words(key) if key else _NONE for key in keys))]
    for figure, (words, unit) in _ACCURACY.items():
        values = [_figure(run.tables, figure) for run in found.runs]
        if any(value == value for value in values):
            rows.append((words, *(f"{plain(value)} {sign(unit)}" if value == value else _NONE for value in values)))
    tables = [chosen_requirements(run.tables) for run in found.runs]
    components = dict.fromkeys(c for table in tables if table is not None for c in table["component"])
    judged = [(f"requirement {c}", *(_requirement(table, c) for table in tables)) for c in components]
    marks = ["none"] * len(rows) + [_required(row[1:]) for row in judged]
    heads = ("", *(run.label for run in found.runs))
    listing = Listing(heads, (*rows, *judged), tuple(marks))
    lead = "By the calibration that each run recommends; a requirement is shown with what 95 of 100 poses stay below."
    return Section("accuracy", "Accuracy and requirements side by side", lead, listings=(listing,))


def _figure(tables: Tables, figure: str) -> float:
    key = chosen_calibration(tables)
    for estimator in ("errors-in-variables", "points"):
        figures = figures_by_calibration(tables, estimator)
        if key is not None and figures is not None and key in figures.index and figure in figures:
            return float(figures.loc[key, figure])
    return float("nan")


def _requirement(table: pd.DataFrame | None, component: str) -> str:
    own = table[table["component"] == component] if table is not None else None
    if own is None or not len(own):
        return _NONE
    r = own.iloc[0]
    return f"{r['verdict']}: {quantity(r['error'], r['unit'])} of {quantity(r['requirement'], r['unit'])}"


def _required(cells: tuple[str, ...]) -> str:
    if any(told.startswith("fails") for told in cells):
        return "fail"
    return "warn" if any(told.startswith("undecided") for told in cells) else "pass"


def error_classes(found: Comparison) -> Section | None:
    """A sensor's errors as laboratories report them, per axis; crosstalk by the component that it shows most in."""
    tables = [filled(run.tables, "error_classes") for run in found.runs]
    if all(table is None for table in tables):
        return None
    worst = [{} if table is None else _worst(table) for table in tables]
    keys = dict.fromkeys(key for own in worst for key in own)
    rows = [(*key, *(own.get(key, _NONE) for own in worst)) for key in keys]
    heads = ("error", "load", *(run.label for run in found.runs))
    lead = "The largest of each class and load, in per cent of the full load, with one standard deviation."
    return Section("errors", "Error classes side by side", lead, listings=(Listing(heads, tuple(rows)),))


def _worst(table: pd.DataFrame) -> dict[tuple[str, str], str]:
    told = table.dropna(subset=["value"])
    largest = told.loc[told.groupby(["error_class", "load"], sort=False)["value"].idxmax()]
    return {
        (r.error_class, r.load): with_uncertainty(r.value, r.sigma, sign(r.unit))
        + (f" in {r.indicated}" if r.indicated != r.load else "")
        for r in largest.itertuples()
    }
