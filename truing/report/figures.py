"""Every figure of the report, from tables; plotly figures that a reviewer understands without the text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

# Okabe-Ito, told apart by colour-blind readers too.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#7A7A7A"
LEG_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9")


def _figure(title: str, height: int, **layout: Any) -> go.Figure:
    import plotly.graph_objects as go

    figure = go.Figure()
    figure.update_layout(
        title={"text": title, "font": {"size": 15}, "x": 0.0, "xanchor": "left"},
        height=height,
        margin={"l": 60, "r": 20, "t": 50, "b": 50},
        template="plotly_white",
        font={"family": "system-ui, sans-serif", "size": 12},
        **layout,
    )
    return figure


def shift_against_drive(deformation: pd.DataFrame, models: pd.DataFrame) -> go.Figure:
    """Shift of each attachment along z against its own actuator, with the linear model (telescope report, figure 7)."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    legs = sorted(deformation["leg"].unique())
    columns = min(3, len(legs))
    grid = make_subplots(
        rows=-(-len(legs) // columns),
        cols=columns,
        shared_xaxes=True,
        shared_yaxes=True,
        subplot_titles=[f"leg {leg}" for leg in legs],
        horizontal_spacing=0.04,
        vertical_spacing=0.12,
    )
    linear = models[models["model"] == "linear"].set_index("leg")
    for k, leg in enumerate(legs):
        rows = deformation[deformation["leg"] == leg]
        place = {"row": k // columns + 1, "col": k % columns + 1}
        for part, colour, symbol in ((rows[~rows["rejected"]], BLUE, "circle"), (rows[rows["rejected"]], RED, "x")):
            if len(part):
                grid.add_trace(_measured(part, colour, symbol), **place)
        if leg in linear.index:
            reach = np.array([rows["delta_rho_mm"].min(), rows["delta_rho_mm"].max()])
            kept = rows[~rows["rejected"]]
            slope = 1e3 * float(linear.loc[leg, "coefficient"])
            rest = float((kept["delta_bz_um"] - slope * kept["delta_rho_mm"]).mean())
            line = go.Scatter(x=reach, y=rest + slope * reach, mode="lines", line={"color": ORANGE, "width": 2})
            grid.add_trace(line.update(name="linear model", hoverinfo="skip"), **place)
    grid.update_traces(showlegend=False)
    frame = _figure("Shift of each attachment against its own actuator, 95 % bars; line: linear model", 520)
    grid.update_layout(frame.layout)
    grid.update_xaxes(title_text="Δρ (mm)", row=-(-len(legs) // columns))
    grid.update_yaxes(title_text="Δb along z (µm)", col=1)
    return grid


def _measured(rows: pd.DataFrame, colour: str, symbol: str) -> go.Scatter:
    import plotly.graph_objects as go

    return go.Scatter(
        x=rows["delta_rho_mm"],
        y=rows["delta_bz_um"],
        mode="markers",
        marker={"color": colour, "size": 6, "symbol": symbol},
        error_y={"type": "data", "array": 1.96 * rows["sigma_um"], "color": colour, "thickness": 1, "width": 0},
        customdata=rows["pose"],
        hovertemplate="pose %{customdata}<br>Δρ %{x:.3f} mm<br>Δb %{y:.1f} µm<extra></extra>",
    )


def coefficient_map(models: pd.DataFrame) -> go.Figure:
    """The matrix model's coefficients as a heat map; entries that chance could explain are set in brackets."""
    import plotly.graph_objects as go

    matrix = models[models["model"] == "matrix"]
    values = 1e3 * matrix.pivot(index="leg", columns="column", values="coefficient")
    sigma = 1e3 * matrix.pivot(index="leg", columns="column", values="sigma")
    real = matrix.pivot(index="leg", columns="column", values="significant")
    text = [
        [f"{v:.1f}" if s else f"({v:.1f})" for v, s in zip(row, marks, strict=True)]
        for row, marks in zip(values.to_numpy(), real.to_numpy(), strict=True)
    ]
    bound = float(np.abs(values.to_numpy()).max())
    figure = _figure("Matrix model K in µm per mm; in brackets: not distinguishable from zero", 440)
    figure.add_trace(
        go.Heatmap(
            z=values,
            x=[f"Δρ{c}" for c in values.columns],
            y=[f"Δb{r}" for r in values.index],
            text=text,
            texttemplate="%{text}",
            customdata=sigma,
            colorscale="RdBu_r",
            zmin=-bound,
            zmax=bound,
            colorbar={"title": "µm/mm"},
            hovertemplate="%{y} per %{x}: %{z:.2f} ± %{customdata:.2f} µm/mm<extra></extra>",
        )
    )
    figure.update_yaxes(autorange="reversed", scaleanchor="x")
    figure.update_xaxes(side="top", constrain="domain")
    figure.update_layout(margin={"t": 80})
    return figure


def deformation_picture(survey: pd.DataFrame, residuals: pd.DataFrame, legs: bool) -> go.Figure:
    """Targets of one body with their amplified displacement in 3-D, one pose at a time (telescope report, figure 6)."""

    placed = residuals.merge(survey, on=["body", "target"], suffixes=("", "_survey"))
    size = np.sqrt((placed[["dx_mm", "dy_mm", "dz_mm"]] ** 2).sum(axis=1))
    placed = placed[~placed["rejected"]].assign(size=size)
    worst = placed.groupby("pose")["size"].apply(lambda s: float((s**2).mean())).sort_values(ascending=False)
    poses = list(worst.index[:12])
    extent = float(np.ptp(placed[["x_mm", "y_mm", "z_mm"]].to_numpy(), axis=0).max())
    gain = _round_gain(0.12 * extent / max(float(placed["size"].quantile(0.99)), 1e-9))
    figure = _figure(f"Displacement of the targets in their body, amplified {gain:g} times", 560)
    for k, pose in enumerate(poses):
        for trace in _displaced(placed[placed["pose"] == pose], gain, legs):
            figure.add_trace(trace.update(visible=k == 0))
    each = len(figure.data) // max(len(poses), 1)
    steps = [
        {"label": str(p), "method": "update", "args": [{"visible": [i // each == k for i in range(len(figure.data))]}]}
        for k, p in enumerate(poses)
    ]
    figure.update_layout(
        sliders=[{"steps": steps, "currentvalue": {"prefix": "pose "}, "pad": {"t": 30}}],
        scene=_scene(placed[["x_mm", "y_mm", "z_mm"]].to_numpy(), gain * placed["size"].max()),
        legend={"orientation": "h", "y": 1.02},
    )
    return figure


def _scene(points: Any, longest: float) -> dict[str, Any]:
    """Axes that hold body and amplified displacement; a flat body gets a third of its width as height, to be seen."""
    low, high = points.min(axis=0) - 0.6 * longest, points.max(axis=0) + 0.6 * longest
    span = high - low
    ratio = np.maximum(span / span.max(), 0.35)
    axes = {
        f"{a}axis": {"title": {"text": f"{a} (mm)"}, "range": [float(low[k]), float(high[k])]}
        for k, a in enumerate("xyz")
    }
    return {
        **axes,
        "aspectmode": "manual",
        "aspectratio": {a: float(ratio[k]) for k, a in enumerate("xyz")},
        "camera": {"eye": {"x": 0.85, "y": -1.05, "z": 0.7}, "center": {"x": 0, "y": 0, "z": -0.1}},
    }


def _round_gain(gain: float) -> float:
    power = 10.0 ** np.floor(np.log10(max(gain, 1.0)))
    return float(power * max(d for d in (1, 2, 5) if d * power <= max(gain, 1.0)))


def _displaced(rows: pd.DataFrame, gain: float, legs: bool) -> list[go.Scatter3d]:
    import plotly.graph_objects as go

    start = rows[["x_mm", "y_mm", "z_mm"]].to_numpy()
    shift = rows[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()
    end = start + gain * shift
    gap = np.full((len(start), 3), np.nan)
    arrows = np.stack([start, end, gap], axis=1).reshape(-1, 3)
    names = [f"{t}: {1e3 * np.linalg.norm(d):.1f} µm" for t, d in zip(rows["target"], shift, strict=True)]
    attached = rows["leg"].notna().to_numpy() if legs else np.zeros(len(rows), bool)
    colours = np.where(attached, ORANGE, BLUE)
    traces = [
        go.Scatter3d(
            x=start[:, 0],
            y=start[:, 1],
            z=start[:, 2],
            mode="markers",
            name="target in the survey",
            marker={"size": 4, "color": colours.tolist()},
            text=names,
            hoverinfo="text",
        ),
        go.Scatter3d(
            x=arrows[:, 0],
            y=arrows[:, 1],
            z=arrows[:, 2],
            mode="lines",
            name="displacement",
            line={"color": RED, "width": 5},
            hoverinfo="skip",
            connectgaps=False,
        ),
    ]
    if attached.any():
        traces.append(_ring(rows[attached], end[attached]))
    return traces


def _ring(attachments: pd.DataFrame, end: Any) -> go.Scatter3d:
    """The attachments joined round the ring, as displaced: the buckled wheel."""
    import plotly.graph_objects as go

    order = np.argsort(np.arctan2(attachments["y_mm"].to_numpy(), attachments["x_mm"].to_numpy()))
    loop = end[np.append(order, order[0])]
    line = {"color": ORANGE, "width": 3, "dash": "dot"}
    return go.Scatter3d(
        x=loop[:, 0],
        y=loop[:, 1],
        z=loop[:, 2],
        mode="lines",
        name="ring of attachments, displaced",
        line=line,
        hoverinfo="skip",
    )


def pose_uncertainty(poses: pd.DataFrame) -> go.Figure:
    """Standard deviation of every pose: the largest of position and of rotation, body by body."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    grid = make_subplots(rows=1, cols=2, subplot_titles=["position (µm)", "rotation (µrad)"])
    for k, (body, rows) in enumerate(poses.groupby("body", sort=False)):
        colour = LEG_COLOURS[k % len(LEG_COLOURS)]
        for column, (first, last) in ((1, (0, 3)), (2, (3, 6))):
            worst = np.sqrt(np.max([rows[f"cov_{i}_{i}"].to_numpy(float) for i in range(first, last)], axis=0))
            grid.add_trace(
                go.Scatter(
                    x=[str(p) for p in rows["pose"]],
                    y=1e6 * worst,
                    mode="markers",
                    name=str(body),
                    marker={"color": colour, "size": 6},
                    showlegend=column == 1,
                    legendgroup=str(body),
                ),
                row=1,
                col=column,
            )
    grid.update_layout(_figure("Standard deviation of the poses, worst axis", 380).layout)
    grid.update_xaxes(title_text="pose", type="category")
    return grid


def pose_residuals(poses: pd.DataFrame) -> go.Figure:
    """Root mean square of what the rigid fits leave, pose by pose and body by body."""
    import plotly.graph_objects as go

    figure = _figure("What the rigid fits leave (rms over targets)", 360)
    for k, (body, rows) in enumerate(poses.groupby("body", sort=False)):
        figure.add_trace(
            go.Scatter(
                x=[str(p) for p in rows["pose"]],
                y=1e3 * rows["rms_mm"],
                mode="lines+markers",
                name=str(body),
                line={"color": LEG_COLOURS[k % len(LEG_COLOURS)], "width": 1},
                marker={"size": 5},
            )
        )
    figure.update_xaxes(title_text="pose", type="category")
    figure.update_yaxes(title_text="rms (µm)", rangemode="tozero")
    return figure


def target_against_drive(shifts: pd.DataFrame, drive: pd.Series, name: str) -> go.Figure:
    """Shift of the targets of each body against a drive, where no mechanism says more."""
    import plotly.graph_objects as go

    figure = _figure(f"Shift of the targets in their body against {name}", 460)
    for k, (label, rows) in enumerate(shifts.groupby(["body", "target", "axis"], sort=False)):
        x = drive.reindex(rows["pose"]).to_numpy()
        figure.add_trace(
            go.Scatter(
                x=x,
                y=rows["displacement_um"],
                mode="markers",
                name=" ".join(label),
                marker={"size": 5, "color": LEG_COLOURS[k % 6]},
                error_y={"type": "data", "array": 1.96 * rows["sigma_um"], "thickness": 1, "width": 0},
            )
        )
    figure.update_xaxes(title_text=name)
    figure.update_yaxes(title_text="shift (µm)")
    return figure


def compliance_map(compliance: pd.DataFrame) -> go.Figure:
    """The compliance matrix, each entry in units of its own standard deviation, its value in the cell."""
    import plotly.graph_objects as go

    matrix = compliance[compliance["model"] == "matrix"]
    order = {"index": list(dict.fromkeys(matrix["response"])), "columns": list(dict.fromkeys(matrix["load"]))}
    wide = {
        c: matrix.pivot(index="response", columns="load", values=c).loc[order["index"], order["columns"]]
        for c in ("coefficient", "sigma", "unit")
    }
    z = (wide["coefficient"] / wide["sigma"]).clip(-50, 50)
    text = [[f"{v:.2e}" for v in row] for row in wide["coefficient"].to_numpy()]
    figure = _figure("Compliance: value in SI, colour in standard deviations (clipped at 50)", 460)
    figure.add_trace(
        go.Heatmap(
            z=z,
            x=order["columns"],
            y=order["index"],
            text=text,
            texttemplate="%{text}",
            zmin=-50,
            zmax=50,
            colorscale="RdBu_r",
            customdata=wide["unit"],
            colorbar={"title": "sigma"},
            hovertemplate="%{y} per %{x}: %{text} %{customdata}<extra></extra>",
        )
    )
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(side="top")
    figure.update_layout(margin={"t": 80})
    return figure
