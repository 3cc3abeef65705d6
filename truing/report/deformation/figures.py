"""Figures of the deformation models: shifts against their drives, and matrices as heat maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.figure_style import BLUE, GREEN, ORANGE, RED, label, style
from truing.report.numbers import plain, with_uncertainty

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_LINES = {"x": BLUE, "y": ORANGE, "z": GREEN}
_BAR = 1.96


def shift_against_drive(deformation: pd.DataFrame, models: pd.DataFrame) -> go.Figure:
    """Shift of each attachment along z against its own actuator, with the linear model (telescope report, figure 7)."""
    legs = sorted(deformation["leg"].unique())
    grid, columns, rows_of_panels = _grid([f"leg {leg}" for leg in legs])
    linear = models[models["model"] == "linear"].set_index("leg")
    kept = deformation[~deformation["rejected"]] if "rejected" in deformation else deformation
    low, high = _range(kept)
    for k, leg in enumerate(legs):
        place = {"row": k // columns + 1, "col": k % columns + 1}
        grid.add_trace(_measured(kept[kept["leg"] == leg]), **place)
        out = deformation.drop(kept.index)
        out = out[out["leg"] == leg]
        if len(out):
            grid.add_trace(_left_out(out, low, high), **place)
        if leg in linear.index and (kept["leg"] == leg).any():
            grid.add_trace(_slope(kept[kept["leg"] == leg], 1e3 * float(linear.loc[leg, "coefficient"])), **place)
    subtitle = "Bars: 95 % of the point noise; line: linear model; red cross: left out as gross error"
    style(grid, "Shift of each attachment against its own actuator", subtitle, 130 + 210 * rows_of_panels)
    grid.update_xaxes(title_text="Δρ (mm)", row=rows_of_panels)
    grid.update_yaxes(range=[low, high])
    grid.update_yaxes(title_text="Δb along z (µm)", col=1)
    grid.update_traces(showlegend=False)
    return grid


def _grid(titles: list[str]) -> tuple[go.Figure, int, int]:
    from plotly.subplots import make_subplots

    columns = min(3, len(titles))
    rows = -(-len(titles) // columns)
    grid = make_subplots(
        rows=rows,
        cols=columns,
        shared_xaxes="all",
        shared_yaxes="all",
        subplot_titles=titles,
        horizontal_spacing=0.04,
        vertical_spacing=min(0.12, 0.8 / rows),
    )
    grid.update_annotations(font={"size": 13})
    return grid, columns, rows


def _range(kept: pd.DataFrame) -> tuple[float, float]:
    """Limits that hold all kept shifts with their bars, so that a gross error cannot flatten the rest."""
    low = float((kept["delta_bz_um"] - _BAR * kept["sigma_um"]).min()) if len(kept) else -1.0
    high = float((kept["delta_bz_um"] + _BAR * kept["sigma_um"]).max()) if len(kept) else 1.0
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def _measured(rows: pd.DataFrame) -> go.Scatter:
    import plotly.graph_objects as go

    return go.Scatter(
        x=rows["delta_rho_mm"],
        y=rows["delta_bz_um"],
        mode="markers",
        marker={"color": BLUE, "size": 5},
        error_y={"type": "data", "array": _BAR * rows["sigma_um"], "color": "rgba(0,114,178,0.45)", "thickness": 1},
        text=[label(p) for p in rows["pose"]],
        hovertemplate="pose %{text}<br>Δρ %{x:.3f} mm<br>Δb %{y:.1f} µm<extra></extra>",
    ).update(error_y={"width": 0})


def _left_out(rows: pd.DataFrame, low: float, high: float) -> go.Scatter:
    import plotly.graph_objects as go

    return go.Scatter(
        x=rows["delta_rho_mm"],
        y=rows["delta_bz_um"].clip(low, high),
        mode="markers",
        marker={"color": RED, "size": 11, "symbol": "x-thin", "line": {"color": RED, "width": 3}},
        text=[f"pose {label(p)}: {plain(y)} µm" for p, y in zip(rows["pose"], rows["delta_bz_um"], strict=True)],
        hovertemplate="left out<br>%{text}<extra></extra>",
    )


def _slope(rows: pd.DataFrame, slope: float) -> go.Scatter:
    import plotly.graph_objects as go

    reach = np.array([rows["delta_rho_mm"].min(), rows["delta_rho_mm"].max()])
    rest = float((rows["delta_bz_um"] - slope * rows["delta_rho_mm"]).mean())
    return go.Scatter(
        x=reach, y=rest + slope * reach, mode="lines", line={"color": ORANGE, "width": 2}, hoverinfo="skip"
    )


# Wider matrices have no room for numbers in their cells.
_NUMBERED = 15


def coefficient_map(models: pd.DataFrame) -> go.Figure:
    """The matrix model's coefficients as a heat map; entries that chance could explain are set in brackets."""
    import plotly.graph_objects as go

    matrix = models[models["model"] == "matrix"]
    wide = {c: matrix.pivot(index="leg", columns="column", values=c) for c in ("coefficient", "sigma")}
    values, sigma = 1e3 * wide["coefficient"], 1e3 * wide["sigma"]
    real = _significant(matrix, "leg", "column").to_numpy()
    bound = float(np.nanmax(np.abs(values.to_numpy())))
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=values,
            x=[f"actuator {c}" for c in values.columns],
            y=[f"attachment {r} " for r in values.index],
            text=_cells(values.to_numpy(), real, "{:.1f}"),
            texttemplate="%{text}" if len(values.columns) <= _NUMBERED else None,
            textfont={"size": 14},
            customdata=_told(values.to_numpy(), sigma.to_numpy()),
            colorscale="RdBu_r",
            zmin=-bound,
            zmax=bound,
            xgap=1,
            ygap=1,
            colorbar={"title": {"text": "µm per mm"}, "thickness": 16},
            hovertemplate="%{y}with %{x}: %{customdata}<extra></extra>",
        )
    )
    typical = float(np.nanmedian(sigma.to_numpy()))
    subtitle = f"One sigma of an entry: {typical:.2g} µm per mm. In brackets: not distinguishable from zero"
    style(figure, "K: shift of each attachment along z, in µm per mm of each actuator", subtitle, 520)
    _matrix_axes(figure)
    return figure


