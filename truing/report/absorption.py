"""Absorption map: parameters that an omitted effect biases, as predicted and as fitted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from truing.report.calibration.calibrations import Key
from truing.report.figure_style import BAR, BLUE, GREEN, GREY, ORANGE, RED, label, panel_grid, style
from truing.report.numbers import capitalised, count_text, plain, printed, with_uncertainty
from truing.report.parameter_names import kind_of, name_of, print_unit
from truing.report.tables import Row, Tables, table_or_none

_EFFECTS = {
    "platform-deformation-linear": "the linear deformation of the platform",
    "platform-deformation-matrix": "the deformation of the platform",
}
_ESTIMATORS = {"implicit": "implicit objectives", "errors-in-variables": "maximum likelihood"}
_CLEAR = 4.0  # sigmas that none of a few hundred shifts exceeds by chance
# Number of parameters that a sentence names.
_NAMED = 3

_Group = tuple[str, str, str]  # effect, deformation, estimator

# Limit of the colour scale: one parameter may shift by a hundred tolerances, and the others must stay visible.
_CLIPPED = 10.0
_COLOURS = (BLUE, ORANGE, GREEN, RED)
_SYMBOLS = ("circle", "x", "triangle-up", "diamond")


def absorbed_by(tables: Tables, key: Key) -> pd.DataFrame | None:
    """Return the absorption by a calibration's model of the structure, with tolerances of the parameters."""
    table = table_or_none(tables, "absorption")
    if table is None:
        return None
    rows = table[table["model"] == key[0]] if (table["model"] == key[0]).any() else table
    fitted = table_or_none(tables, "calibration")
    if fitted is None or "tolerance" not in fitted:
        return rows.assign(tolerance=float("nan"))
    names = ["model", "deformation", "leg", "parameter"]
    return rows.merge(fitted[[*names, "tolerance"]].drop_duplicates(names), on=names, how="left")


def _group_words(group: _Group) -> str:
    """Return the omitted effect and the fit in words: ``ignoring the deformation of the platform (implicit
    objectives)``."""
    return f"{_effect_words(*group[:2])} ({_ESTIMATORS.get(group[2], group[2])})"


def _effect_words(effect: str, deformation: str) -> str:
    """Return the omitted effect in words: ``ignoring the deformation of the platform``."""
    words = _EFFECTS.get(effect, effect)
    return f"ignoring {words}" if deformation == "none" else f"modelling {words} as {deformation}"


def groups(absorbed: pd.DataFrame) -> list[tuple[_Group, pd.DataFrame]]:
    """Return rows by effect, deformation model and estimator, those with the largest bias first."""
    parts = [(key, rows) for key, rows in absorbed.groupby(["effect", "deformation", "estimator"], sort=False)]
    return sorted(parts, key=lambda part: -_largest(part[1]))


def _leading_groups(absorbed: pd.DataFrame) -> list[tuple[_Group, pd.DataFrame]]:
    """Return for every estimator the group with the largest bias."""
    largest_groups: dict[str, tuple[_Group, pd.DataFrame]] = {}
    for key, rows in groups(absorbed):
        largest_groups.setdefault(key[2], (key, rows))
    return list(largest_groups.values())


def _largest(rows: pd.DataFrame) -> float:
    return float(np.nanmax(np.append(_size(rows), 0.0)))


def _size(rows: pd.DataFrame) -> NDArray:
    """Return the predicted shift of a parameter in tolerances, or in standard deviations where none has a tolerance."""
    scale = rows["tolerance"] if rows["tolerance"].notna().any() else rows["sigma"]
    return np.abs(rows["predicted"] / scale).to_numpy(dtype=float)


def most_shifted_words(absorbed: pd.DataFrame | None) -> str:
    """Return in words the parameters that the effect with the largest bias shifts most; empty where none is known.

    Only significant shifts of at least a tolerance are named.
    """
    if absorbed is None or not len(absorbed):
        return ""
    clear = absorbed[absorbed["predicted"].abs() > _CLEAR * absorbed["sigma"]]
    clear = clear[_size(clear) >= 1.0] if len(clear) else clear
    if not len(clear):
        return "Ignoring the measured deformation would bias no parameter by as much as its tolerance."
    group, rows = groups(clear)[0]
    top = rows.assign(size=_size(rows)).nlargest(_NAMED, "size", keep="first")
    words = _group_words(group)
    first, *more = (_bias(r) for r in top.itertuples())
    return f"{capitalised(words)} would bias {'; '.join([first, *more])}."


