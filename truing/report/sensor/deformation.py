"""Section of a loaded platform's deformation: curves of load and displacement, measured and simulated compliance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from truing.belonging.relation import RelationState
from truing.report.column_heads import FIGURE, LOAD, UNIT, VALUE, Head
from truing.report.comparison_map import ComparedEntries, comparison_map
from truing.report.deformation_section import compliance_map
from truing.report.error_figures import error_figure_words
from truing.report.figure_style import BAR, BLUE, GREY, ORANGE, RED, panel_grid, style
from truing.report.model_tests import CONTRADICTED, REJECTED, ModelTest, by_p, listing_of
from truing.report.numbers import count_text, p_equals, p_value, plain, printed, quantity, with_uncertainty
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.scene.by_leg import by_leg_of_sensor
from truing.report.scene.scenes import load_scene
from truing.report.scene.view import picture
from truing.report.section_verdict import SectionVerdict
from truing.report.sensor.published import (
    published_listing,
    published_pairs,
    published_sentence,
    published_traces,
)
from truing.report.tables import CHANNELS, LOADS, Tables, cell, kilo, moved_unit, per_kilo, reason, table_or_none
from truing.schemas.verdict import ReasonCode

_UNCLEAR = 0.01

_BRANCHES = {"loading": ("triangle-up", BLUE), "unloading": ("triangle-down-open", RED), "unloaded": ("circle", GREY)}
_BAND = "rgba(230,159,0,0.25)"
_MANY = 400  # from this number of cases on, a panel has no error bars


def deformation(tables: Tables) -> ReportSection | None:
    """Return the section with curves of load and displacement, compliance by entry, and the models' errors."""
    if "compliance" not in tables:
        return None
    compliance = table_or_none(tables, "compliance")
    if compliance is None:
        why = reason(tables, "compliance") or "The campaign holds no readings of a platform under load."
        return ReportSection("deformation", "Deformation under load", why, state="not evaluated")
    shown = [*_view(tables), *_curves(tables), *_maps(compliance)]
    tests = _tests(tables)
    listings = [listing_of(tests, "Tests of the models"), by_leg_of_sensor(tables), _entries(compliance)]
    listings += [listing for listing in (published_listing(tables),) if listing is not None]
    listings.append(_errors(tables["deformation_errors"]))
    reported = tuple(listing for listing in listings if listing.rows)
    return ReportSection(
        "deformation", "Deformation under load", _opening_sentences(tables, compliance), tuple(shown), reported
    )


