"""Figures of what was seen, of the poses' residuals and of their uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.figure_style import BLUE, MANY_POINTS, ORANGE, label, pose_axis, sequence_title, size_axis, style

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

# With so many poses a box alone says more than its points.
_POINTS_SHOWN = 60


def targets_seen(observations: pd.DataFrame, known: pd.Series) -> go.Figure:
    """Share of each body's targets that each pose saw; ``known``: number of targets by body."""
    import plotly.graph_objects as go

    poses = observations["pose"].drop_duplicates()
    poses = poses.sort_values() if poses.dtype.kind in "iu" else poses
    seen = observations.groupby(["body", "pose"], sort=False)["target"].nunique().unstack("pose", fill_value=0)
    seen = seen.reindex(index=known.index, columns=poses, fill_value=0)
    share = 100.0 * seen.to_numpy() / known.to_numpy()[:, None]
    places, axis = pose_axis(poses.to_numpy())
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.round(share, 1),
            x=places,
            y=[label(body) for body in seen.index],
            customdata=np.broadcast_to([label(p) for p in poses], share.shape),
            zmin=0,
            zmax=100,
            colorscale=[[0.0, "#B3261E"], [0.5, "#F2C879"], [0.999, "#CFE3F1"], [1.0, "#EAF2F8"]],
            colorbar={"title": {"text": "% seen"}, "thickness": 14, "tickvals": [0, 50, 100]},
            hovertemplate="%{y}, pose %{customdata}: %{z:.0f} % of its targets<extra></extra>",
        )
    )
    height = 170 + 22 * max(4, len(seen)) + (110 if "ticktext" in axis else 0)
    style(figure, "Targets seen", "Pale: all targets of the body; the darker, the more are missing", height)
    figure.update_xaxes(**axis)
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    return figure


def pose_residuals(poses: pd.DataFrame) -> go.Figure:
    """Root mean square of what the rigid fits leave, a panel per body; ``expected_um``: what declared noise leaves."""
    places, axis = pose_axis(poses["pose"].to_numpy())
    poses = poses.assign(place=places)
    grid, panels = _panels(poses)
    kind = size_axis(1e3 * poses["rms_mm"])
    for k, (_, rows) in enumerate(poses.groupby("body", sort=False)):
        place = {"row": k // panels + 1, "col": k % panels + 1}
        grid.add_trace(_sizes(rows, len(poses) > MANY_POINTS), **place)
        if rows["expected_um"].notna().any():
            grid.add_hline(
                y=float(rows["expected_um"].median()), line={"color": ORANGE, "width": 2, "dash": "dot"}, **place
            )
    rows_of_panels = -(-poses["body"].nunique() // panels)
    style(
        grid,
        "What the rigid fits leave, rms over the targets of each pose",
        "Dotted: what the declared noise alone leaves on average. Poses far above it do not fit.",
        150 + 120 * rows_of_panels + (110 if "ticktext" in axis else 0),
    )
    grid.update_xaxes(**{key: value for key, value in axis.items() if key != "title"})
    grid.update_xaxes(title=axis["title"], row=rows_of_panels)
    grid.update_yaxes(**kind)
    grid.update_yaxes(title={"text": sequence_title("rms (µm)", "type" in kind), "font": {"size": 11}}, col=1)
    grid.update_traces(showlegend=False)
    return grid


def _panels(poses: pd.DataFrame) -> tuple[go.Figure, int]:
    from plotly.subplots import make_subplots

    bodies = [label(body) for body in poses["body"].drop_duplicates()]
    columns = 1 if len(bodies) <= 3 else 2
    rows = -(-len(bodies) // columns)
    gap = 32.0 / (120.0 * rows)
    grid = make_subplots(
        rows=rows,
        cols=columns,
        shared_xaxes="all",
        shared_yaxes="all",
        subplot_titles=bodies,
        vertical_spacing=gap if rows > 1 else 0.0,
        horizontal_spacing=0.04,
    )
    grid.update_annotations(font={"size": 12})
    return grid, columns


def _sizes(rows: pd.DataFrame, many: bool) -> Any:
    import plotly.graph_objects as go

    size = 1e3 * rows["rms_mm"].to_numpy(dtype=float)
    kind = go.Scattergl if many else go.Scatter
    return kind(
        x=rows["place"],
        y=np.where(size > 0.0, size, np.nan),
        mode="markers",
        marker={"color": BLUE, "size": 3 if many else 5},
        text=[label(p) for p in rows["pose"]],
        hovertemplate="pose %{text}: %{y:.2f} µm<extra></extra>",
    )


def pose_uncertainty(poses: pd.DataFrame) -> go.Figure:
    """Standard deviation of every pose along its worst axis, one box per body: position left, rotation right."""
    from plotly.subplots import make_subplots

    grid = make_subplots(rows=1, cols=2, subplot_titles=["position, worst axis", "rotation, worst axis"])
    for column, first, unit in ((1, 0, "µm"), (2, 3, "µrad")):
        worst = 1e6 * _worst_sigma(poses, first)
        kind = size_axis(worst)
        for body, rows in poses.assign(worst=worst).groupby("body", sort=False):
            grid.add_trace(_box(str(body), rows, unit), row=1, col=column)
        grid.update_yaxes(title={"text": sequence_title(f"sigma ({unit})", "type" in kind)}, **kind, row=1, col=column)
    style(
        grid,
        "How well the poses are known",
        "One standard deviation; points, survey, and the body that a pose is seen from are all counted",
        400,
    )
    grid.update_traces(showlegend=False)
    grid.update_annotations(font={"size": 13})
    grid.update_layout(margin={"t": 100})
    grid.update_xaxes(type="category", automargin=True)
    return grid


def _worst_sigma(poses: pd.DataFrame, first: int) -> Any:
    return np.sqrt(np.max([poses[f"cov_{i}_{i}"].to_numpy(float) for i in range(first, first + 3)], axis=0))


def _box(body: str, rows: pd.DataFrame, unit: str) -> go.Box:
    import plotly.graph_objects as go

    return go.Box(
        x=[label(body)] * len(rows),
        y=rows["worst"],
        name=label(body),
        text=[f"pose {label(p)}" for p in rows["pose"]],
        boxpoints="all" if len(rows) <= _POINTS_SHOWN else "outliers",
        jitter=0.4,
        pointpos=0.0,
        marker={"color": BLUE, "size": 4, "opacity": 0.6},
        line={"color": BLUE, "width": 1},
        fillcolor="rgba(0,114,178,0.15)",
        hovertemplate="%{text}: %{y:.2f} " + unit + "<extra></extra>",
    )
