"""Gain by modelling the causes: errors of predictions before and after, compared with noise and plain calibrations."""

from __future__ import annotations

import html
import textwrap
from dataclasses import dataclass

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report.calibration.calibrations import DEFORMATIONS, EXTENDED, chosen_calibration, deformation_words
from truing.report.column_heads import RMS_AFTER, RMS_BEFORE, UNIT, Head
from truing.report.diagnosis.adequacy import shortcoming
from truing.report.diagnosis.assessed_causes import AssessedCause, modelled_of, share_removed
from truing.report.diagnosis.prediction_errors import (
    AT_THE_FLOOR,
    POINTS,
    Overall,
    PartNames,
    errors_of_models,
    part_names,
    reading_misses,
    rms_with_interval,
    root_mean_square,
)
from truing.report.diagnosis.reading_gain import by_channel, drawn_readings
from truing.report.diagnosis.validity import held_out_sentences, link_to_next_measurements
from truing.report.figure_style import (
    BLUE,
    GREY,
    MANY_POINTS,
    ORANGE,
    label,
    pose_axis,
    sequence_title,
    size_axis,
    style,
)
from truing.report.numbers import plain, rough, rough_quantity, sign
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.tables import Tables, table_or_none

_EVERY_POSE = (
    "Measured minus predicted. Each pose has the same weight here, each point at the head of the page. "
    "In brackets: 95 % intervals by bootstrap over poses"
)
_ALL = 0.9995  # share of the variance beyond noise that is rounded to 100 %
_ERROR = "position_error_um"

_ROLES = {"calibration": (POINTS.fitted, BLUE), "verification": (POINTS.held_out, ORANGE)}
_SYMBOLS = {"calibration": "circle", "verification": "diamond"}
_ROW, _AROUND = 55, 200
_LONG_NAME = 32  # characters in a line next to the bars
_SERIES = (("before", "without the causes", ORANGE), ("after", "with the causes", BLUE))
_AS_IT_IS = (("before", "simulation without changes", BLUE),)
_LEGEND = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}


@dataclass(frozen=True)
class _Missed:
    """Rms of measured minus predicted over the subset named by ``words``; before equals after where
    nothing was found."""

    words: str
    of: Overall
    modelled: bool

    @property
    def floor(self) -> float | None:
        """Rms by noise alone."""
        return self.of.floor


def gain_section(rows: list[AssessedCause], tables: Tables) -> ReportSection:
    """Return the section on measured minus predicted before and after, by subset and by cause, and on plain
    calibrations.

    ``rows``: all candidates; where none was found, the errors of the plain simulation.
    """
    modelled = modelled_of(rows)
    parts = part_names(tables)
    missed = [
        _Missed(_words_of(errors_of_model, parts), errors_of_model, bool(modelled))
        for errors_of_model in errors_of_models(rows, modelled, tables)
    ]
    reported = [*_errors_by_cause(modelled, parts), *_parts(missed, tables), *_plain(tables)]
    misses = reading_misses(tables)
    by_part = _by_role(tables) if misses is None else by_channel(misses)
    listings = [listing for listing in (by_part, _calibrations(tables)) if listing.rows]
    title = "Before and after" if modelled else "Errors of the predictions"
    lead = " ".join(
        [
            _opening_sentences(missed, parts, rows, passes=not shortcoming(tables)),
            *held_out_sentences(modelled, parts),
        ]
    )
    return ReportSection(
        "gain", title, lead, tuple(reported), tuple(listings), see=link_to_next_measurements(modelled, parts)
    )


def _words_of(overall: Overall, parts: PartNames) -> str:
    return f"{parts.held_out} ({parts.not_fitted})" if overall.held_out else parts.fitted


def _opening_sentences(missed: list[_Missed], parts: PartNames, rows: list[AssessedCause], *, passes: bool) -> str:
    """Return in words the remaining held-out errors against noise, and the share of the excess removed.
    ``passes``: whether no test of the final model fails."""
    if not missed:
        return "This run holds no errors of predictions."
    texts, removed = [_of_role(of_role) for of_role in missed], [_removed(of_role, passes) for of_role in missed]
    if len(set(removed)) == 1:
        texts.append(removed[0])
    else:
        texts = [words for pair in zip(texts, removed, strict=True) for words in pair]
    if not any(row.held_out[0] is not None for row in rows):
        texts.append(f"No {parts.single} was held out, so no prediction was tested on data that no fit had used.")
    return " ".join(filter(None, texts))


