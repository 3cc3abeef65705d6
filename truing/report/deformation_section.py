"""Section of the deformation: picture, shifts against their drives, models and their errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.belonging.relation import RelationState
from truing.report.coefficient_map import cells_of, coefficient_map, matrix_axes, significant
from truing.report.column_heads import FIGURE, VALUE, Head
from truing.report.error_figures import error_figure_words
from truing.report.figure_style import BAR, BLUE, GREEN, ORANGE, RED, label, panel_grid, style
from truing.report.in_plane_section import directions, in_plane_maps, in_plane_sentence, in_plane_test
from truing.report.model_tests import REJECTED, ModelTest, by_p, listing_of
from truing.report.numbers import count_text, p_equals, p_value, plain, quantity
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.reasons import why_no_deformation
from truing.report.scene.by_leg import by_leg
from truing.report.scene.scenes import pose_scene
from truing.report.scene.view import picture
from truing.report.section_verdict import SectionVerdict
from truing.report.simulated_section import simulated_entries, simulated_map, simulated_sentence, simulated_test
from truing.report.tables import Tables, cell, table_or_none
from truing.schemas.verdict import ReasonCode

_KEYS = ["body", "target", "axis"]
_COORDINATES_SHOWN = 6
_UNLIKELY = 0.01  # p-value below which a model is significant
# The rigid fit of a body with three targets removes nearly all of their displacements.
_TARGETS_OF_A_PICTURE = 3

_LINES = {"x": BLUE, "y": ORANGE, "z": GREEN}


def deformation(tables: Tables) -> ReportSection | None:
    """Return the section with deformation picture, shifts against their drives, and models."""
    if "deformation" not in tables:
        return None
    modelled = table_or_none(tables, "deformation_errors") is not None
    shown = [*_picture(tables), *_legs(tables), *in_plane_maps(tables), *simulated_map(tables), *_targets(tables)]
    if not modelled:
        why = why_no_deformation(tables)
        return ReportSection("deformation", "Deformation", why, tuple(shown), _legwise(tables), "not evaluated")
    tests = _tests(tables)
    listings = (
        listing_of(tests, "Tests of the models"),
        *_legwise(tables),
        *directions(tables),
        *simulated_entries(tables),
        _errors(tables),
    )
    return ReportSection("deformation", "Deformation", _sentence(tables), tuple(shown), listings)


def deformation_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on a body: rigid or deformed by the drives, a result either way."""
    if table_or_none(tables, "deformation_errors") is None or "deformation" not in tables:
        return None
    rigid, text = _tests(tables)[0], _sentence(tables)
    if rigid.holds is None:
        return SectionVerdict("deformation", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, rigid.statement)
    if rigid.holds and all(test.holds is not False for test in simulated_test(_facts(tables))):
        return SectionVerdict("deformation", RelationState.OK, ReasonCode.RIGID, text, rigid.p, "1")
    return SectionVerdict("deformation", RelationState.ATTENTION, ReasonCode.DEFORMS, text, rigid.p, "1")


def _tests(tables: Tables) -> list[ModelTest]:
    """Return the tests of rigidity, and of each model against simpler ones."""
    facts = tables["deformation_errors"]
    p_of_model = {}
    for model, figure in (("linear", "p_value_over_none"), ("matrix", "p_value_over_linear")):
        p = facts.loc[(facts["model"] == model) & (facts["figure"] == figure), "value"].dropna()
        p_of_model[model] = float(p.min()) if len(p) else None
    reported = [p for p in p_of_model.values() if p is not None]
    rigid = by_p(
        "the body is rigid: no target moves with the drives",
        min(1.0, len(reported) * min(reported)) if reported else None,
        _UNLIKELY,
        ("No model explains more than chance.", "Targets move with the drives, beyond chance."),
        "No model could be fitted.",
        REJECTED,
    )
    asked = {
        "linear": "no target moves with its own drive (linear model against none)",
        "matrix": "no target moves with the other drives (matrix model against linear)",
    }
    meanings = ("The model explains no more than chance.", "The model explains significantly more than chance.")
    why = "This campaign does not allow the model: too few poses, or no attachment for each actuator."
    models = [by_p(words, p_of_model[model], _UNLIKELY, meanings, why, REJECTED) for model, words in asked.items()]
    return [rigid, *models, *in_plane_test(_facts(tables)), *simulated_test(_facts(tables))]


def _legwise(tables: Tables) -> tuple[Listing, ...]:
    reported = by_leg(tables)
    return (reported,) if reported.rows else ()


