"""Section of the poses: visibility of targets, residuals of rigid fits, and uncertainty of poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from truing.arrays import Array
from truing.belonging.relation import RelationState
from truing.report.column_heads import BODY, POSE, Head, schema_head
from truing.report.figure_style import (
    BLUE,
    MANY_POINTS,
    ORANGE,
    label,
    panel_grid,
    pose_axis,
    sequence_title,
    size_axis,
    style,
)
from truing.report.numbers import count_text, quantity, with_uncertainty
from truing.report.page import MOST_ROWS, Listing, ReportSection
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import SIGMA, Row, Tables, table_or_none
from truing.report.wordings.claim import listed
from truing.schemas.verdict import ReasonCode

_METHODS = {
    "maximum_likelihood": "maximum likelihood against the survey",
    "procrustes": "generalised Procrustes, body shape and poses together",
    "scan": "registration of dense scans",
    "measured": "measurement of the poses themselves",
}

_FEWEST = 3  # points that determine a pose
# From this number of poses on, boxes are drawn without points.
_POINTS_SHOWN = 60


def poses(tables: Tables) -> ReportSection | None:
    """Return the section of all bodies' poses with residuals of their fits and uncertainties."""
    if "poses" not in tables:
        return None
    if not len(tables["poses"]):
        return ReportSection("poses", "Poses", "The campaign has no object points.", state="not evaluated")
    chosen = tables["poses"][tables["poses"]["default"]]
    fitted = chosen[chosen["status"] == "ok"]
    lost = chosen[chosen["status"].ne("ok") & ~_used_as_points(tables, chosen)]
    listings = [_undetermined_poses(lost)] if len(lost) else []
    listings.append(_all_poses(chosen))
    return ReportSection(
        "poses", "Poses", _opening_sentences(tables, chosen), _figures(tables, fitted), tuple(listings)
    )