def _of_role(missed: _Missed) -> str:
    errors, after = missed.of, rough_quantity(missed.of.after, missed.of.unit)
    text = f"The rms error on {missed.words} is {after}"
    if missed.modelled:
        sizes = f"{rough_quantity(errors.before, errors.unit)} without the causes and {after} with them"
        text = f"The rms error on {missed.words} is {sizes}"
    if errors.floor is None:
        return f"{text}."
    floor = f"the noise floor ({rough_quantity(errors.floor, errors.unit)})"
    if errors.is_below_noise:
        return (
            f"{text}. {'The latter' if missed.modelled else 'This'} is significantly below {floor}: {errors.why_below}."
        )
    ratio = errors.after / errors.floor
    against = f"consistent with {floor}" if _at_floor(errors) else f"{rough(ratio)} times {floor}"
    if errors.of_fit > errors.floor:
        against += f"; the uncertainty of the fit alone gives {rough_quantity(errors.of_fit, errors.unit)}"
    return (
        f"{text}, {'which is ' * missed.modelled}{against}.{_of_chance(errors) if ratio < 1.0 / AT_THE_FLOOR else ''}"
    )


def _of_chance(errors: Overall) -> str:
    """Return the sentence on an error below the noise floor that no test calls significant."""
    if errors.freedom > 0.0:
        return " There are too few data to decide whether this is chance."
    return " Whether this is chance was not tested."


def _at_floor(overall: Overall) -> bool:
    return bool(overall.floor) and 1.0 / AT_THE_FLOOR <= overall.after / (overall.floor or 1.0) <= AT_THE_FLOOR


def _removed(missed: _Missed, passes: bool) -> str:
    """Return in words the share of the variance beyond noise that the causes explain; ``passes`` as above."""
    errors = missed.of
    if not missed.modelled or errors.floor is None or errors.is_below_noise:
        return ""
    share = share_removed(errors.before, errors.after, errors.floor)
    if share is None or share <= 0.0:
        return ""
    if share > _ALL:
        clean = passes and _at_floor(errors)
        return "No systematic error remains detectable." if clean else "The causes explain all variance beyond noise."
    return f"The causes explain {100.0 * share:.3g} % of the variance beyond noise."


def _errors_by_cause(findings: list[AssessedCause], parts: PartNames) -> Drawn:
    rows = [row for row in findings if row.rms[0] is not None and row.rms[1] is not None]
    units = dict.fromkeys(row.unit for row in rows)
    words = parts.fitted_or_not
    if not parts.is_of_points:
        start = "with what was found before"
        return [(misfit_figure(some, parts, *([start] if k else [])), words) for k, some in enumerate(_chained(rows))]
    return [(misfit_figure([row for row in rows if row.unit == unit], parts), words) for unit in units]


def _chained(rows: list[AssessedCause]) -> list[list[AssessedCause]]:
    """Return the causes in groups whose errors follow each other: each is assessed over the readings that it moves, so
    errors after one need not be those before the next."""
    groups: list[list[AssessedCause]] = []
    for row in rows:
        last = groups[-1][-1] if groups else None
        if last is not None and (last.rms[1], last.held_out[1], last.floor, last.unit) == (
            *(row.rms[0], row.held_out[0]),
            *(row.floor, row.unit),
        ):
            groups[-1].append(row)
        else:
            groups.append([row])
    return groups


def _parts(missed: list[_Missed], tables: Tables) -> Drawn:
    """Return figures of every pose, or of every reading of a bench."""
    modelled = any(of_role.modelled for of_role in missed)
    misses = reading_misses(tables)
    if misses is not None:
        return drawn_readings(misses, modelled)
    table = table_or_none(tables, "prediction")
    if table is None:
        return []
    diamonds = "Diamonds: held-out poses, not used in any fit." if table["role"].eq("verification").any() else ""
    lines = "Each line connects the errors of one pose before and after." if modelled else ""
    words = " ".join(filter(None, (lines, diamonds)))
    return [(_pose_by_pose(table, missed[0].floor if missed else None, modelled), words)]


def _by_role(tables: Tables) -> Listing:
    """Return rms and largest error over the poses of each role, with intervals from resampled poses."""
    table = table_or_none(tables, "prediction")
    heads = (
        Head("poses", "Use of the poses: fitted (calibration), or held out of every fit (verification)."),
        Head("number", "Number of poses."),
        Head("rms before", RMS_BEFORE),
        Head("rms after", RMS_AFTER),
        Head("largest before", "Largest absolute error of a single measured value, without the causes found."),
        Head("largest after", "Largest absolute error of a single measured value, with the causes found."),
        UNIT,
    )
    if table is None:
        return Listing(heads, ())
    rng = np.random.default_rng(0)
    roles = table["role"].replace("reference", "calibration")
    rows = []
    for role, words in (("calibration", POINTS.fitted), ("verification", POINTS.held_out)):
        of_role = table[roles == role]
        if not len(of_role):
            continue
        sizes = [rms_with_interval(of_role[f"rms_{when}"], rng) for when in ("before", "after")]
        most = [plain(of_role[f"largest_{when}"].max()) for when in ("before", "after")]
        rows.append((words, str(len(of_role)), *sizes, *most, sign(str(of_role["unit"].iloc[0]))))
    return Listing(heads, tuple(rows), caption=_EVERY_POSE, held_by="prediction.parquet")


