"""Section of an axis' positioning by ISO 230-2."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.arrays import Array
from truing.belonging.relation import RelationState
from truing.report.axis_page import ENCODERS
from truing.report.column_heads import RUN, Head
from truing.report.figure_style import BLUE, ORANGE, label, style
from truing.report.measured_loads import corrections
from truing.report.numbers import count_text, in_suitable_unit, printed, sign, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, is_single_axis, load_steps, reason, table_or_none
from truing.schemas.verdict import ReasonCode

_MEANING = {
    "A": "accuracy, both directions",
    "E": "systematic deviation, both directions",
    "M": "mean deviation, both directions",
    "R": "repeatability, both directions",
    "B": "reversal",
}
_DIRECTIONS = (("forward", BLUE, "triangle-right"), ("backward", ORANGE, "triangle-left"))
_IN_VERDICT = {"A": "accuracy A", "R": "repeatability R", "B": "reversal B"}
_MOST_COMMON = 10.0  # common deviation over the range of the deviations
_RUNS_DRAWN = 6  # most runs in figures
_COLUMNS = ["run", "figure", "subject", "value", "sigma", "low", "high", "unit"]
_AT_TARGETS = {
    "mean forward": "Mean deviation from the target, approached in the forward direction.",
    "mean backward": "Mean deviation from the target, approached in the backward direction.",
    "B": "Reversal: mean deviation of the forward minus the backward approach.",
    "s forward": "Standard deviation of the position, approached in the forward direction.",
    "s backward": "Standard deviation of the position, approached in the backward direction.",
    "R": "Repeatability of the position at this target, over both directions.",
}
_CYCLES = 5  # repeats of the standard
_PLAN = "Send the axis to five targets or more, five times from each side, and let it rest at each."
_OF_MAXIMA = (
    "Quantities of the axis. The largest of several noisy values is too large on average, so a 95 % interval may lie "
    "below its value"
)
_SIDES = {"forward": "↑", "backward": "↓"}
_CAPTION = "A gap between the two lines is reversal: the position depends on the direction of approach."


def positioning(tables: Tables) -> ReportSection | None:
    """Return the results of ISO 230-2 for every run, the axis first, then by target; and reasons where
    there are none."""
    rows, withheld = table_or_none(tables, "positioning"), not_stated(tables)
    if is_single_axis(tables):
        return _of_single_axis(rows, reason(tables, "positioning"))
    if rows is None:
        return (
            ReportSection("positioning", "Positioning", " ".join(withheld), state="not evaluated") if withheld else None
        )
    axis, targets = rows[rows["subject"].isna()], rows[rows["subject"].notna()]
    lead = "By ISO 230-2, targets approached from either side. A deviation common to all targets has no effect."
    listings = (_of_axis(axis), corrections(tables, of_axis=True), _of_targets(targets))
    shown = tuple(listing for listing in listings if listing.rows)
    drawn = tuple((deviations(drawn_run), _CAPTION) for drawn_run in _drawn_runs(targets))
    statements = tuple(("fail", why) for why in withheld)
    return ReportSection("positioning", "Positioning", lead, figures=drawn, listings=shown, statements=statements)


def _of_single_axis(rows: pd.DataFrame | None, why_not: str) -> ReportSection:
    """Return the results of an axis by instrument, and those that need more repeats; or why there are none."""
    if rows is None:
        why = why_not or "Fewer than two commands were approached from both sides."
        text = f"Positioning by ISO 230-2 is not tested: {why[:1].lower()}{why[1:]} {_PLAN}"
        return ReportSection("positioning", "Positioning", text, state="not evaluated")
    rows = rows.assign(run=rows["run"].map(lambda name: ENCODERS[name]))
    rows = rows.reindex(columns=[*_COLUMNS, *rows.columns.difference(_COLUMNS)])
    axis, targets = rows[rows["subject"].isna()], rows[rows["subject"].notna()]
    lead = "By ISO 230-2, from commands that were repeated. A deviation common to all targets has no effect."
    if (axis["run"] != ENCODERS["measured"]).any():
        lead += " The standard asks for an outside instrument; results of an encoder contain its own errors."
    fewest = int(rows.loc[rows["figure"].isin(["n_forward", "n_backward"]), "value"].min())
    few = f"{count_text(fewest, 'reading')} of a target from one side"
    statements: tuple[tuple[str, str], ...] = ()
    if "R" not in set(axis["figure"]):
        statements = (("warn", f"R and A are not computed: they need a scatter, and there is {few}. {_PLAN}"),)
    elif fewest < _CYCLES:
        statements = (("warn", f"Only {few}; ISO 230-2 asks for {_CYCLES}: R and A are uncertain. {_PLAN}"),)
    drawn = tuple((deviations(drawn_run), _CAPTION) for drawn_run in _drawn_runs(targets))
    listings = _of_axis(axis), _of_targets(targets)
    return ReportSection("positioning", "Positioning", lead, figures=drawn, listings=listings, statements=statements)


def positioning_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict of a campaign of positioning alone: accuracy, repeatability and reversal of its worst axis."""
    rows = table_or_none(tables, "positioning")
    if rows is None or is_single_axis(tables):
        return None
    if len(load_steps(tables)) or table_or_none(tables, "observations") is not None:
        return None
    axis = rows[rows["subject"].isna() & rows["figure"].isin(list(_IN_VERDICT))]
    worst = axis[axis["figure"].eq("A")].nlargest(1, "value")["run"]
    figures = axis[axis["run"].isin(worst)].set_index("figure")
    if not len(figures):
        return None
    sigma = figures["sigma"] if "sigma" in figures else figures["value"] * math.nan
    texts = [
        f"{words} {in_suitable_unit(float(figures.value[name]), float(sigma[name]), str(figures.unit[name]))}"
        for name, words in _IN_VERDICT.items()
        if name in figures.index
    ]
    several = rows["run"].nunique()
    withheld = len(not_stated(tables))
    also = f" Not evaluated: {count_text(withheld, 'further run')} (see Positioning)." if withheld else ""
    name = f"run {worst.iloc[0]}" if str(worst.iloc[0]).isdigit() else str(worst.iloc[0])
    run_text = f"the worst of {several} runs, {name}" if several > 1 else name
    text = printed(f"By ISO 230-2, {run_text}: {', '.join(texts)}, each with one standard deviation.{also}")
    size, unit = float(figures.loc["A", "value"]), str(figures.loc["A", "unit"])
    return SectionVerdict("positioning", RelationState.OK, ReasonCode.MEASURED, text, size, unit)