def poses_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict if every body has a pose wherever it was measured; None for a run without poses."""
    table = table_or_none(tables, "poses")
    if table is None:
        return None
    chosen = table[table["default"]]
    as_points = _used_as_points(tables, chosen)
    text = _opening_sentences(tables, chosen)
    if len(chosen) and as_points.all():
        return SectionVerdict("poses", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    lost = float((chosen["status"].ne("ok") & ~as_points).sum())
    if lost:
        return SectionVerdict("poses", RelationState.ATTENTION, ReasonCode.POSES_LOST, text, lost, "1")
    return SectionVerdict("poses", RelationState.OK, ReasonCode.COMPLETE, text, lost, "1")


def _used_as_points(tables: Tables, chosen: pd.DataFrame) -> pd.Series:
    """Return True for rows of bodies of a chain that is fitted to their points.

    Their poses were not measured, and they never show three targets.
    """
    if "joints" not in tables:
        return pd.Series(data=False, index=chosen.index)
    return (chosen.groupby("body")["n_used"].transform("max") < _FEWEST) & chosen["method"].ne("measured")


def _opening_sentences(tables: Tables, chosen: pd.DataFrame) -> str:
    as_points = _used_as_points(tables, chosen)
    if not as_points.any():
        return _of_fitted(chosen)
    names = list(dict.fromkeys(chosen.loc[as_points, "body"]))
    verb = "has" if len(names) == 1 else "have"
    fewer = f"{listed(names)} {verb} fewer than three targets: no pose is computed, and the points are used directly."
    return fewer if as_points.all() else f"{_of_fitted(chosen[~as_points])} {fewer}"


def _of_fitted(chosen: pd.DataFrame) -> str:
    fitted = chosen[chosen["status"] == "ok"]
    bodies = count_text(fitted["body"].nunique(), "body")
    methods = ", ".join(_METHODS.get(m, m) for m in fitted["method"].unique())
    lead = f"{count_text(len(fitted), 'pose')} of {bodies}" + (f" by {methods}" if methods else "")
    lost = len(chosen) - len(fitted)
    if not lost and (fitted["method"] == "measured").all():
        return f"{lead}, taken as given: nothing was fitted."
    return f"{lead}; {lost:,} could not be determined." if lost else f"{lead}; all of them were determined."


def _figures(tables: Tables, fitted: pd.DataFrame) -> tuple[tuple[go.Figure, str], ...]:
    if not len(fitted):
        return ()
    uncertainty = (_pose_uncertainty(fitted), "Box: the middle half of the poses; points: single poses.")
    if (fitted["method"] == "measured").all():
        return (uncertainty,)  # nothing was fitted
    shown = fitted.assign(expected_um=_expected(tables, fitted))
    return (
        (
            _pose_residuals(shown),
            "Check the photographs or the log of a pose that stands out here.",
        ),
        uncertainty,
    )


def _expected(tables: Tables, fitted: pd.DataFrame) -> object:
    """Return per pose, in um, the rms expected from the declared noise of points and survey after six unknowns."""
    points = table_or_none(tables, "observations")
    if points is None:
        return np.nan
    variance = _mean_variance(points)
    survey = table_or_none(tables, "survey")
    if survey is not None:
        variance = variance.add(_mean_variance(survey), fill_value=0.0)
    free = np.clip(1.0 - 6.0 / (3.0 * np.maximum(fitted["n_used"], 1)), 0.0, None)
    return 1e3 * np.sqrt(fitted["body"].map(variance) * free)


def _mean_variance(points: pd.DataFrame) -> pd.Series:
    """Return the mean variance in mm² of a point of each body by noise."""
    return (points[SIGMA] ** 2).sum(axis=1).groupby(points["body"]).mean()


def _undetermined_poses(lost: pd.DataFrame) -> Listing:
    rows = []
    for (body, status), part in lost.groupby(["body", "status"], sort=False):
        named = ", ".join(str(p) for p in part["pose"].iloc[:12])
        more = f" and {len(part) - 12:,} more" if len(part) > 12 else ""
        rows.append((str(body), str(status), f"{len(part):,}", named + more))
    heads = (
        BODY,
        Head("why", "Reason why the pose could not be determined."),
        Head("poses", "Number of poses that could not be determined."),
        Head("which", "Names of the poses that could not be determined."),
    )
    return Listing(heads, tuple(rows), caption="Poses that could not be determined")


def _all_poses(chosen: pd.DataFrame) -> Listing:
    rows = tuple(_pose_row(r) for r in chosen.head(MOST_ROWS).itertuples())
    heads = (
        POSE,
        BODY,
        Head("from", "Frame in which the pose is given: a body, or the frame of the measurement."),
        Head("x, y, z (mm)", "Origin of the body in the frame of the column from, with one standard deviation."),
        Head(
            "rotation vector (mrad)", "Axis times angle of the rotation from the body to the frame of the column from."
        ),
        Head("rms", "Root mean square of the residuals of the points used."),
        Head("used", "Number of points, or readings, in the fit."),
        Head("left out", "Number of points, or readings, left out as gross errors or by a person."),
        schema_head("status"),
    )
    caption = f"All {count_text(len(chosen), 'pose')}"
    return Listing(heads, rows, caption=caption, folded=True, held_by="poses.parquet", total=len(chosen))


def _pose_row(r: Row) -> tuple[str, ...]:
    return (
        str(r.pose),
        r.body,
        r.parent,
        _three(r, "px_mm py_mm pz_mm", 0, 1.0),
        _three(r, "rx_rad ry_rad rz_rad", 3, 1e3),
        quantity(1e3 * r.rms_mm, "um"),
        str(r.n_used),
        str(r.n_rejected),
        r.status,
    )


def _three(r: Row, names: str, first: int, factor: float) -> str:
    cells = []
    for k, name in enumerate(names.split()):
        variance = getattr(r, f"cov_{first + k}_{first + k}")
        sigma = 1e3 * max(variance, 0.0) ** 0.5 if variance == variance else None
        cells.append(with_uncertainty(factor * getattr(r, name), sigma))
    return ", ".join(cells)


def visible_share(observations: pd.DataFrame, known: pd.Series) -> go.Figure:
    """Return the share of each body's targets seen in each pose; ``known``: number of targets by body."""
    poses = observations["pose"].drop_duplicates()
    poses = poses.sort_values() if poses.dtype.kind in "iu" else poses
    seen = observations.groupby(["body", "pose"], sort=False)["target"].nunique().unstack("pose", fill_value=0)
    seen = seen.reindex(index=known.index, columns=poses, fill_value=0)
    share = 100.0 * seen.to_numpy() / known.to_numpy()[:, None]
    x, axis = pose_axis(poses.to_numpy())
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.round(share, 1),
            x=x,
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