def _picture(tables: Tables) -> Drawn:
    shape, residuals = table_or_none(tables, "shape"), table_or_none(tables, "residuals")
    if shape is None or residuals is None:
        return []
    part = _without_gross_attachments(residuals, shape, tables.get("deformation"))
    part = part[~part["rejected"]].dropna(subset=["dx_mm"]).merge(shape[["body", "target"]], on=["body", "target"])
    body = _body_of_picture(part)
    if body is None:
        return []
    words = f"Targets of {body}; the slider starts with the poses that have the largest displacements. "
    words += "The noise is amplified too."
    if shape.loc[shape["body"] == body, "leg"].notna().any():
        words += " The grey ring connects the surveyed positions of the attachments, the orange ring the measured ones."
    scene = pose_scene(tables, part[part["body"] == body], body)
    if scene.legs:
        words += " Selected legs show their joints, targets and parameters."
    subtitle = f"Lines from surveyed to measured position; initial amplification {scene.gain:g}"
    return [(picture(scene, f"Displacement of the targets of {label(body)}, amplified", subtitle), words)]


def _body_of_picture(residuals: pd.DataFrame) -> str | None:
    """Return the platform or, without one, the body with the largest residuals of a rigid motion."""
    enough = residuals.groupby("body")["target"].nunique() >= _TARGETS_OF_A_PICTURE
    size = (residuals[["dx_mm", "dy_mm", "dz_mm"]] ** 2).sum(axis=1).groupby(residuals["body"]).median()
    size = size[enough]
    if not len(size):
        return None
    return "platform" if "platform" in size.index else str(size.idxmax())


def _without_gross_attachments(
    residuals: pd.DataFrame, shape: pd.DataFrame, shifts: pd.DataFrame | None
) -> pd.DataFrame:
    """Return the residuals without attachments that the deformation models excluded as gross errors."""
    if shifts is None or not len(shifts) or "rejected" not in shifts:
        return residuals
    gross = shifts.loc[shifts["rejected"], ["pose", "leg"]].assign(gross=True)
    legs = residuals.merge(shape[["body", "target", "leg"]], on=["body", "target"], how="left")
    marked = legs.merge(gross, on=["pose", "leg"], how="left")["gross"].notna().to_numpy()
    return residuals[~marked]


def _legs(tables: Tables) -> Drawn:
    shifts, models = table_or_none(tables, "deformation"), table_or_none(tables, "deformation_models")
    if shifts is None or models is None:
        return []
    words = "Points farther from the line than their bars show the effect of the other actuators."
    drawn: Drawn = [(shift_against_drive(shifts, models), words)]
    if (models["model"] == "matrix").any():
        words = "Row: attachment that shifts. Column: actuator that moves it. The linear model has the diagonal alone."
        drawn.append((coefficient_map(models[models["model"] == "matrix"]), words))
    return drawn


def _targets(tables: Tables) -> Drawn:
    shifts, models = table_or_none(tables, "target_deformation"), table_or_none(tables, "deformation_models")
    if shifts is None or models is None or "drive" not in models or "configurations" not in tables:
        return []
    return [
        _difference_from_zero(shifts, models, tables["configurations"], str(d))
        for d in models["drive"].dropna().unique()
    ]


def _difference_from_zero(
    shifts: pd.DataFrame, models: pd.DataFrame, readings: pd.DataFrame, drive: str
) -> tuple[object, str]:
    extended = models[models["drive"] == drive].assign(z=lambda t: (t["coefficient"] / t["sigma"]).abs())
    top = extended.nlargest(_COORDINATES_SHOWN, "z", keep="first")
    chosen = shifts.merge(top[_KEYS], on=_KEYS)
    figure = target_against_drive(chosen, readings.set_index("pose")[drive], top.set_index(_KEYS)["coefficient"])
    clear = int(extended["significant"].sum()) if "significant" in extended else 0
    return figure, f"{clear} of {len(extended)} coordinates change with it beyond chance."


def _significance_words(p: float) -> str:
    return f"{'fits' if p < _UNLIKELY else 'does not fit'} significantly better"


def _facts(tables: Tables) -> dict[tuple[str, str], float]:
    """Return the figures of whole models by model and name."""
    errors = tables["deformation_errors"]
    rows = errors[errors["leg"].isna()]
    return dict(zip(zip(rows["model"], rows["figure"], strict=True), rows["value"].astype(float), strict=True))


