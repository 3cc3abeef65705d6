"""Top of the page: the sentences that need action, and key figures."""

from __future__ import annotations

from truing.belonging.relation import RelationState
from truing.report.calibration.calibrations import EXTENDED, TO_POINTS, figures_by_calibration, main_calibration
from truing.report.calibration.with_findings import choice_verdicts
from truing.report.diagnosis.words import diagnosis_details
from truing.report.numbers import quantity
from truing.report.page import PageHead, Verdict
from truing.report.section_verdict import SectionVerdict, verdict_rows
from truing.report.tables import Tables, in_channel_order, is_bench, load_steps, signal_names, table_or_none
from truing.report.verdict import with_verdict
from truing.schemas.verdict import CAMPAIGN, ReasonCode

_MODEL_WORDS = {"none": "rms shift", "linear": "rms residual, linear model", "matrix": "rms residual, matrix model"}
_BENCH_WORDS = {
    "none": "rms response",
    "linear": "rms residual, diagonal compliance",
    "matrix": "rms residual, full compliance",
}
_OF_AXES = {"A": "accuracy A", "B": "reversal B"}  # symbols of ISO 230-2
_FEW_AXES = 3
_HELD_OUT = {"position": "um", "orientation": "arcsec"}
# Sections with a line of their own if they pass, and those that share one.
_OWN_LINE = ("diagnosis", "simulation", "positioning", "requirements", "changes", "quality")
_TOGETHER = {
    "belonging": "the data belong together",
    "adequacy": "the residuals of the final model are noise",
    "pulls": "pulls are within tolerances",
    "calibration": "the calibration fits",
}
# Untested sections that need no action.
_SILENT = (ReasonCode.NO_READINGS,)


def build_head(campaign: str, tables: Tables) -> PageHead:
    """Return the sentences of the table ``verdict`` that need action, and key figures."""
    rows = verdict_rows(with_verdict(tables))
    return PageHead(campaign, tuple(_lines(rows, tables)), tuple(_tiles(tables)))


def _lines(rows: dict[str, SectionVerdict], tables: Tables) -> list[Verdict]:
    """Return the campaign's verdict, then sections that need attention, that pass, and that were not tested."""
    if not rows:
        return []
    lead = rows[CAMPAIGN]
    others = [one for name, one in rows.items() if name != CAMPAIGN and one.explanation != lead.explanation]
    lines: list[Verdict] = [(lead.mark, lead.explanation)]
    details = diagnosis_details(tables)
    if lead.explanation == _explanation(rows, "diagnosis"):
        lines += details
    for one in sorted(others, key=lambda one: _URGENCY[one.state]):
        if _has_line(one):
            lines.append((one.mark, one.explanation))
        if one.section == "diagnosis":
            lines += details
    return [*lines, *choice_verdicts(tables), *_passed_sections(others)]


_URGENCY = {RelationState.FAILS: 0, RelationState.ATTENTION: 1, RelationState.OK: 2, RelationState.NOT_TESTED: 3}


def _explanation(rows: dict[str, SectionVerdict], section: str) -> str:
    return rows[section].explanation if section in rows else ""


def _has_line(one: SectionVerdict) -> bool:
    """Return True if a section has a line: every failure, and of the others those that readers look for."""
    if one.state == RelationState.FAILS:
        return True
    if one.state == RelationState.ATTENTION:
        return one.section != "deformation" and one.reason_code != ReasonCode.NOTHING_FOUND
    return one.section in _OWN_LINE and one.reason_code not in _SILENT


def _passed_sections(others: list[SectionVerdict]) -> list[Verdict]:
    named = [_TOGETHER[one.section] for one in others if one.section in _TOGETHER and one.state == RelationState.OK]
    return [("pass", f"Also tested: {', '.join(named)}.")] if named else []


def _tiles(tables: Tables) -> list[tuple[str, str]]:
    tiles = []
    points, residuals = (table_or_none(tables, name) for name in ("observations", "residuals"))
    if points is not None:
        tiles += [("poses", f"{points['pose'].nunique():,}"), ("object points", f"{len(points):,}")]
    tiles += _bench_tiles(tables)
    if residuals is not None:
        out = int(residuals["rejected"].sum())
        tiles.append(("points left out", f"{out:,} ({100 * out / len(residuals):.1f} %)"))
    return tiles + _model_tiles(tables) + _positioning_tiles(tables) + _calibration_tiles(tables)


def _bench_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Return the numbers of runs, load steps, readings and signals."""
    steps, readings, signals = load_steps(tables), table_or_none(tables, "readings"), signal_names(tables)
    if not len(steps):
        return []
    tiles = [("runs", f"{steps['run'].nunique():,}"), ("load steps", f"{len(steps):,}")]
    if readings is not None:
        channels = in_channel_order(readings["channel"].unique())
        tiles += [("readings", f"{len(readings):,}"), ("channels", " ".join(channels))]
    return [*tiles, ("signals", str(len(signals)))] if signals else tiles


def _model_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Return tiles of the movements and the residuals of each model; for a bench, before any model and
    after the best."""
    errors = table_or_none(tables, "deformation_errors")
    if errors is None:
        return []
    subject = errors["subject"] if "subject" in errors else errors["leg"]
    whole = errors[errors["figure"].eq("rms_error") & errors["leg"].isna() & subject.isna()]
    bench = is_bench(tables)
    if bench and len(whole):
        whole = whole[whole["model"].isin([whole["model"].iloc[0], whole["model"].iloc[-1]])]
    named = _BENCH_WORDS if bench else _MODEL_WORDS
    by_model = whole.groupby("model", sort=False)
    return [(named.get(str(m), str(m)), ", ".join(map(quantity, own["value"], own["unit"]))) for m, own in by_model]


def _positioning_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Return accuracy and reversal of the first few positioned axes."""
    rows = table_or_none(tables, "positioning")
    if rows is None:
        return []
    own = rows[rows["subject"].isna() & rows["figure"].isin(list(_OF_AXES))]
    own = own[own["run"].isin(own["run"].unique()[:_FEW_AXES])]
    shown = zip(own["run"], own["figure"], own["value"], own["unit"], strict=True)
    return [(f"{_OF_AXES[figure]}, {run}", quantity(value, unit)) for run, figure, value, unit in shown]


def _calibration_tiles(tables: Tables) -> list[tuple[str, str]]:
    """Return the mean error of the chosen model at held-out poses."""
    chosen = main_calibration(tables)
    by = {"estimator": TO_POINTS} if chosen is not None and chosen[0] == EXTENDED else {}
    figures = figures_by_calibration(tables, **by)
    if figures is None or chosen is None:
        return []
    facts = figures.loc[chosen]
    sizes = [(facts.get(f"{what}_mean_verification"), unit) for what, unit in _HELD_OUT.items()]
    texts = [quantity(size, unit) for size, unit in sizes if size is not None and size == size]
    return [("held-out error, calibrated", ", ".join(texts))] if texts else []