def _significant(matrix: pd.DataFrame, index: str, columns: str) -> pd.DataFrame:
    known = matrix if "significant" in matrix else matrix.assign(significant=True)
    return known.pivot(index=index, columns=columns, values="significant")


def _cells(values: Any, real: Any, form: str) -> list[list[str]]:
    return [
        [form.format(v) if mark else f"({form.format(v)})" for v, mark in zip(row, marks, strict=True)]
        for row, marks in zip(values, real, strict=True)
    ]


def _told(values: Any, sigma: Any) -> list[list[str]]:
    """Every entry with its uncertainty."""
    return [
        [with_uncertainty(v, s, "µm/mm") for v, s in zip(*pair, strict=True)]
        for pair in zip(values, sigma, strict=True)
    ]


def _matrix_axes(figure: go.Figure) -> None:
    figure.update_yaxes(autorange="reversed", automargin=True, type="category", showgrid=False)
    figure.update_xaxes(side="top", type="category", showgrid=False)
    figure.update_layout(margin={"t": 110, "b": 20})


def compliance_map(compliance: pd.DataFrame) -> go.Figure:
    """The compliance matrix, each entry in units of its own standard deviation, its value in the cell."""
    import plotly.graph_objects as go

    matrix = compliance[compliance["model"] == "matrix"]
    order = list(dict.fromkeys(matrix["response"])), list(dict.fromkeys(matrix["load"]))
    wide = {
        c: matrix.pivot(index="response", columns="load", values=c).loc[order] for c in ("coefficient", "sigma", "unit")
    }
    real = _significant(matrix, "response", "load").loc[order].to_numpy()
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=(wide["coefficient"] / wide["sigma"]).clip(-50, 50),
            x=[label(load) for load in order[1]],
            y=[f"{label(response)} " for response in order[0]],
            text=_cells(wide["coefficient"].to_numpy(), real, "{:.2e}"),
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
    _matrix_axes(figure)
    return figure


def target_against_drive(shifts: pd.DataFrame, drive: pd.Series, slopes: pd.Series) -> go.Figure:
    """Shift of single coordinates against a drive, a panel each; ``slopes`` in um per unit by body, target, axis."""
    import plotly.graph_objects as go

    parts = list(shifts.groupby(["body", "target", "axis"], sort=False))
    grid, columns, rows_of_panels = _grid([label(" ".join(name)) for name, _ in parts])
    for k, (name, rows) in enumerate(parts):
        place = {"row": k // columns + 1, "col": k % columns + 1}
        x, y = drive.reindex(rows["pose"]).to_numpy(dtype=float), rows["displacement_um"].to_numpy()
        bars = {"type": "data", "array": _BAR * rows["sigma_um"], "thickness": 1, "width": 0}
        text = [label(p) for p in rows["pose"]]
        points = go.Scatter(x=x, y=y, mode="markers", marker={"size": 5, "color": _LINES[name[2]]}, error_y=bars)
        grid.add_trace(points.update(text=text, hovertemplate="pose %{text}: %{y:.1f} µm<extra></extra>"), **place)
        reach = np.array([np.nanmin(x), np.nanmax(x)])
        line = np.nanmean(y) + slopes[name] * (reach - np.nanmean(x))
        grid.add_trace(go.Scatter(x=reach, y=line, mode="lines", line={"color": RED}, hoverinfo="skip"), **place)
    subtitle = "The coordinates that follow it most clearly. Bars: 95 %; line: slope of the linear model"
    style(grid, f"Shift of targets in their body against {label(drive.name)}", subtitle, 130 + 200 * rows_of_panels)
    grid.update_xaxes(title_text=label(drive.name), row=rows_of_panels)
    grid.update_yaxes(title_text="shift (µm)", col=1)
    grid.update_traces(showlegend=False)
    return grid