def _sentence(tables: Tables) -> str:
    facts = tables["deformation_errors"].set_index(["model", "figure"])["value"]
    words = []
    if ("matrix", "p_value_over_linear") in facts:
        p = float(facts[("matrix", "p_value_over_linear")])
        words.append(f"The matrix model {_significance_words(p)} than the linear one (p {p_equals(p)}).")
    elif ("linear", "p_value_over_none") in facts:
        p = float(facts.xs(("linear", "p_value_over_none")).min())
        words.append(f"The linear model {_significance_words(p)} than no deformation (p {p_equals(p)}).")
    if ("matrix", "rank") in facts:
        words.append(
            f"K has {count_text(int(facts[('matrix', 'rank')]), 'independent deformation shape')} above noise."
        )
    if ("none", "share_buckle") in facts:
        lift, tilt, buckle = (100 * float(facts[("none", f"share_{s}")]) for s in ("lift", "tilt", "buckle"))
        words.append(
            f"The mean square shift is {lift:.0f} % lift, {tilt:.0f} % tilt and {buckle:.0f} % buckling of the ring."
        )
    words += in_plane_sentence(_facts(tables))
    if ("matrix", "modulo_plane") in facts and float(facts[("matrix", "modulo_plane")]):
        words.append("Shifts are known except for a common plane: fewer than three targets lie away from attachments.")
    words += simulated_sentence(tables, _facts(tables))
    return " ".join(words) or "Coefficients and errors of the deformation models."


def _errors(tables: Tables) -> Listing:
    rows = tuple(
        (
            r.model,
            "all" if r.leg != r.leg else f"leg {int(r.leg)}",
            cell(getattr(r, "subject", None)),
            error_figure_words(r.figure),
            p_value(r.value) if "p_value" in r.figure else quantity(r.value, r.unit),
        )
        for r in tables["deformation_errors"].itertuples()
    )
    heads = (
        Head("model", "Model of the deformation: none, linear (own actuator) or matrix (all actuators)."),
        Head("of", "Leg whose attachment is meant, or all legs together."),
        Head("subject", "Poses, group or test that the figure concerns; a dash for all fitted shifts."),
        FIGURE,
        VALUE,
    )
    return Listing(
        heads, rows, caption="Errors and tests of every model", folded=True, held_by="deformation_errors.parquet"
    )


def shift_against_drive(deformation: pd.DataFrame, models: pd.DataFrame) -> go.Figure:
    """Return the shift of each attachment along z against its own actuator, with the linear model (telescope report,
    figure 7)."""
    legs = sorted(deformation["leg"].unique())
    grid, panels, rows_of_panels = _grid([f"leg {leg}" for leg in legs])
    linear = models[models["model"] == "linear"].set_index("leg")
    rows = deformation[~deformation["rejected"]] if "rejected" in deformation else deformation
    low, high = _range(rows)
    for leg, panel in zip(legs, panels, strict=True):
        grid.add_trace(_measured(rows[rows["leg"] == leg]), **panel)
        excluded = deformation.drop(rows.index)
        excluded = excluded[excluded["leg"] == leg]
        if len(excluded):
            grid.add_trace(_left_out(excluded, low, high), **panel)
        if leg in linear.index and (rows["leg"] == leg).any():
            grid.add_trace(_slope(rows[rows["leg"] == leg], 1e3 * float(linear.loc[leg, "coefficient"])), **panel)
    subtitle = "Bars: 95 % of the point noise; line: linear model; cross: left out as gross error"
    style(grid, "Shift of each attachment against its own actuator", subtitle, 130 + 210 * rows_of_panels)
    grid.update_xaxes(title_text="Δρ (mm)", row=rows_of_panels)
    grid.update_yaxes(range=[low, high])
    grid.update_yaxes(title_text="Δb along z (µm)", col=1)
    grid.update_traces(showlegend=False)
    return grid


def _grid(titles: list[str]) -> tuple[go.Figure, list[dict[str, int]], int]:
    gaps = 0.04, lambda rows: min(0.12, 0.8 / rows)
    return panel_grid(titles, 3, gaps, shared_xaxes="all", shared_yaxes="all")


def _range(table: pd.DataFrame) -> tuple[float, float]:
    """Return limits that hold all accepted shifts with their bars, so that a gross error does not flatten the rest."""
    low = float((table["delta_bz_um"] - BAR * table["sigma_um"]).min()) if len(table) else -1.0
    high = float((table["delta_bz_um"] + BAR * table["sigma_um"]).max()) if len(table) else 1.0
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def _measured(rows: pd.DataFrame) -> go.Scatter:
    return go.Scatter(
        x=rows["delta_rho_mm"],
        y=rows["delta_bz_um"],
        mode="markers",
        marker={"color": BLUE, "size": 5},
        error_y={"type": "data", "array": BAR * rows["sigma_um"], "color": "rgba(0,114,178,0.45)", "thickness": 1},
        text=[label(p) for p in rows["pose"]],
        hovertemplate="pose %{text}<br>Δρ %{x:.3f} mm<br>Δb %{y:.1f} µm<extra></extra>",
    ).update(error_y={"width": 0})