def compared_calibrations(tables: Tables) -> pd.DataFrame | None:
    """Return the position errors of the plain calibrations of one structure, and of the extended model, in order."""
    accuracy = table_or_none(tables, "accuracy")
    if accuracy is None:
        return None
    extended = accuracy[accuracy["model"] == EXTENDED]
    chosen = chosen_calibration(tables)
    models = [m for m in accuracy["model"].unique() if m != EXTENDED]
    if not models:
        return None
    model = chosen[0] if chosen is not None and chosen[0] in models else models[0]
    plain_ones = accuracy[(accuracy["model"] == model) & accuracy["deformation"].isin(DEFORMATIONS)]
    parts = [(f"plain, {deformation_words(d)}", plain_ones[plain_ones["deformation"] == d]) for d in DEFORMATIONS]
    parts.append(("extended model", extended))
    reported = [part.assign(called=name) for name, part in parts if len(part)]
    return pd.concat(reported, ignore_index=True) if reported else None


def _plain(tables: Tables) -> Drawn:
    errors = compared_calibrations(tables)
    if errors is None:
        return []
    words = (
        "Plain calibrations, for comparison: they fit the geometry; the only cause they may model is a "
        "deforming platform."
    )
    return [(_errors_of_calibrations(errors), words)]


def _calibrations(tables: Tables) -> Listing:
    errors = compared_calibrations(tables)
    heads = (
        Head("calibration", "Model that predicts the position of the platform."),
        Head("poses", "Use of the poses: fitted (calibration), or held out of every fit (verification)."),
        Head(
            "position rms", "Root mean square of the distances between measured and predicted origin of the platform."
        ),
        Head("largest", "Largest distance between measured and predicted origin of the platform."),
        Head("noise alone", "Rms distance between measured and predicted origin that declared noise alone gives."),
        UNIT,
    )
    if errors is None:
        return Listing(heads, ())
    roles = errors["role"].replace("reference", "calibration")
    rows = tuple(
        (
            name,
            words,
            plain(root_mean_square(rows_of[_ERROR])),
            plain(rows_of[_ERROR].max()),
            plain(root_mean_square(rows_of["position_noise_um"])) if "position_noise_um" in rows_of else "–",
            "µm",
        )
        for name in dict.fromkeys(errors["called"])
        for role, words in (("calibration", POINTS.fitted), ("verification", POINTS.held_out))
        if len(rows_of := errors[(errors["called"] == name) & (roles == role)])
    )
    return Listing(heads, rows, caption="Position of the platform: extended model and plain calibrations", folded=True)


def misfit_figure(
    findings: list[AssessedCause], parts: PartNames = POINTS, start: str = "simulation without changes"
) -> go.Figure:
    """Return the rms of measured minus predicted before and after each accepted cause of one unit, with the noise
    floor."""
    names = [row.name for row in findings]
    numbers = [names[: k + 1].count(name) for k, name in enumerate(names)]  # bars of one name would cover each other
    numbered = [f"{name} ({number})" if number > 1 else name for name, number in zip(names, numbers, strict=True)]
    stages = [f"{start} ", *(f"+ {label(name)} " for name in numbered)]
    figure = go.Figure()
    fitted, held_out = [row.rms for row in findings], [row.held_out for row in findings]
    for name, colour, sizes in ((parts.fitted, BLUE, fitted), (parts.held_out, ORANGE, held_out)):
        heights = [sizes[0][0], *(after for _, after in sizes)]
        if all(height is None for height in heights):
            continue
        marker, words = {"color": colour}, [plain(height) for height in heights]
        figure.add_trace(go.Bar(y=stages, x=heights, name=name, orientation="h", text=words, marker=marker))
    unit = sign(findings[0].unit)
    subtitle = _floor_line(figure, findings[-1].floor, unit, vertical=True)
    style(figure, "Errors of the predictions, cause by cause", subtitle, _AROUND + _ROW * len(stages))
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    if max(map(len, stages)) > _LONG_NAME:  # longer names would leave no space for the bars
        lines = ["<br>".join(map(label, textwrap.wrap(html.unescape(stage), _LONG_NAME))) for stage in stages]
        figure.update_yaxes(tickmode="array", tickvals=stages, ticktext=lines)
    figure.update_xaxes(title_text=f"rms of measured − predicted ({unit})", rangemode="tozero")
    figure.update_layout(legend=_LEGEND, margin={"t": 100})
    return figure