def _bias(r: Row) -> str:
    """``u_x of leg 6 by about -298 mrad (149 times its tolerance; the fit gave -135 ± 35 mrad)``."""
    factor, unit = print_unit(r.parameter, r.unit)
    details = []
    if r.tolerance == r.tolerance:
        details.append(f"{r.size:.0f} times its tolerance" if r.size >= 9.5 else f"{r.size:.1f} times its tolerance")
    if r.observed == r.observed:
        details.append(f"the fit gave {with_uncertainty(factor * r.observed, factor * r.sigma, unit)}")
    bias_text = f"{name_of(r.parameter, r.leg)} by about {plain(factor * r.predicted)} {unit}".strip()
    return printed(f"{bias_text} ({'; '.join(details)})" if details else bias_text)


def agreement(absorbed: pd.DataFrame) -> str:
    """Return in words the agreement of the fit with the linear prediction."""
    both = absorbed.dropna(subset=["predicted", "observed", "sigma"])
    standardised = ((both["observed"] - both["predicted"]) / both["sigma"]).abs()
    within = int((standardised <= 1.96).sum())
    text = f"{within} of {count_text(len(both), 'parameter')} agree with the line within their bars."
    return f"{text} Parameters far from the line are biased too much for a linear prediction, or by another cause."


def correlation(predicted: object, observed: object) -> float | None:
    """Return the correlation of two lists, if they are long enough and both vary."""
    x, y = np.asarray(predicted, float), np.asarray(observed, float)
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return None
    return float(np.corrcoef(x[known], y[known])[0, 1])


def absorption_map(absorbed: pd.DataFrame) -> go.Figure:
    """Return a map of predicted shifts per omitted effect: number in the parameter's unit, colour in tolerances."""
    parts = _leading_groups(absorbed.assign(kind=_kinds(absorbed)))
    titles = [capitalised(_group_words(key)) for key, _ in parts]
    heights = [rows["kind"].nunique() for _, rows in parts]
    spacing = 70.0 / (30.0 * sum(heights) + 70.0 * len(parts))
    grid = make_subplots(
        rows=len(parts),
        cols=1,
        subplot_titles=[label(t) for t in titles],
        row_heights=heights,
        vertical_spacing=spacing,
    )
    for row, (_, rows) in enumerate(parts, 1):
        grid.add_trace(_panel(rows), row=row, col=1)
    subtitle = f"Number: in the parameter's unit. Colour: in tolerances of the parameter, clipped at {_CLIPPED:g}"
    height = 140 + 30 * sum(heights) + 70 * len(parts)
    style(grid, "Absorption map: bias of each parameter if an effect is left out", subtitle, height)
    bar = {"title": {"text": "tolerances"}, "thickness": 16}
    grid.update_layout(coloraxis={"colorscale": "RdBu_r", "cmin": -_CLIPPED, "cmax": _CLIPPED, "colorbar": bar})
    grid.update_layout(margin={"t": 110})
    grid.update_xaxes(type="category", showgrid=False)
    grid.update_yaxes(type="category", autorange="reversed", automargin=True, showgrid=False)
    grid.update_annotations(font={"size": 13})
    return grid


def _kinds(rows: pd.DataFrame) -> list[str]:
    """Return kind and unit of every row's parameter: ``a_x (mm)``."""
    kinds = [
        (kind_of(name, leg), print_unit(name, unit)[1])
        for name, leg, unit in zip(rows["parameter"], rows["leg"], rows["unit"], strict=True)
    ]
    return [f"{kind} ({unit})" if unit else kind for kind, unit in kinds]


def _columns(rows: pd.DataFrame) -> list[str]:
    return [f"leg {int(leg)}" if leg == leg else "all legs" for leg in rows["leg"]]