def not_stated(tables: Tables) -> list[str]:
    """Return a sentence for every measured run without results: the check that it failed."""
    measured, rows, qa = (table_or_none(tables, name) for name in ("positions", "positioning", "qa"))
    if measured is None or "positioning" not in tables:
        return []
    stated = set() if rows is None else set(rows["run"])
    return [_not_stated(run, qa) for run in dict.fromkeys(measured["run"]) if run not in stated]


def _not_stated(run: int | str, qa: pd.DataFrame | None) -> str:
    if qa is None:
        return f"Run {run} is not evaluated: its quality was not checked."
    failed = qa[qa["subject"].eq(f"run {run}") & qa["verdict"].eq("fail")]["message"]
    return f"Run {run} is not evaluated: {failed.iloc[0] if len(failed) else 'it failed a check of its quality.'}"


def _drawn_runs(rows: pd.DataFrame) -> list[pd.DataFrame]:
    return [group for _, group in rows.groupby("run", sort=False)][:_RUNS_DRAWN]


def deviations(rows: pd.DataFrame) -> go.Figure:
    """Return the mean deviation at each target of one run, from either side, with twice its scatter, um over mm."""
    unit, at = sign(str(rows["unit"].iloc[0])), str(rows["subject"].iloc[0]).partition(" ")[2]
    wide = rows.pivot(index="subject", columns="figure", values="value")
    wide = wide.set_index(wide.index.str.partition(" ").get_level_values(0).astype(float)).sort_index()
    means = {direction: wide[f"mean_{direction}"].to_numpy() for direction, *_ in _DIRECTIONS}
    common = _common(np.concatenate(list(means.values())))
    figure = go.Figure()
    for direction, colour, symbol in _DIRECTIONS:
        figure.add_trace(
            go.Scatter(
                x=wide.index.to_numpy(),
                y=means[direction] - common,
                error_y={"array": 2.0 * _column(wide, f"s_{direction}").to_numpy(), "thickness": 1},
                mode="lines+markers",
                name=direction,
                marker={"color": colour, "symbol": symbol, "size": 9},
                line={"color": colour},
                hovertemplate=f"{direction}, %{{x:.6g}} {at}: %{{y:.3g}} {unit}<extra></extra>",
            )
        )
    run = label(rows["run"].iloc[0])
    less = f", less {common:.6g} {unit} that all targets share" if common else ""
    words = f"Mean of the cycles{less}; bars are twice their standard deviation"
    style(figure, f"Deviation at the targets, {run}", words, 380)
    figure.update_xaxes(title_text=f"target ({at})")
    figure.update_yaxes(title_text=f"deviation ({unit})")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 110})
    return figure