def _floor_line(
    figure: go.Figure, floor: float | None, unit: str, vertical: bool = False, what: str = "noise floor"
) -> str:
    """Draw the rms by noise alone, and return the words for it; ``what``: its name."""
    if floor is None:
        return f"The {what} is not known"
    draw = figure.add_vline if vertical else figure.add_hline
    draw(**{"x" if vertical else "y": floor}, line={"color": GREY, "dash": "dot", "width": 2})
    return f"Dotted: {what}, {plain(floor)} {unit}"


def _pose_by_pose(table: pd.DataFrame, floor: float | None, modelled: bool) -> go.Figure:
    """Return the rms of measured minus predicted at every pose, without the findings and, if there are
    any, with them."""
    x, axis = pose_axis(table["pose"])
    roles = table["role"].replace("reference", "calibration").to_numpy()
    unit = sign(str(table["unit"].iloc[0]))
    figure = go.Figure()
    if modelled:
        figure.add_trace(_joins(x, table))
    shown = roles[0]  # the legend needs one role: the other has the same colours with other symbols
    scatter = go.Scattergl if len(table) > MANY_POINTS else go.Scatter
    for when, words, colour in _SERIES if modelled else _AS_IT_IS:
        for role, (name, _) in _ROLES.items():
            mask = roles == role
            if mask.any():
                texts = [
                    f"pose {label(pose)}: rms {plain(rms)}, largest {plain(most)} {unit}"
                    for pose, rms, most in zip(
                        table["pose"][mask], table[f"rms_{when}"][mask], table[f"largest_{when}"][mask], strict=True
                    )
                ]
                figure.add_trace(
                    scatter(
                        x=x[mask],
                        y=table[f"rms_{when}"][mask],
                        mode="markers",
                        marker={"color": colour, "symbol": _SYMBOLS[role], "size": 9 if role == "verification" else 6},
                        name=words if role == shown else f"{words}, {name}",
                        legendgroup=when,
                        showlegend=bool(role == shown),
                        text=texts,
                        hovertemplate="%{text}<extra></extra>",
                    )
                )
    sizes = np.concatenate([table["rms_before"], table["rms_after"]])
    scale = size_axis(sizes)
    subtitle = _floor_line(figure, floor, unit)
    style(figure, "Errors of the predictions, pose by pose", subtitle, 420)
    figure.update_xaxes(zeroline=False, **axis)
    figure.update_yaxes(title_text=sequence_title(f"rms of measured − predicted ({unit})", "type" in scale), **scale)
    figure.update_layout(legend=_LEGEND, margin={"t": 110})
    return figure


def _joins(at: np.ndarray, table: pd.DataFrame) -> go.Scatter:
    """Return a line from before to after at every pose."""
    x = np.repeat(at.astype(float), 3)
    y = np.stack([table["rms_before"], table["rms_after"], np.full(len(table), np.nan)], axis=1).ravel()
    line = {"color": GREY, "width": 1}
    return go.Scatter(x=x, y=y, mode="lines", line=line, opacity=0.4, hoverinfo="skip", showlegend=False)


def _errors_of_calibrations(errors: pd.DataFrame) -> go.Figure:
    """Return the rms position error of each calibration (column ``called``), at fitted and held-out poses."""
    roles = errors["role"].replace("reference", "calibration")
    squares = errors["position_error_um"].astype(float) ** 2
    sizes = np.sqrt(squares.groupby([errors["called"], roles]).mean())
    names = list(dict.fromkeys(errors["called"]))
    figure = go.Figure()
    for role, (words, colour) in _ROLES.items():
        rms_errors = [float(sizes.get((name, role), np.nan)) for name in names]
        if not np.isfinite(rms_errors).any():
            continue
        figure.add_trace(
            go.Bar(
                y=[f"{label(name)} " for name in names],
                x=rms_errors,
                name=words,
                orientation="h",
                marker={"color": colour},
                text=[plain(size) for size in rms_errors],
            )
        )
    subtitle = _floor_line(figure, _noise(errors), "µm", vertical=True, what="rms position error by noise alone")
    title = "Position error: extended model and plain calibrations"
    style(figure, title, subtitle, _AROUND + _ROW * len(names))
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    scale = size_axis(sizes.to_numpy())
    figure.update_xaxes(title_text=sequence_title("rms error of position (µm)", "type" in scale), **scale)
    figure.update_layout(legend=_LEGEND, margin={"t": 100})
    return figure


def _noise(errors: pd.DataFrame) -> float | None:
    """Return the rms by noise at held-out poses, otherwise at all, of the last calibration in the table."""
    if "position_noise_um" not in errors:
        return None
    rows = errors[errors["called"] == errors["called"].iloc[-1]]
    rows = rows[rows["role"] == "verification"] if (rows["role"] == "verification").any() else rows
    known = rows["position_noise_um"].dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else None
