"""Gain by modelling the causes on a bench: every reading before and after, channel by channel."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from truing.report.column_heads import CHANNEL, RMS_AFTER, RMS_BEFORE, UNIT, Head
from truing.report.diagnosis.prediction_errors import READINGS, channels_of, rms_with_interval, root_mean_square
from truing.report.figure_style import BLUE, GREY, MANY_POINTS, ORANGE, label, style
from truing.report.numbers import plain, rough, sign
from truing.report.page import Drawn, Listing
from truing.report.tables import LOAD_UNITS, SEVERAL, axes_loaded_by_run, axes_of, is_unloading, loaded_by_run

_HEADS = (
    CHANNEL,
    Head("runs", "Number of runs in which the channel was read."),
    Head("readings", "Number of readings of the channel."),
    Head("noise alone", "Rms error that the noise of the readings alone gives."),
    Head("rms before", RMS_BEFORE),
    Head("rms after", RMS_AFTER),
    Head("largest before", "Largest absolute error of a single measured value, without the causes found."),
    Head("largest after", "Largest absolute error of a single measured value, with the causes found."),
    UNIT,
)

_SERIES = (("before", "without the causes", ORANGE, "circle-open"), ("after", "with the causes", BLUE, "circle"))
_AS_IT_IS = (("before", "simulation without changes", BLUE, "circle"),)
_LEGEND = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}
# Least misfit over noise for a panel of a channel under a load, and most panels.
_TELLING, _PANELS, _FEWEST_PANELS = 1.5, 6, 2
_BAND = 1.96
_RUNS_NAMED = 14
_CHANNELS = 6  # most channels of a figure, to be readable on A4
# Colour scale: white at the noise, dark at 100 times the noise.
_COLOURS = ((0.0, "#FFFFFF"), (0.15, "#FFF3DC"), (0.5, "#F2B84B"), (1.0, "#B8480F"))
_DARKEST = 100.0


def drawn_readings(misses: pd.DataFrame, modelled: bool) -> Drawn:
    """Return figures of the misfit by channel and load, over the load, and in time."""
    unknown = channels_of(misses[misses["noise_floor"].isna()])
    left = "the residual with the causes modelled"
    words = f"Noise as declared; for {', '.join(unknown)} it is {left}" if unknown else "Noise as declared"
    if len(unknown) == misses["channel"].nunique():
        words = f"The noise is {left}"
    straight = "A straight line through zero is a wrong slope. Loading and unloading differ by hysteresis or creep."
    drawings = [(where_missed(misses, modelled), f"{words}.")]
    if axes_of(misses):
        drawings.append((against_load(misses, modelled), straight))
    walk = "Each block is a run with its loaded axis. One zero per run and channel is subtracted."
    return [*drawings, *((figure, walk) for figure in in_order(misses, modelled))]


def by_channel(misses: pd.DataFrame) -> Listing:
    """Return rms and largest error of each channel, held-out runs apart, with intervals from resampled runs."""
    rng = np.random.default_rng(0)
    held_out = misses["role"].eq("verification")
    rows = tuple(
        (f"{channel}, {words}" if held_out.any() else channel, *_cells(of_channel, rng))
        for channel in channels_of(misses)
        for words, chosen in ((READINGS.fitted, ~held_out), (READINGS.held_out, held_out))
        if len(of_channel := misses[chosen & misses["channel"].eq(channel)])
    )
    caption = "Measured minus predicted, channel by channel; in brackets 95 % intervals by bootstrap over runs"
    return Listing(_HEADS, rows, caption=caption, held_by="reading_errors.parquet")


def _cells(table: pd.DataFrame, rng: np.random.Generator) -> tuple[str, ...]:
    runs = table.groupby("run", sort=False)
    counts = runs.size()
    sizes = [rms_with_interval(runs[when].agg(root_mean_square), rng, counts) for when in ("before", "after")]
    most = [plain(table[when].abs().max()) for when in ("before", "after")]
    noise = plain(root_mean_square(table["noise_floor"]))
    return (str(len(counts)), f"{len(table):,}", noise, *sizes, *most, sign(str(table["unit"].iloc[0])))


def where_missed(misses: pd.DataFrame, modelled: bool) -> go.Figure:
    """Return the rms of measured minus predicted over noise, a cell per channel and load axis, before and after."""
    series = _series(modelled)
    figure = make_subplots(1, len(series), subplot_titles=[words for _, words, _, _ in series], shared_yaxes=True)
    loaded = loaded_by_run(misses)
    channels = channels_of(misses)
    axes = [load for load in (*axes_of(misses), SEVERAL, "none") if (loaded == load).any()]
    parts = dict(iter(misses.groupby(["channel", loaded])))
    for column, (when, _, _, _) in enumerate(series, 1):
        ratio = np.array(
            [[_error_to_noise_ratio(parts.get((c, a), misses.iloc[:0]), when) for a in axes] for c in channels]
        )
        figure.add_trace(
            go.Heatmap(
                z=np.log10(np.clip(ratio, 1.0, _DARKEST)),
                x=axes,
                y=channels,
                zmin=0.0,
                zmax=np.log10(_DARKEST),
                colorscale=_COLOURS,
                showscale=False,
                text=[[rough(value) if np.isfinite(value) else "" for value in line] for line in ratio],
                texttemplate="%{text}",
                xgap=2,
                ygap=2,
                hovertemplate="%{y} under %{x}: %{text} times the noise<extra></extra>",
            ),
            1,
            column,
        )
    words = "Rms of measured − predicted in units of the noise: 1 is noise; empty: not measured"
    style(figure, "Errors of the predictions by channel and load", words, 150 + 30 * len(channels))
    figure.update_xaxes(title_text="load", showgrid=False)
    figure.update_yaxes(autorange="reversed", showgrid=False)
    figure.update_layout(margin={"t": 96})
    return figure


def against_load(misses: pd.DataFrame, modelled: bool) -> go.Figure:
    """Return measured minus predicted against the load, a panel for each channel and load with a large misfit."""
    panels = _panels(misses)
    rows = -(-len(panels) // 2)
    titles = [f"{label(c)} under {a} ({sign(_unit(misses, c))})" for c, a in panels]
    figure = make_subplots(rows, 2, subplot_titles=titles, vertical_spacing=0.34 / rows, horizontal_spacing=0.12)
    shapes: list[dict[str, object]] = []
    for index, (channel, axis) in enumerate(panels):
        readings_under_load = _readings_under_load(misses, channel, axis)
        for when, words, colour, _ in _series(modelled):
            for back, symbol in ((False, "triangle-up"), (True, "triangle-down")):
                part = readings_under_load[is_unloading(readings_under_load, axis) == back]
                figure.add_trace(
                    go.Scatter(
                        x=part[axis],
                        y=part[when],
                        mode="markers",
                        marker={"color": colour, "symbol": f"{symbol}-open" if when == "before" else symbol, "size": 7},
                        name=words,
                        legendgroup=when,
                        showlegend=index == 0 and not back,
                        hovertemplate="%{x} " + LOAD_UNITS[axis] + ": %{y:.3g}<extra>" + words + "</extra>",
                    ),
                    index // 2 + 1,
                    index % 2 + 1,
                )
        shapes += _band(readings_under_load, index + 1)
        figure.update_xaxes(title_text=f"{axis} ({LOAD_UNITS[axis]})", row=index // 2 + 1, col=index % 2 + 1)
    words = "Measured − predicted, where largest relative to the noise (grey: 95 %). Marks pointing up: loading"
    style(figure, "Errors of the predictions against the load", words, 160 + 270 * rows)
    figure.update_yaxes(zeroline=True, zerolinecolor=GREY)
    figure.update_layout(legend={**_LEGEND, "y": 1.0 + 0.18 / rows}, margin={"t": 136}, shapes=shapes)
    return figure


def in_order(misses: pd.DataFrame, modelled: bool) -> list[go.Figure]:
    """Return measured minus predicted in the order of measurement, a panel per channel, in figures of page size."""
    channels = channels_of(misses)
    kinds = [[c for c in channels if c.startswith("v") is signal] for signal in (False, True)]
    parts = [kind[k : k + _CHANNELS] for kind in kinds for k in range(0, len(kind), _CHANNELS)]
    texts = [f": {label(part[0])} to {label(part[-1])}" if len(parts) > 1 else "" for part in parts]
    return [_in_order(misses, modelled, part, words) for part, words in zip(parts, texts, strict=True)]


def _in_order(misses: pd.DataFrame, modelled: bool, channels: list[str], title: str) -> go.Figure:
    """Return a figure with a panel per channel and separate runs."""
    figure = make_subplots(len(channels), 1, vertical_spacing=0.3 / max(len(channels), 2))
    shapes: list[dict[str, object]] = []
    scatter = go.Scattergl if len(misses) > MANY_POINTS else go.Scatter
    for row, channel in enumerate(channels, 1):
        of_channel = misses[misses["channel"] == channel].reset_index(drop=True)
        unit = sign(_unit(misses, channel))
        for when, words, colour, symbol in _series(modelled):
            figure.add_trace(
                scatter(
                    x=np.arange(len(of_channel)),
                    y=of_channel[when],
                    mode="markers",
                    marker={"color": colour, "symbol": symbol, "size": 5},
                    name=words,
                    legendgroup=when,
                    showlegend=row == 1,
                    text=_texts(of_channel, unit, when),
                    hovertemplate="%{text}<extra></extra>",
                ),
                row,
                1,
            )
        shapes += [*_band(of_channel, row), *_between_runs(of_channel, row)]
        figure.update_yaxes(title_text=f"{label(channel)} ({unit})", zerolinecolor=GREY, row=row, col=1)
        figure.update_xaxes(**_run_axis(of_channel), row=row, col=1)
    words = "Measured − predicted, run after run; grey: 95 % range of the noise"
    style(figure, f"Errors of the predictions in order of measurement{title}", words, 140 + 130 * len(channels))
    figure.update_layout(legend=_LEGEND, margin={"t": 110}, shapes=shapes)
    return figure


def _series(modelled: bool) -> tuple[tuple[str, str, str, str], ...]:
    return _SERIES if modelled else _AS_IT_IS


def _readings_under_load(misses: pd.DataFrame, channel: str, axis: str) -> pd.DataFrame:
    """Return readings of a channel in the runs that load an axis, unloaded steps included."""
    rows = misses[misses["channel"] == channel]
    loaded = rows[axis].ne(0.0).groupby(rows["run"]).transform("any")
    return rows[loaded]


def _error_to_noise_ratio(table: pd.DataFrame, when: str) -> float:
    noise = root_mean_square(table["noise"])
    return root_mean_square(table[when]) / noise if noise > 0.0 else float("nan")


def _unit(misses: pd.DataFrame, channel: str) -> str:
    return str(misses.loc[misses["channel"] == channel, "unit"].iloc[0])


def _panels(misses: pd.DataFrame) -> list[tuple[str, str]]:
    """Return channels and load axes with the largest misfit relative to noise."""
    sizes = {}
    for channel in channels_of(misses):
        rows = misses[misses["channel"] == channel]
        loaded = axes_loaded_by_run(rows)
        several = loaded.sum(axis=1) > 1
        for axis in axes_of(misses):
            under = loaded[axis]
            sizes[channel, axis] = _channel_misfit(rows[under], axis, several=bool(several[under].any()))
    known = sorted((key for key, size in sizes.items() if np.isfinite(size)), key=lambda key: -sizes[key])
    informative = [key for key in known if sizes[key] > _TELLING]
    return (informative if len(informative) >= _FEWEST_PANELS else known[:_FEWEST_PANELS])[:_PANELS]


def _band(table: pd.DataFrame, panel: int) -> list[dict[str, object]]:
    """Return the band of 95 % of the noise, as a shape of a panel (from 1)."""
    noise = _BAND * root_mean_square(table["noise"])
    if not noise > 0.0:
        return []
    number = "" if panel == 1 else str(panel)
    shape = {"xref": f"x{number} domain", "yref": f"y{number}", "x0": 0.0, "x1": 1.0, "y0": -noise, "y1": noise}
    return [{"type": "rect", **shape, "fillcolor": GREY, "opacity": 0.2, "line": {"width": 0}, "layer": "below"}]


def _between_runs(table: pd.DataFrame, panel: int) -> list[dict[str, object]]:
    """Return lines between runs, as shapes of a panel, because separate calls of plotly are slow."""
    line, number = {"color": GREY, "width": 0.5, "dash": "dot"}, "" if panel == 1 else str(panel)
    shape = {"type": "line", "xref": f"x{number}", "yref": f"y{number} domain", "y0": 0.0, "y1": 1.0, "line": line}
    return [{**shape, "x0": x, "x1": x} for x in (_first_of_runs(table)[1:] - 0.5).tolist()]


def _first_of_runs(table: pd.DataFrame) -> NDArray[np.int64]:
    """Return the rows in which a run begins."""
    return np.flatnonzero(table["run"].ne(table["run"].shift()).to_numpy())


def _channel_misfit(table: pd.DataFrame, axis: str, *, several: bool) -> float:
    """Return the misfit of a channel over noise; under several loads in a run, of the part correlated with this one."""
    size = _error_to_noise_ratio(table, "before")
    if not several:
        return size
    load = table[axis].to_numpy(dtype=float)
    shapes = np.stack([load, np.abs(load)])
    shapes = shapes[shapes.std(axis=1) > 0.0]
    missed = table["before"].to_numpy(dtype=float)
    if not len(shapes) or missed.std() == 0.0:
        return 0.0
    return size * float(np.abs(np.corrcoef(np.vstack([missed, shapes]))[0, 1:]).max())


def _texts(table: pd.DataFrame, unit: str, when: str) -> list[str]:
    return [
        f"run {label(run)}, step {step}: {plain(missed)} {unit}"
        for run, step, missed in zip(table["run"], table["step"], table[when], strict=True)
    ]


def _run_axis(table: pd.DataFrame) -> dict[str, object]:
    """Return the names of the runs where there is space for them."""
    first = _first_of_runs(table)
    middles = 0.5 * (first + np.append(first[1:], len(table)) - 1.0)
    shown = range(0, len(first), max(1, -(-len(first) // _RUNS_NAMED)))
    names = [_run_words(table[table["run"] == table["run"].iloc[first[k]]]) for k in shown]
    return {
        "tickvals": [middles[k] for k in shown],
        "ticktext": names,
        "showgrid": False,
        "zeroline": False,
        "range": [-1, len(table)],
    }


def _run_words(run: pd.DataFrame) -> str:
    """Return a run with its axis, if it loads a single one: ``3: fz``."""
    loaded = axes_of(run)
    return f"{label(run['run'].iloc[0])}: {loaded[0]}" if len(loaded) == 1 else label(run["run"].iloc[0])
