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
_MISSING = (_NONE, _NONE)
_LOOKED_AT = {"fail", "warn", "accepted"}
_REQUIRED = {"fails": "fail", "undecided": "warn"}
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
    told: dict[tuple[str, str], dict[int, tuple[str, str]]] = {}
    for place, run in enumerate(found.runs):
        qa = filled(run.tables, "qa")
        for r in () if qa is None else qa.itertuples():
            told.setdefault((r.check, r.subject or ""), {})[place] = _check(r)
    differing = {key: own for key, own in told.items() if _LOOKED_AT & {verdict for verdict, _ in own.values()}}
    rows = [(*key, *(own.get(k, _MISSING)[1] for k in range(len(found.runs)))) for key, own in differing.items()]
    marks = [_mark({verdict for verdict, _ in own.values()}, "fail", "warn", "none") for own in differing.values()]
    labels = tuple(run.label for run in found.runs)
    listings = (
        Listing(("verdict", *labels), tuple(totals), _ORDER, "Checks of each verdict"),
        Listing(("check", "subject", *labels), tuple(rows), tuple(marks), "Checks that call for a look in some run"),
    )
    lead = "Each run's checks, by its own limits; its own page says what each one means."
    return Section("quality", "Quality side by side", lead, listings=tuple(x for x in listings if x.rows))


def _check(r: Any) -> tuple[str, str]:
    """The verdict on a check, accepted where a person did that; and the same with its value."""
    accepted = getattr(r, "accepted", None)
    verdict = "accepted" if isinstance(accepted, str) else str(r.verdict)
    value = quantity(r.value, r.unit)
    return verdict, verdict if value == _NONE else f"{verdict} ({value})"


def _mark(verdicts: set[str], *ranked: str) -> str:
    """The first of ``ranked`` that occurs; the last where none does."""
    return next((mark for mark in ranked if mark in verdicts), ranked[-1])


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
    judged = {f"requirement {c}": [_requirement(table, c) for table in tables] for c in components}
    required = [{_REQUIRED.get(verdict, "pass") for verdict, _ in own} for own in judged.values()]
    marks = ["none"] * len(rows) + [_mark(own, "fail", "warn", "pass") for own in required]
    heads = ("", *(run.label for run in found.runs))
    told = [(name, *(words for _, words in own)) for name, own in judged.items()]
    listing = Listing(heads, (*rows, *told), tuple(marks))
    lead = "By the calibration that each run recommends; a requirement is shown with what 95 of 100 poses stay below."
    return Section("accuracy", "Accuracy and requirements side by side", lead, listings=(listing,))


def _figure(tables: Tables, figure: str) -> float:
    key = chosen_calibration(tables)
    for estimator in ("errors-in-variables", "points"):
        figures = figures_by_calibration(tables, estimator)
        if key is not None and figures is not None and key in figures.index and figure in figures:
            return float(figures.loc[key, figure])
    return float("nan")


def _requirement(table: pd.DataFrame | None, component: str) -> tuple[str, str]:
    """The verdict on a requirement, and the same with what was reached and what was asked for."""
    own = table[table["component"] == component] if table is not None else None
    if own is None or not len(own):
        return _MISSING
    r = own.iloc[0]
    reached = f"{quantity(r['error'], r['unit'])} of {quantity(r['requirement'], r['unit'])}"
    return r["verdict"], f"{r['verdict']}: {reached}"


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