def _pose_residuals(poses: pd.DataFrame) -> go.Figure:
    """Return the rms residuals of the rigid fits, a panel per body; ``expected_um``: expected from declared noise."""
    x, axis = pose_axis(poses["pose"].to_numpy())
    poses = poses.assign(place=x)
    bodies = [label(body) for body in poses["body"].drop_duplicates()]
    gaps = 0.04, lambda rows: 32.0 / (120.0 * rows) if rows > 1 else 0.0
    across = 1 if len(bodies) <= 3 else 2
    grid, panels, rows_of_panels = panel_grid(bodies, across, gaps, 12, shared_xaxes="all", shared_yaxes="all")
    kind = size_axis(1e3 * poses["rms_mm"])
    for (_, rows), panel in zip(poses.groupby("body", sort=False), panels, strict=True):
        grid.add_trace(_sizes(rows, len(poses) > MANY_POINTS), **panel)
        if rows["expected_um"].notna().any():
            grid.add_hline(
                y=float(rows["expected_um"].median()), line={"color": ORANGE, "width": 2, "dash": "dot"}, **panel
            )
    style(
        grid,
        "Residuals of the rigid fits, rms over the targets of each pose",
        "Dotted: expected average if only the declared noise acts. Poses far above the line do not fit.",
        150 + 120 * rows_of_panels + (110 if "ticktext" in axis else 0),
    )
    grid.update_xaxes(**{key: value for key, value in axis.items() if key != "title"})
    grid.update_xaxes(title=axis["title"], row=rows_of_panels)
    grid.update_yaxes(**kind)
    grid.update_yaxes(title={"text": sequence_title("rms (µm)", "type" in kind), "font": {"size": 11}}, col=1)
    grid.update_traces(showlegend=False)
    return grid


def _sizes(rows: pd.DataFrame, many: bool) -> go.Scatter | go.Scattergl:
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


def _pose_uncertainty(poses: pd.DataFrame) -> go.Figure:
    """Return the standard deviation of every pose along its worst axis, one box per body: position left, rotation
    right."""
    grid = make_subplots(rows=1, cols=2, subplot_titles=["position, worst axis", "rotation, worst axis"])
    for column, first, unit in ((1, 0, "µm"), (2, 3, "µrad")):
        worst = 1e6 * _worst_sigma(poses, first)
        kind = size_axis(worst)
        for body, rows in poses.assign(worst=worst).groupby("body", sort=False):
            grid.add_trace(_box(str(body), rows, unit), row=1, col=column)
        grid.update_yaxes(title={"text": sequence_title(f"sigma ({unit})", "type" in kind)}, **kind, row=1, col=column)
    style(
        grid,
        "Uncertainty of the poses",
        "One standard deviation; includes points, survey and the reference body",
        400,
    )
    grid.update_traces(showlegend=False)
    grid.update_annotations(font={"size": 13})
    grid.update_layout(margin={"t": 100})
    grid.update_xaxes(type="category", automargin=True)
    return grid


def _worst_sigma(poses: pd.DataFrame, first: int) -> Array:
    return np.sqrt(np.max([poses[f"cov_{i}_{i}"].to_numpy(float) for i in range(first, first + 3)], axis=0))


def _box(body: str, rows: pd.DataFrame, unit: str) -> go.Box:
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