def _printed(rows: pd.DataFrame, column: str) -> pd.Series:
    factors = [print_unit(name, unit)[0] for name, unit in zip(rows["parameter"], rows["unit"], strict=True)]
    return rows[column].to_numpy(dtype=float) * factors


def _panel(rows: pd.DataFrame) -> go.Heatmap:
    reported = rows.assign(place=_columns(rows), printed=_printed(rows, "predicted"))
    reported["size"] = reported["predicted"] / reported["tolerance"]
    order = (
        list(dict.fromkeys(reported["kind"])),
        list(dict.fromkeys(reported.sort_values("leg", kind="stable")["place"])),
    )
    wide = {
        c: reported.pivot(index="kind", columns="place", values=c).reindex(index=order[0], columns=order[1])
        for c in ("size", "printed")
    }
    return go.Heatmap(
        z=np.round(wide["size"].to_numpy(), 3),
        x=order[1],
        y=[f"{label(kind)} " for kind in order[0]],
        text=[[plain(v) if v == v else "" for v in row] for row in wide["printed"].to_numpy()],
        texttemplate="%{text}",
        coloraxis="coloraxis",
        xgap=1,
        ygap=1,
        hovertemplate="%{y} of %{x}: %{text}, %{z:.1f} tolerances<extra></extra>",
    )


def predicted_against_observed(absorbed: pd.DataFrame) -> go.Figure:
    """Return fitted against predicted shifts, a panel per kind of parameter, with the line of equality."""
    reported = absorbed.assign(kind=_kinds(absorbed))
    reported = reported.assign(
        x=_printed(reported, "predicted"), y=_printed(reported, "observed"), bar=BAR * _printed(reported, "sigma")
    )
    kinds = list(dict.fromkeys(reported["kind"]))
    titles = [_panel_title(kind, reported[reported["kind"] == kind]) for kind in kinds]
    grid, panels, rows = panel_grid(titles, 3, (0.09, lambda rows: 0.3 / rows))
    named: set[Any] = set()
    for kind, panel in zip(kinds, panels, strict=True):
        of_kind = reported[reported["kind"] == kind]
        grid.add_trace(_equality(of_kind), **panel)
        for number, (key, part) in enumerate(groups(absorbed)):
            points = of_kind.loc[of_kind.index.isin(part.index)]
            if len(points):
                grid.add_trace(_points(points, key, number, key not in named), **panel)
                named.add(key)
    subtitle = "Bars: 95 %; line: fit and prediction agree"
    style(grid, "Bias in the fit against bias predicted by linear algebra", subtitle, 170 + 230 * rows)
    grid.update_xaxes(title={"text": "predicted", "standoff": 4}, row=rows)
    grid.update_yaxes(title={"text": "observed"}, col=1)
    grid.update_layout(
        legend={"orientation": "h", "y": -0.16 / rows - 0.02, "yanchor": "top", "x": 0.0}, margin={"t": 100}
    )
    return grid


def _panel_title(kind: str, rows: pd.DataFrame) -> str:
    r = correlation(rows["x"], rows["y"])
    return label(kind) if r is None else f"{label(kind)}, r = {r:.3f}"


def _equality(rows: pd.DataFrame) -> go.Scatter:
    values = np.concatenate([rows["x"], rows["y"]]).astype(float)
    reach = [float(np.nanmin(values)), float(np.nanmax(values))]
    return go.Scatter(x=reach, y=reach, mode="lines", line={"color": GREY}, hoverinfo="skip", showlegend=False)


def _points(rows: pd.DataFrame, key: _Group, number: int, named: bool) -> go.Scatter:
    colour, symbol = _COLOURS[number % len(_COLOURS)], _SYMBOLS[number % len(_SYMBOLS)]
    return go.Scatter(
        x=rows["x"],
        y=rows["y"],
        mode="markers",
        marker={"color": colour, "size": 7, "symbol": symbol},
        error_y={"type": "data", "array": rows["bar"], "thickness": 1, "width": 0},
        text=[label(name_of(name, leg)) for name, leg in zip(rows["parameter"], rows["leg"], strict=True)],
        hovertemplate="%{text}: predicted %{x:.3g}, observed %{y:.3g}<extra></extra>",
        name=label(_group_words(key)),
        legendgroup=str(number),
        showlegend=named,
    )