def _left_out(rows: pd.DataFrame, low: float, high: float) -> go.Scatter:
    return go.Scatter(
        x=rows["delta_rho_mm"],
        y=rows["delta_bz_um"].clip(low, high),
        mode="markers",
        marker={"color": RED, "size": 11, "symbol": "x-thin", "line": {"color": RED, "width": 3}},
        text=[f"pose {label(p)}: {plain(y)} µm" for p, y in zip(rows["pose"], rows["delta_bz_um"], strict=True)],
        hovertemplate="left out<br>%{text}<extra></extra>",
    )


def _slope(rows: pd.DataFrame, slope: float) -> go.Scatter:
    reach = np.array([rows["delta_rho_mm"].min(), rows["delta_rho_mm"].max()])
    intercept = float((rows["delta_bz_um"] - slope * rows["delta_rho_mm"]).mean())
    return go.Scatter(
        x=reach, y=intercept + slope * reach, mode="lines", line={"color": ORANGE, "width": 2}, hoverinfo="skip"
    )


def compliance_map(compliance: pd.DataFrame) -> go.Figure:
    """Return the compliance matrix as a map in standard deviations, with the value of each entry in its cell."""
    matrix = compliance[compliance["model"] == "matrix"]
    order = list(dict.fromkeys(matrix["response"])), list(dict.fromkeys(matrix["load"]))
    wide = {
        c: matrix.pivot(index="response", columns="load", values=c).loc[order] for c in ("coefficient", "sigma", "unit")
    }
    real = significant(matrix, "response", "load").loc[order].to_numpy()
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=(wide["coefficient"] / wide["sigma"]).clip(-50, 50),
            x=[label(load) for load in order[1]],
            y=[f"{label(response)} " for response in order[0]],
            text=cells_of(wide["coefficient"].to_numpy(), real, "{:.2e}"),
            texttemplate="%{text}",
            zmin=-50,
            zmax=50,
            xgap=1,
            ygap=1,
            colorscale="RdBu_r",
            customdata=wide["unit"],
            colorbar={"title": {"text": "value / sigma"}, "thickness": 16},
            hovertemplate="%{y} per %{x}: %{text} %{customdata}<extra></extra>",
        )
    )
    subtitle = "m or rad per N or N·m. Colour: value over its sigma, clipped at 50. In brackets: not significant"
    style(figure, "Compliance: displacement (row) per load (column)", subtitle, 500)
    matrix_axes(figure)
    return figure


def target_against_drive(shifts: pd.DataFrame, drive: pd.Series, slopes: pd.Series) -> go.Figure:
    """Return the shift of single coordinates against a drive, a panel each; ``slopes`` in um per unit by body, target,
    axis."""
    parts = list(shifts.groupby(["body", "target", "axis"], sort=False))
    grid, panels, rows_of_panels = _grid([label(" ".join(name)) for name, _ in parts])
    for (name, rows), panel in zip(parts, panels, strict=True):
        x, y = drive.reindex(rows["pose"]).to_numpy(dtype=float), rows["displacement_um"].to_numpy()
        bars = {"type": "data", "array": BAR * rows["sigma_um"], "thickness": 1, "width": 0}
        text = [label(p) for p in rows["pose"]]
        points = go.Scatter(x=x, y=y, mode="markers", marker={"size": 5, "color": _LINES[name[2]]}, error_y=bars)
        grid.add_trace(points.update(text=text, hovertemplate="pose %{text}: %{y:.1f} µm<extra></extra>"), **panel)
        reach = np.array([np.nanmin(x), np.nanmax(x)])
        line = np.nanmean(y) + slopes[name] * (reach - np.nanmean(x))
        grid.add_trace(go.Scatter(x=reach, y=line, mode="lines", line={"color": RED}, hoverinfo="skip"), **panel)
    subtitle = "The coordinates that follow it most clearly. Bars: 95 %; line: slope of the linear model"
    style(grid, f"Shift of targets in their body against {label(drive.name)}", subtitle, 130 + 200 * rows_of_panels)
    grid.update_xaxes(title_text=label(drive.name), row=rows_of_panels)
    grid.update_yaxes(title_text="shift (µm)", col=1)
    grid.update_traces(showlegend=False)
    return grid
