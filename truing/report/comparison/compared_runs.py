"""Data of the comparison page: runs with their tables, numbers, and verdicts."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from truing.report.calibration.calibrations import calibration_name as calibration_words
from truing.report.calibration.calibrations import figures_by_calibration, main_calibration
from truing.report.calibration.requirements import chosen_requirements, main_requirements, tally
from truing.report.column_heads import LOAD, Head, schema_head
from truing.report.diagnosis.effect_units import handy_unit
from truing.report.numbers import plain, printed, quantity, sign, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.parameter_names import name_of, print_unit
from truing.report.tables import Row, Tables, cell, table_or_none

_COMPLIANCE = {"m/N": (1e9, "nm/N"), "m/(N m)": (1e9, "nm/(N·m)"), "rad/N": (1e9, "nrad/N")}
_COMPLIANCE |= {"rad/(N m)": (1e9, "nrad/(N·m)")}

_NONE = "–"
_MISSING = (_NONE, _NONE)
_VERDICT = Head("verdict", "Result of a check: pass, warn, fail or not evaluated; accepted ones are not counted.")
_SUBJECT = Head("subject", "Body, target, channel or run that the row concerns; a dash for the whole campaign.")
_ERROR = Head("class", "Name of the error in laboratory terms.")
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


@dataclass(frozen=True)
class ComparedRun:
    """One run on the page: its label, folder, software version, and its tables by artifact name."""

    label: str
    folder: str
    version: str
    tables: Tables


@dataclass(frozen=True)
class RunTransition:
    """Step from one run to the next: reasons for numbers not assessed, and whether too many numbers changed to name
    them."""

    why: tuple[str, ...]
    rebuilt: bool


@dataclass(frozen=True)
class RunComparison:
    """Runs in order, compared.parquet as a frame, and the steps between neighbours."""

    runs: tuple[ComparedRun, ...]
    numbers: pd.DataFrame
    between: tuple[RunTransition, ...]

    def assessed(self, step: int) -> pd.DataFrame:
        """Return the assessed numbers of the run after a step (0 is from the first run to the second)."""
        rows = self.numbers[self.numbers["place"] == step + 2]
        return rows[rows["z"].notna() | rows["changed"]]

    def heads(self, meaning: str) -> tuple[Head, ...]:
        """Return a head per run, its label, with the content of a cell of its column: one sentence."""
        return tuple(Head(run.label, meaning) for run in self.runs)

    def pair(self, step: int) -> str:
        """Return the name of a step: ``first → second``."""
        return f"{self.runs[step].label} → {self.runs[step + 1].label}"


def number_name(row: Row) -> str:
    """Return the name of a number in a sentence, with its effect or matrix."""
    if row.group in ("compliance", "G_B"):
        return f"{row.group} {row.parameter}"
    leg = row.leg if row.leg is not None else float("nan")
    return (
        f"{name_of(row.parameter, leg)} of {cell(row.effect_of)}"
        if row.group == "effect"
        else name_of(row.parameter, leg)
    )


def unit_of(row: Row, size: float) -> tuple[float, str]:
    """Return factor and unit in which a number of about this size is shown."""
    if row.group == "compliance":
        return _COMPLIANCE.get(row.unit, (1.0, row.unit))
    if row.group == "effect" or row.unit == "rad":
        factor, unit = handy_unit(row.parameter, row.unit, size)
        return factor, printed(unit)
    return print_unit(row.parameter, row.unit)


def value_text(row: Row) -> str:
    """Return a number with its sigma, in a suitable unit."""
    factor, unit = unit_of(row, max(abs(row.value), row.sigma if row.sigma == row.sigma else 0.0))
    return with_uncertainty(factor * row.value, factor * row.sigma, unit)


def change_text(row: Row) -> str:
    """Return the size of a change; for significant changes, under the assumption that no other number changed."""
    change, sigma = (
        (row.change, row.sigma_change) if row.change == row.change else (row.difference, row.sigma_difference)
    )
    factor, unit = unit_of(row, max(abs(change), sigma))
    if unit == "mm" and abs(factor * change) < 1.0:
        factor, unit = 1e3 * factor, "µm"
    return with_uncertainty(factor * change, factor * sigma, unit)


def quality_words(comparison: RunComparison) -> list[tuple[str, str]]:
    """Return the results of the quality checks of each run in words."""
    counts = [_counts(run.tables) for run in comparison.runs]
    bad = [
        f"{run.label} ({count['fail']})" for run, count in zip(comparison.runs, counts, strict=True) if count["fail"]
    ]
    looks = [
        f"{run.label} ({count['warn']})" for run, count in zip(comparison.runs, counts, strict=True) if count["warn"]
    ]
    texts = []
    if bad:
        texts.append(("fail", f"Quality checks failed in {', '.join(bad)}: check these before trusting a change."))
    if looks:
        texts.append(("warn", f"Quality checks with a warning: {', '.join(looks)}."))
    return texts or [("pass", "No quality check failed or gave a warning in any run.")]


def _counts(tables: Tables) -> dict[str, int]:
    """Return the number of checks by verdict, without accepted ones."""
    qa = table_or_none(tables, "qa")
    if qa is None:
        return dict.fromkeys(_ORDER, 0)
    rows = qa[qa["accepted"].isna()] if "accepted" in qa else qa
    return {verdict: int((rows["verdict"] == verdict).sum()) for verdict in _ORDER}


def quality(comparison: RunComparison) -> ReportSection:
    """Return the number of checks by verdict, and every check that did not pass in all runs."""
    counts = [_counts(run.tables) for run in comparison.runs]
    totals = [(verdict, *(str(count[verdict]) for count in counts)) for verdict in _ORDER]
    checks: dict[tuple[str, str], dict[int, tuple[str, str]]] = {}
    for index, run in enumerate(comparison.runs):
        qa = table_or_none(run.tables, "qa")
        for r in () if qa is None else qa.itertuples():
            checks.setdefault((r.check, r.subject or ""), {})[index] = _check(r)
    differing = {key: check for key, check in checks.items() if _LOOKED_AT & {verdict for verdict, _ in check.values()}}
    rows = [
        (*key, *(cells.get(k, _MISSING)[1] for k in range(len(comparison.runs)))) for key, cells in differing.items()
    ]
    marks = [_mark({verdict for verdict, _ in cells.values()}, "fail", "warn", "none") for cells in differing.values()]
    listings = (
        Listing(
            (_VERDICT, *comparison.heads("Number of checks of this run with the verdict of the row.")),
            tuple(totals),
            _ORDER,
            "Checks of each verdict",
        ),
        Listing(
            (schema_head("check"), _SUBJECT, *comparison.heads("Verdict on the check in this run, with its value.")),
            tuple(rows),
            tuple(marks),
            "Checks with a warning in some run",
        ),
    )
    lead = "Checks of each run by its own limits; the page of each run explains them."
    return ReportSection("quality", "Quality side by side", lead, listings=tuple(x for x in listings if x.rows))


def _check(r: Row) -> tuple[str, str]:
    """Return the verdict on a check, or accepted; and the same with its value."""
    accepted = getattr(r, "accepted", None)
    verdict = "accepted" if isinstance(accepted, str) else str(r.verdict)
    value = quantity(r.value, r.unit)
    return verdict, verdict if value == _NONE else f"{verdict} ({value})"


def _mark(verdicts: set[str], *ranked: str) -> str:
    """Return the first element of ``ranked`` among the verdicts; the last one where there is none."""
    return next((mark for mark in ranked if mark in verdicts), ranked[-1])


def requirement_words(comparison: RunComparison) -> list[tuple[str, str]]:
    """Return the number of requirements met by each run; empty where none has any."""
    requirements = [(run.label, main_requirements(run.tables)) for run in comparison.runs]
    known = [(label, table) for label, table in requirements if len(table)]
    verdicts = {verdict for _, table in known for verdict in table["verdict"]}
    if not verdicts - {"not evaluated"}:
        return []
    text = "; ".join(f"{label}: {tally(table)}" for label, table in known)
    return [("fail" if "fails" in verdicts else "pass" if verdicts == {"meets"} else "warn", f"{text}.")]


def accuracy(comparison: RunComparison) -> ReportSection | None:
    """Return the calibration chosen by each run, its accuracy, and its requirements."""
    keys = [main_calibration(run.tables) for run in comparison.runs]
    if all(key is None for key in keys):
        return None
    rows = [("chosen calibration", *(calibration_words(key) if key else _NONE for key in keys))]
    for figure, (words, unit) in _ACCURACY.items():
        values = [_figure(run.tables, figure) for run in comparison.runs]
        if any(value == value for value in values):
            rows.append((words, *(f"{plain(value)} {sign(unit)}" if value == value else _NONE for value in values)))
    tables = [chosen_requirements(run.tables) for run in comparison.runs]
    components = dict.fromkeys(c for table in tables if table is not None for c in table["component"])
    assessed = {f"requirement {c}": [_requirement(table, c) for table in tables] for c in components}
    required = [{_REQUIRED.get(verdict, "pass") for verdict, _ in row} for row in assessed.values()]
    marks = ["none"] * len(rows) + [_mark(cells, "fail", "warn", "pass") for cells in required]
    heads = ("", *comparison.heads("Result of this run in the quantity of the row."))
    chosen = [(name, *(words for _, words in cells)) for name, cells in assessed.items()]
    listing = Listing(heads, (*rows, *chosen), tuple(marks))
    lead = "By the calibration that each run recommends; a requirement is shown with what 95 of 100 poses stay below."
    return ReportSection("accuracy", "Accuracy and requirements side by side", lead, listings=(listing,))


def _figure(tables: Tables, figure: str) -> float:
    key = main_calibration(tables)
    for estimator in ("errors-in-variables", "points"):
        figures = figures_by_calibration(tables, estimator)
        if key is not None and figures is not None and key in figures.index and figure in figures:
            return float(figures.loc[key, figure])
    return float("nan")


def _requirement(table: pd.DataFrame | None, component: str) -> tuple[str, str]:
    """Return the verdict on a requirement, and the same with error and limit."""
    rows = table[table["component"] == component] if table is not None else None
    if rows is None or not len(rows):
        return _MISSING
    r = rows.iloc[0]
    reached = f"{quantity(r['error'], r['unit'])} of {quantity(r['requirement'], r['unit'])}"
    return r["verdict"], f"{r['verdict']}: {reached}"


def error_classes(comparison: RunComparison) -> ReportSection | None:
    """Return the errors of a sensor as laboratories report them, per axis; crosstalk by the most affected component."""
    tables = [table_or_none(run.tables, "error_classes") for run in comparison.runs]
    if all(table is None for table in tables):
        return None
    worst = [{} if table is None else _worst(table) for table in tables]
    keys = dict.fromkeys(key for of_run in worst for key in of_run)
    rows = [(*key, *(of_run.get(key, _NONE) for of_run in worst)) for key in keys]
    heads = (_ERROR, LOAD, *comparison.heads("Largest error of this class in this run, in per cent of the full load."))
    lead = "The largest of each class and load, in per cent of the full load, with one standard deviation."
    return ReportSection("errors", "Error classes side by side", lead, listings=(Listing(heads, tuple(rows)),))


def _worst(table: pd.DataFrame) -> dict[tuple[str, str], str]:
    sized = table.dropna(subset=["value"])
    largest = sized.loc[sized.groupby(["error_class", "load"], sort=False)["value"].idxmax()]
    return {
        (r.error_class, r.load): with_uncertainty(r.value, r.sigma, sign(r.unit))
        + (f" in {r.indicated}" if r.indicated != r.load else "")
        for r in largest.itertuples()
    }