def deformation_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the measured compliance: is it as simulated, and elastic? A result either way."""
    compliance = table_or_none(tables, "compliance")
    if compliance is None or "deformation_errors" not in tables:
        return None
    tests = _tests(tables)
    evaluated = [test for test in tests if test.holds is not None]
    if not evaluated:
        return SectionVerdict("deformation", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, tests[0].statement)
    failed = [test for test in evaluated if not test.holds]
    first = (failed or evaluated)[0]
    text = _opening_sentences(tables, compliance)
    if failed:
        code = ReasonCode.SIMULATION_MISSES if first.otherwise == CONTRADICTED else ReasonCode.DEFORMS
        return SectionVerdict("deformation", RelationState.ATTENTION, code, text, first.p, "1", _UNCLEAR)
    return SectionVerdict("deformation", RelationState.OK, ReasonCode.RIGID, text, first.p, "1", _UNCLEAR)


def _tests(tables: Tables) -> list[ModelTest]:
    """Return the tests of the measured compliance against the simulated one, and against elasticity."""
    facts = _facts(tables["deformation_errors"])
    agrees = by_p(
        "the measured compliance agrees with the simulated one",
        facts.get(("matrix", "agreement_p_value")),
        _UNCLEAR,
        (
            "Noise and tolerances explain the differences.",
            "Noise and tolerances do not explain the differences.",
        ),
        "There is no simulation to compare with, or no full matrix was measured.",
        CONTRADICTED,
    )
    symmetric = by_p(
        "the compliance is symmetric, as for an elastic body",
        facts.get(("matrix", "symmetry_p_value")),
        _UNCLEAR,
        ("Noise explains the asymmetry.", "Loads differ from the recorded ones, or the response is not linear."),
        "Not every pair of entries was measured.",
        REJECTED,
    )
    return [agrees, symmetric]


def _view(tables: Tables) -> Drawn:
    scene = load_scene(tables)
    if scene is None:
        return []
    words = "Upper joints without load (grey) and displaced as measured (orange). "
    words += "Blue: the load; a torque is drawn along its axis. Selected legs show their parameters."
    subtitle = f"Lines from the unloaded to the loaded position; initial amplification {scene.gain:g}"
    return [(picture(scene, "Displacement of the platform under load, amplified", subtitle), words)]


def _curves(tables: Tables) -> Drawn:
    curves = table_or_none(tables, "axis_curves")
    if curves is None:
        return []
    mask = curves["load"].map(dict(zip(LOADS, CHANNELS, strict=True))) == curves["channel"]
    drawn: Drawn = []
    if mask.any():
        drawn.append(
            (
                _along_load_axes(curves, tables),
                "Loading and unloading: a difference between them is hysteresis, clearance or creep.",
            )
        )
    if "simulated" in curves and curves["simulated"].notna().any():
        drawn.append(
            (
                differences(curves),
                "Measured minus simulated, with the effect of each load on the other components.",
            )
        )
    return drawn


def _maps(compliance: pd.DataFrame) -> Drawn:
    if not (compliance["model"] == "matrix").any():
        return []
    if (compliance["model"] == "simulated").any():
        words = "Upper number: measured; lower: simulated. Colour: difference over its standard deviation."
        return [(_comparison_map(compliance), words)]
    return [(compliance_map(compliance), "Row: displacement. Column: load.")]


def _opening_sentences(tables: Tables, compliance: pd.DataFrame) -> str:
    facts = _facts(tables["deformation_errors"])
    texts = []
    gain = facts.get(("matrix", "p_value_over_linear"))
    if gain is not None and gain == gain:
        verb = "fits" if gain < _UNCLEAR else "does not fit"
        texts.append(f"The full compliance matrix {verb} significantly better than its diagonal (p {p_equals(gain)}).")
    measured = compliance[compliance["model"] == "matrix"]
    open_entries = len(CHANNELS) * len(LOADS) - len(measured)
    if open_entries:
        texts.append(f"Of 36 entries {open_entries} were never measured: they are unknown, not zero.")
    return (
        " ".join([*texts, *_wrong_entries(measured), *_asymmetry(facts), *published_sentence(tables)])
        or "Displacement per load."
    )


def _wrong_entries(measured: pd.DataFrame) -> list[str]:
    """Return the number of entries that the simulation reproduces, and those that it misses, the worst first."""
    if "pull" not in measured or not measured["pull"].notna().any():
        return ["There is no simulation to compare with."]
    differing = measured[measured["verdict"] == "differs"]
    some = f"{count_text(len(measured), 'measured entry')} of the compliance"
    if not len(differing):
        every = f"the {some}" if len(measured) == 1 else f"all {some}"
        return [f"The simulation reproduces {every} within noise and tolerances."]
    worst = differing.reindex(differing["pull"].abs().sort_values(ascending=False).index)
    named = ", ".join(f"{r.response} under {r.load} ({r.pull:+.1f} sigma)" for r in worst.head(6).itertuples())
    more = f" and {len(worst) - 6} more" if len(worst) > 6 else ""
    if len(differing) == len(measured):
        return [f"The simulation reproduces none of the {some}: it misses {named}{more}."]
    agreeing = len(measured) - len(differing)
    return [
        f"The simulation differs from {len(differing)} of the {some}: {named}{more}. "
        f"It reproduces the other {agreeing} within noise and tolerances."
    ]


def _asymmetry(facts: dict[tuple[str, str], float]) -> list[str]:
    p = facts.get(("matrix", "symmetry_p_value"))
    if p is None or p >= _UNCLEAR:
        return []
    return [
        f"The matrix is not symmetric (p {p_equals(p)}), unlike that of an elastic body: loads differ from the "
        "recorded ones, or the response is not linear."
    ]


def _facts(errors: pd.DataFrame) -> dict[tuple[str, str], float]:
    return {(r.model, r.figure): float(r.value) for r in errors.itertuples() if r.value is not None}


def _entries(compliance: pd.DataFrame) -> Listing:
    """Return every entry of the matrix: measured and simulated, and those never measured."""
    table = {(r.response, r.load): r for r in compliance[compliance["model"] == "matrix"].itertuples()}
    drawing = {(r.response, r.load): r for r in compliance[compliance["model"] == "simulated"].itertuples()}
    rows, marks = [], []
    for response in CHANNELS:
        for load in LOADS:
            fitted, drawn = table.get((response, load)), drawing.get((response, load))
            factor, unit = per_kilo(response, load)
            measured = (
                "not measured"
                if fitted is None
                else with_uncertainty(factor * fitted.coefficient, factor * fitted.sigma)
            )
            simulated = "–" if drawn is None else with_uncertainty(factor * drawn.coefficient, factor * drawn.sigma)
            pull = "" if fitted is None else _pull(getattr(fitted, "pull", None))
            verdict = "" if fitted is None else cell(getattr(fitted, "verdict", None))
            rows.append((response, load, measured, simulated, unit, pull, verdict))
            marks.append({"differs": "warn", "agrees": "pass"}.get(verdict, "none"))
    heads = (
        Head("component", "Component of the platform's motion."),
        LOAD,
        Head("measured", "Entry of the measured compliance, with one standard deviation."),
        Head("simulated", "The same entry as simulated, with its standard deviation by tolerances."),
        UNIT,
        Head("sigmas apart", "Measured minus simulated, divided by its standard deviation."),
        Head("verdict", "Whether both agree, at 5 % false alarms over all entries together."),
    )
    caption = "Compliance, entry by entry. Differs: at 5 % false alarms over all entries together"
    return Listing(heads, tuple(rows), tuple(marks), caption, True, "compliance.parquet")


def _pull(pull: float | None) -> str:
    return "" if pull is None or pull != pull else f"{pull:+.1f}"


def _errors(errors: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            r.model,
            cell(getattr(r, "subject", None)) or "all",
            printed(error_figure_words(r.figure)),
            p_value(r.value) if "p_value" in r.figure else quantity(r.value, r.unit),
        )
        for r in errors.itertuples()
    )
    heads = (
        Head("model", "Form of the compliance: none, diagonal (linear) or full matrix."),
        Head("component", "Component of the platform's motion; a dash for all together."),
        FIGURE,
        VALUE,
    )
    caption = "Errors and tests of every model. Predicted from the others: whole runs left out in turn"
    return Listing(heads, rows, (), caption, True, "deformation_errors.parquet")


def _comparison_map(compliance: pd.DataFrame) -> go.Figure:
    """Return a map of measured over simulated; the colour is their difference in sigmas."""
    measured = {(r.response, r.load): r for r in compliance[compliance["model"] == "matrix"].itertuples()}
    drawing = {(r.response, r.load): r for r in compliance[compliance["model"] == "simulated"].itertuples()}
    pull, text, sentence = np.full((6, 6), np.nan), np.full((6, 6), "", object), np.full((6, 6), "", object)
    for i, response in enumerate(CHANNELS):
        for j, load in enumerate(LOADS):
            fitted, drawn = measured.get((response, load)), drawing[response, load]
            factor, unit = per_kilo(response, load)
            if fitted is None:
                text[i, j] = f"not<br>measured<br>{_short(factor * drawn.coefficient)}"
                continue
            pull[i, j] = fitted.pull
            text[i, j] = f"{_short(factor * fitted.coefficient)}<br>{_short(factor * drawn.coefficient)}"
            sentence[i, j] = (
                f"measured {with_uncertainty(factor * fitted.coefficient, factor * fitted.sigma, unit)}<br>"
                f"simulated {with_uncertainty(factor * drawn.coefficient, factor * drawn.sigma, unit)}<br>"
                f"{fitted.pull:+.1f} sigma: {fitted.verdict}"
            )
    title = "Compliance, measured (above) and simulated (below)"
    subtitle = "µm (dx dy dz) or arcsec (rx ry rz) per kN or kN·m"
    return comparison_map(ComparedEntries(pull, text, sentence), list(CHANNELS), list(LOADS), title, subtitle)


def _short(value: float) -> str:
    """Return three digits, or zero for a negligible value."""
    return "0" if abs(value) < 5e-4 else plain(value)


def _along_load_axes(curves: pd.DataFrame, tables: Tables) -> go.Figure:
    """Return each load against the displacement along or about its own axis (force-sensor paper, figures 12-17)."""
    pairs = [
        (load, channel) for load, channel in zip(LOADS, CHANNELS, strict=True) if len(_curve_of(curves, load, channel))
    ]
    titles = [f"{channel} under {load}" for load, channel in pairs]
    grid, panels, rows = panel_grid(titles, 3, (0.09, lambda rows: min(0.2, 0.9 / rows)))
    shown: set[str] = set()
    for (load, channel), panel in zip(pairs, panels, strict=True):
        part = _curve_of(curves, load, channel)
        if _simulated(part):
            for trace in _simulation(part, part["simulated"], shown):
                grid.add_trace(trace, **panel)
        for trace in _measurement(part, part["measured"], shown):
            grid.add_trace(trace, **panel)
        for trace in published_traces(tables, load, channel, shown):
            grid.add_trace(trace, **panel)
        grid.update_xaxes(title_text=f"{load} ({kilo(load)})", title_standoff=4, **panel)
        grid.update_yaxes(title_text=f"{channel} ({moved_unit(channel)})", title_standoff=4, **panel)
    subtitle = "Bars: 95 % of the noise. Line: simulation; band: its 95 % range by tolerances"
    if not any(_simulated(_curve_of(curves, *pair)) for pair in pairs):
        subtitle = "Bars: 95 % of the noise. The campaign holds no simulation"
    if published_pairs(tables):
        subtitle += ". Dashed and stars: published values"
    style(grid, "Displacement along each load's own axis", subtitle, 170 + 260 * rows)
    return _legend(grid)


def differences(curves: pd.DataFrame) -> go.Figure:
    """Return measured minus simulated, all components under all loads, a panel each."""
    loads = [load for load in LOADS if (curves["load"] == load).any()]
    channels = [channel for channel in CHANNELS if (curves["channel"] == channel).any()]
    grid = make_subplots(
        rows=len(channels),
        cols=len(loads),
        shared_xaxes="columns",
        shared_yaxes="rows",
        horizontal_spacing=0.012,
        vertical_spacing=0.014,
        column_titles=[f"under {load}" for load in loads],
    )
    grid.update_annotations(font={"size": 12})
    shown: set[str] = set()
    traces: list[go.Scatter] = []
    panels: list[tuple[int, int]] = []
    for i, channel in enumerate(channels):
        for j, load in enumerate(loads):
            part, panel = _curve_of(curves, load, channel), (i + 1, j + 1)
            if not len(part):
                empty = {"text": "not measured", "showarrow": False, "font": {"color": GREY, "size": 10}}
                grid.add_annotation(**empty, row=panel[0], col=panel[1])
                continue
            added = _simulation(part, 0.0 * part["simulated"], shown)
            added += _measurement(part, part["measured"] - part["simulated"], shown, size=4)
            traces += added
            panels += [panel] * len(added)
        grid.update_yaxes(title_text=f"{channel} ({moved_unit(channel)})", title_font={"size": 11}, row=i + 1, col=1)
    grid.add_traces(traces, [row for row, _ in panels], [column for _, column in panels])
    for j, load in enumerate(loads):
        grid.update_xaxes(title_text=kilo(load), title_font={"size": 11}, row=len(channels), col=j + 1)
    grid.update_xaxes(tickfont={"size": 10}, nticks=3)
    grid.update_yaxes(tickfont={"size": 10}, nticks=5)
    subtitle = "Outside of the band: beyond what tolerances explain. A slope: a wrong compliance, or a wrong load"
    style(grid, "Measured minus simulated, every component under every load", subtitle, 150 + 130 * len(channels))
    return _legend(grid)


def _curve_of(curves: pd.DataFrame, load: str, channel: str) -> pd.DataFrame:
    part = curves[(curves["load"] == load) & (curves["channel"] == channel)]
    return part.sort_values("applied", kind="stable")


def _simulated(part: pd.DataFrame) -> bool:
    return "simulated" in part and bool(part["simulated"].notna().any())


def _measurement(part: pd.DataFrame, values: pd.Series, shown: set[str], size: int = 6) -> list[go.Scatter]:
    """Return the points of each branch, in separate styles."""
    traces = []
    for branch, (symbol, colour) in _BRANCHES.items():
        array = (part["branch"] == branch).to_numpy()
        if not array.any():
            continue
        bars: dict[str, object] = {"type": "data", "array": BAR * part["sigma"][array], "thickness": 1, "width": 0}
        traces.append(
            go.Scatter(
                x=1e-3 * part["applied"][array],
                y=values[array],
                mode="markers",
                name=f"measured, {branch}",
                legendgroup=branch,
                showlegend=branch not in shown,
                marker={"symbol": symbol, "color": colour, "size": size},
                error_y=bars if len(part) <= _MANY else None,
                text=[f"case {case}" for case in part["case"][array]],
                hovertemplate="%{text}: %{x:.4g} → %{y:.4g}<extra></extra>",
            )
        )
        shown.add(branch)
    return traces


def _simulation(part: pd.DataFrame, values: pd.Series, shown: set[str]) -> list[go.Scatter]:
    """Return the simulated line and the band of its tolerances."""
    x, reach = 1e-3 * part["applied"].to_numpy(), BAR * part["simulated_sigma"].to_numpy()
    y = values.to_numpy()
    around = go.Scatter(
        x=np.concatenate([x, x[::-1]]),
        y=np.concatenate([y - reach, (y + reach)[::-1]]),
        fill="toself",
        fillcolor=_BAND,
        line={"width": 0},
        hoverinfo="skip",
        name="simulation",
        legendgroup="simulation",
        showlegend=False,
    )
    line = go.Scatter(
        x=x,
        y=y,
        mode="lines",
        line={"color": ORANGE, "width": 2},
        name="simulated",
        legendgroup="simulation",
        showlegend="simulation" not in shown,
        hoverinfo="skip",
    )
    shown.add("simulation")
    return [around, line]


def _legend(figure: go.Figure) -> go.Figure:
    figure.update_layout(
        legend={"orientation": "h", "y": -0.06, "yanchor": "top", "x": 0.0}, margin={"t": 110, "b": 90}
    )
    return figure