def _common(means: Array) -> float:
    """Return the deviation that all targets share, where it would hide their differences; else 0."""
    known = means[np.isfinite(means)]
    if not len(known):
        return 0.0
    return float(f"{known.mean():.6g}") if abs(known.mean()) > _MOST_COMMON * np.ptp(known) else 0.0


def _of_axis(rows: pd.DataFrame) -> Listing:
    reported = tuple(
        (
            str(r.run),
            _symbol(str(r.figure)),
            _MEANING.get(r.figure, r.figure.replace("_", ", ")),
            with_uncertainty(r.value, r.sigma) if r.sigma == r.sigma else f"{r.value:.3g}",
            f"{r.low:.3g} to {r.high:.3g}" if r.low == r.low else "",
        )
        for r in rows.itertuples()
    )
    unit = sign(str(rows["unit"].iloc[0])) if len(rows) else "µm"
    heads = (
        RUN,
        Head("symbol", "Symbol of the quantity in ISO 230-2."),
        Head("what", "Name of the quantity."),
        Head(f"value, {unit}", "Estimate, with one standard deviation where it is known."),
        Head(f"95 %, {unit}", "Interval that holds the true value with 95 % confidence."),
    )
    outside = ((rows["value"] < rows["low"]) | (rows["value"] > rows["high"])).any()
    return Listing(heads, reported, caption=_OF_MAXIMA if outside else "", held_by="positioning.parquet")


def _symbol(figure: str) -> str:
    """Return the standard's symbol of a quantity: ``R↑`` of ``R_forward``."""
    name, _, side = figure.partition("_")
    return f"{name}{_SIDES[side]}" if side in _SIDES else figure


def _column(wide: pd.DataFrame, figure: str) -> pd.Series:
    """Return a quantity of the targets, NaN where it was not computed."""
    return wide[figure] if figure in wide else pd.Series(math.nan, wide.index)


def _of_targets(rows: pd.DataFrame) -> Listing:
    """Return the quantities of every target; mean deviations without a large part that all targets of a run share."""
    wide = rows.pivot(index=["run", "subject"], columns="figure", values="value")
    order = rows.drop_duplicates(["run", "subject"])[["run", "subject"]]
    heads = ("mean_forward", "mean_backward", "B", "s_forward", "s_backward", "R")
    unit = sign(str(rows["unit"].iloc[0])) if len(rows) else "µm"
    common = {run: _common(of_run.to_numpy().ravel()) for run, of_run in wide.groupby("run")[list(heads[:2])]}
    shared = [f"{size:.6g} {unit} ({run})" for run, size in common.items() if size]
    for head in heads[:2]:
        wide[head] -= wide.index.get_level_values("run").map(common)
    reported = tuple(
        (str(run), subject, *(_cell(_column(wide, head).loc[(run, subject)]) for head in heads))
        for run, subject in order.itertuples(index=False)
    )
    shown = (
        RUN,
        Head("target", "Commanded position of the axis."),
        *(Head(f"{quantity}, {unit}", words) for quantity, words in _AT_TARGETS.items()),
    )
    less = f"; means are less {', '.join(shared)}, which all targets share" if shared else ""
    return Listing(
        shown, reported, caption=f"Target by target{less}", folded=len(reported) > 12, held_by="positioning.parquet"
    )


def _cell(value: float) -> str:
    return f"{value:.3g}" if value == value else "–"
