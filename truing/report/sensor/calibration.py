"""Section of a sensor's calibration: choice of the model, G_B, errors by class, and comparison with theory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.belonging.relation import RelationState
from truing.report.calibration.with_findings import compared_calibrations, data_words
from truing.report.column_heads import LOAD, UNIT, Head
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.load_corrections import load_warning
from truing.report.figure_style import BAR, BLUE, GREEN, GREY, ORANGE, RED, style
from truing.report.model_tests import ModelTest, below_noise, listing_of
from truing.report.numbers import plain, with_uncertainty
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import LOAD_UNITS, LOADS, WHY_NOT, Tables, cell, reason, table_or_none
from truing.schemas.verdict import BY_A_FACTOR, ReasonCode

_TITLE = "Calibration of the sensor"
_TYPES = {"type_1_error": "Type 1, with the synthetic error", "type_2_error": "Type 2, without"}
_ANGLES = {"type_1_angle": "angle, with the synthetic error (deg)", "type_2_angle": "angle, without (deg)"}
_NOISE, _OWN_SCATTER = "that of noise", "the scatter of fitted loads"
_AT_NOISE = 1.1  # largest error over noise that counts as noise
_AS_PRINTED = "least squares, direct, zero none, linear"

_COLOURS = dict(zip(LOADS, (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9"), strict=True))
_WIDE = 30.0
# Name and style by matrix and model.
_SHOWN = {
    ("G", ""): ("G", GREY, "line-ew-open"),
    ("G", "elastic joints"): ("G, elastic joints", GREEN, "square-open"),
    ("G'", ""): ("G'", ORANGE, "diamond-open"),
    ("G_B'", ""): ("G_B'", BLUE, "circle"),
}


def calibration(tables: Tables) -> ReportSection | None:
    """Return the section of the choice among calibrations, the matrix, errors by class, and figures of merit."""
    if "sensor_matrix" not in tables:
        return None
    matrices = table_or_none(tables, "sensor_matrix")
    if matrices is None:
        return ReportSection("calibration", _TITLE, _reason_words(tables))
    choice, classes, merit = (
        table_or_none(tables, name) for name in ("sensor_choice", "error_classes", "sensor_merit")
    )
    largest = _largest(tables)
    shown: Drawn = []
    listings: list[Listing] = []
    if choice is not None:
        words = "Each load case is predicted by a fit without it. A term that does not reduce these errors is left out."
        shown.append((held_out_errors(choice, largest), words))
        listings += [*compared_calibrations(tables), _matrix(matrices), _choices(choice, largest)]
    if classes is not None and classes["value"].notna().any():
        words = "Definitions: under Reference. Loads by the chosen calibration, relative to the zero of each run."
        shown.append((error_classes(classes), words))
    if classes is not None:
        listings.append(_classes(classes))
    if merit is not None:
        shown += _merit_drawn(merit)
        listings += [_merits(merit), *_types(merit)]
    lead = _opening_sentences(tables, choice, matrices, largest)
    tests = _tests(choice)
    listings.insert(0, listing_of(tests, "Tests of the chosen calibration"))
    return ReportSection("calibration", _TITLE, lead, tuple(shown), tuple(listings))


def calibration_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the held-out errors of the chosen calibration against noise."""
    if "sensor_matrix" not in tables:
        return None
    choice = table_or_none(tables, "sensor_choice")
    tests = _tests(choice) if table_or_none(tables, "sensor_matrix") is not None else []
    evaluated = [test for test in tests if test.holds is not None]
    failed = [test for test in evaluated if not test.holds]
    if not failed and (warning := load_warning(assessed_causes(tables), tables)):
        return SectionVerdict("calibration", RelationState.ATTENTION, ReasonCode.CAUSE_LEFT_OUT, warning)
    if choice is None or not evaluated:
        why = tests[0].statement if tests else _reason_words(tables)
        text = f"Calibration not tested: {why}"
        return SectionVerdict("calibration", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    chosen = _chosen_model(choice)
    if not failed:
        text = (
            f"The calibration {chosen} fits: {'; '.join(test.question for test in evaluated)}. "
            f"{_share_words(choice, _largest(tables))}"
        )
        return SectionVerdict("calibration", RelationState.OK, ReasonCode.FITS, text)
    text = f"The calibration {chosen} fails the test whether {failed[0].question}. {failed[0].statement} "
    text += _share_words(choice, _largest(tables))
    value = choice[choice["model"] == chosen].drop_duplicates("figure").set_index("figure")["value"]
    ratio = max(filter(None, (_ratio(value, role) for role in ("heldout", "verification"))))
    state = RelationState.FAILS if ratio > BY_A_FACTOR else RelationState.ATTENTION
    return SectionVerdict("calibration", state, ReasonCode.HELD_OUT_MISSED, text, ratio, "1", _AT_NOISE)


def _tests(choice: pd.DataFrame | None) -> list[ModelTest]:
    """Return the test of the chosen calibration: are its held-out errors within noise?"""
    facts = pd.Series(dtype=float)
    if choice is not None:
        rows = choice[choice["model"] == _chosen_model(choice)]
        facts = rows.drop_duplicates("figure").set_index("figure")["value"]
    # Unweighted least squares takes its noise from the residuals, so that what the model lacks counts as noise.
    noise = _OWN_SCATTER if facts.get("noise_from_residuals", 0.0) == 1.0 else _NOISE
    compared = "the noise" if noise == _NOISE else noise
    agreement_text = f"errors of held-out loads agree with {compared}"
    verified = f"errors in the verification runs agree with {compared}"
    if choice is None:
        return [ModelTest(claim, None, "G_B was not evaluated.") for claim in (agreement_text, verified)]
    return [
        _misfit_test(agreement_text, facts, "heldout", noise, "Nothing was held out."),
        _misfit_test(
            verified, facts, "verification", noise, "No run has role verification, or its noise is not known."
        ),
    ]


def _misfit_test(question: str, facts: pd.Series, role: str, noise: str, why_not: str) -> ModelTest:
    times = _ratio(facts, role)
    if times is None:
        return ModelTest(question, None, why_not)
    chi_square, freedom = (float(facts[f"{role}_{name}"]) for name in ("chi_square", "freedom"))
    if (small := below_noise(question, chi_square, freedom, "the declared noise is too large")) is not None:
        return small
    return ModelTest(question, times <= _AT_NOISE, f"The rms error is {plain(times)} times {noise}.")


def _ratio(facts: pd.Series, role: str) -> float | None:
    """Return the rms error over noise; None where unknown."""
    chi_square, freedom = facts.get(f"{role}_chi_square"), facts.get(f"{role}_freedom")
    if chi_square is None or freedom is None or not freedom > 0.0:
        return None
    return float(np.sqrt(chi_square / freedom))


def _reason_words(tables: Tables) -> str:
    return reason(tables, "sensor_matrix") or "The campaign holds no signals of a sensor."


def _largest(tables: Tables) -> dict[str, float]:
    """Return the largest load of every loaded axis."""
    steps = table_or_none(tables, "signals")
    if steps is None:
        return {}
    largest_load = {load: float(steps[column].abs().max()) for load, column in LOADS.items()}
    return {load: size for load, size in largest_load.items() if size > 0.0}


def _heldout(choice: pd.DataFrame, largest: dict[str, float]) -> tuple[pd.Series, dict[str, float]]:
    """Return the rms errors of the chosen calibration on held-out loads, and their shares of the largest load, %."""
    rows = choice[choice["model"] == _chosen_model(choice)]
    value = rows[rows["figure"] == "heldout_rms"].set_index("subject")["value"]
    return value, {load: 100.0 * float(value[load]) / largest[load] for load in largest if load in value}


def _share_words(choice: pd.DataFrame, largest: dict[str, float]) -> str:
    """Return the sentence on the errors of held-out loads; empty where none is known."""
    value, share = _heldout(choice, largest)
    if not share:
        return ""
    worst = max(share, key=lambda load: share[load])
    return (
        f"The rms error on held-out loads is {plain(min(share.values()))} to {plain(share[worst])} % "
        f"of the largest load; it is largest for {worst}, {plain(value[worst])} {LOAD_UNITS[worst]}."
    )


def _opening_sentences(
    tables: Tables, choice: pd.DataFrame | None, matrices: pd.DataFrame, largest: dict[str, float]
) -> str:
    if choice is None:
        why = tables["sensor_matrix"].attrs.get(WHY_NOT) or "no signals"
        return f"G from nominal dimensions only. G_B is not evaluated: {why}."
    chosen = _chosen_model(choice)
    rows = choice[choice["model"] == chosen]
    _, share = _heldout(choice, largest)
    worst = max(share, key=lambda load: share[load])
    texts = [
        f"Chosen calibration: {chosen} (estimator, direction of the fit, zero, terms).",
        _share_words(choice, largest),
    ]
    printed = choice[(choice["model"] == _AS_PRINTED) & (choice["figure"] == "heldout_rms")]
    if len(printed) and chosen != printed["model"].iloc[0]:
        printed_share = 100.0 * float(printed.set_index("subject")["value"][worst]) / largest[worst]
        if printed_share > 1.5 * share[worst]:
            texts.append(f"With ordinary least squares and no zero, it is {plain(printed_share)} % for {worst}.")
    texts += _verified(rows)
    texts += filter(None, [data_words(tables)])
    equal = choice[(choice["figure"] == "indistinguishable") & (choice["value"] == 1.0)]["model"]
    if len(equal):
        texts.append(
            f"These data do not distinguish the chosen calibration from: {', '.join(equal)}. The simplest is chosen."
        )
    if (rows["figure"] == "tared").any() and float(rows.loc[rows["figure"] == "tared", "value"].iloc[0]):
        texts.append(
            "Unloaded signals differ between runs by more than noise, so signals are relative to each run's zero."
        )
    return " ".join(texts)


def _verified(table: pd.DataFrame) -> list[str]:
    checked = table[table["figure"] == "verification_rms"]
    if not len(checked):
        return []
    named = ", ".join(f"{r.subject} {plain(r.value)} {LOAD_UNITS[r.subject]}" for r in checked.itertuples())
    return [f"The rms error in the verification runs is {named}."]


def _chosen_model(choice: pd.DataFrame) -> str:
    return str(choice.loc[(choice["figure"] == "chosen") & (choice["value"] == 1.0), "model"].iloc[0])


def _matrix(matrices: pd.DataFrame) -> Listing:
    """Return G_B of the chosen calibration, each entry with the larger of its two sigmas."""
    chosen = matrices[(matrices["matrix"] == "G_B") & matrices["chosen"]]
    columns = list(dict.fromkeys(chosen["column_name"]))
    table = {(r.row, r.column_name): r for r in chosen.itertuples()}
    rows = []
    for load in LOADS:
        cells = []
        for column in columns:
            entry = table[load, column]
            sigma = np.nanmax([entry.sigma, getattr(entry, "sigma_by_case", np.nan)])
            cells.append(with_uncertainty(entry.value, float(sigma)))
        rows.append((f"{load} ({LOAD_UNITS[load]})", *cells))
    heads = (LOAD, *(Head(f"per mV of {column}", _PER_MV) for column in columns))
    csv = chosen.drop(columns=["chosen", "matrix"]).to_csv(index=False)
    caption = "G_B of the chosen calibration. ±: larger standard deviation, by the fit or by leaving out load cases"
    return Listing(heads, tuple(rows), (), caption, held_by="sensor_matrix.parquet", csv=csv)


_PER_MV = "Entry of G_B: part of the load, in N or N·m, that one millivolt of this signal indicates."


def _choices(choice: pd.DataFrame, largest: dict[str, float]) -> Listing:
    chosen, rows, marks = _chosen_model(choice), [], []
    for model in dict.fromkeys(choice["model"]):
        of_model = choice[choice["model"] == model]
        facts = (
            of_model[of_model["subject"].isna()].set_index("figure")["value"]
            if "subject" in of_model
            else of_model.set_index("figure")["value"]
        )
        if (of_model["figure"] == "refused").any():
            rows.append((model, *[""] * (len(largest) + 3), cell(of_model["reason"].iloc[0])))
            marks.append("none")
            continue
        value = of_model[of_model["figure"] == "heldout_rms"].set_index("subject")["value"]
        ratio = float(np.sqrt(facts["heldout_chi_square"] / facts["heldout_freedom"]))
        text = "chosen" if model == chosen else "equal" if facts.get("indistinguishable") == 1.0 else ""
        sizes = [plain(float(value[load])) for load in largest]
        rows.append(
            (model, *sizes, plain(ratio), plain(facts.get("heldout_log_density")), plain(facts.get("parameters")), text)
        )
        marks.append("pass" if text == "chosen" else "none" if text else "")
    heads = (
        Head("model", "Form of the calibration: which terms of the signals or loads it has."),
        *(Head(f"{load} ({LOAD_UNITS[load]})", _HELD_OUT_ERROR) for load in largest),
        Head("error / noise", "Error on held-out loads over that of the noise of the signals; 1: noise alone."),
        Head(
            "log density", "Log of the probability density of the held-out data; the larger, the better the prediction."
        ),
        Head("numbers", "Number of free parameters of the model."),
        Head("choice", "Marks the chosen model and those that are as good; for a refused model its reason."),
    )
    caption = "All calibrations, rms error on held-out loads. Equal: as good as the chosen one"
    return Listing(heads, tuple(rows), tuple(marks), caption, len(rows) > 12, "sensor_choice.parquet")


_HELD_OUT_ERROR = "Root mean square error of this load component on held-out loads."


def _classes(classes: pd.DataFrame) -> Listing:
    rows, marks = [], []
    for r in classes.itertuples():
        if r.value is None or r.value != r.value:
            rows.append((r.load, r.error_class, "", "not evaluated", "", "", cell(getattr(r, "reason", None))))
            marks.append("none")
            continue
        is_observed = abs(r.value) > r.limit
        at = "" if r.applied != r.applied else f"{plain(r.applied)} {LOAD_UNITS[r.load]}"
        value = with_uncertainty(r.value, r.sigma)
        rows.append(
            (
                r.load,
                r.error_class,
                r.indicated,
                value,
                plain(r.limit),
                at,
                "significant" if is_observed else "within noise",
            )
        )
        marks.append("warn" if is_observed else "")
    heads = (
        LOAD,
        Head("class", "Name of the error in laboratory terms."),
        Head("indicated by", "Load component of the calibration in which the error shows."),
        Head("%", "Size of the error in per cent of the range, with one standard deviation."),
        Head("noise limit, %", "Size that noise alone exceeds rarely; larger errors are significant."),
        Head("at", "Applied load at which the error is largest."),
        Head("verdict", "Whether the error is significant or within noise."),
    )
    caption = "Error classes of every axis, per cent of the range (interpolation: of the load)"
    return Listing(heads, tuple(rows), tuple(marks), caption, True, "error_classes.parquet")


def _merit_drawn(merit: pd.DataFrame) -> Drawn:
    lengths = merit.loc[merit["matrix"].isin(["G", "G_B'"]), "length_m"].dropna()
    if not len(lengths) or not (merit["figure"] == "sensitivity").any():
        return []
    words = "G: nominal. G': with assembly errors of one sigma and the largest displacement. G_B': the calibration. "
    words += "Elastic joints carry a part of a load that the cells in the legs do not measure."
    return [(_merit_figure(merit, float(lengths.min())), words)]


def _merits(merit: pd.DataFrame) -> Listing:
    shown = merit[~merit["figure"].isin([*_TYPES, *_ANGLES])]
    rows = tuple(
        (
            r.matrix,
            r.figure.replace("_", " "),
            cell(r.subject),
            with_uncertainty(r.value, r.sigma),
            "" if r.unit == "1" else r.unit,
            "" if r.length_m != r.length_m else f"{plain(r.length_m)} m",
        )
        for r in shown.itertuples()
    )
    heads = (
        Head("matrix", "Matrix from signals to loads: G as drawn, G' with assembly errors, G_B' by the calibration."),
        Head("figure", "Name of the figure of merit."),
        Head("of", "Load component that the figure concerns; a dash for the whole matrix."),
        Head("value", "Figure of merit, with one standard deviation."),
        UNIT,
        Head("moments over", "Length by which moments are divided, so that forces and moments have one unit."),
    )
    return Listing(heads, rows, (), "Figures of merit, raw (1 m) and scaled", True, "sensor_merit.parquet")


def _types(merit: pd.DataFrame) -> list[Listing]:
    types = merit[
        merit["figure"].isin(["type_1_error", "type_2_error"])
        & ~(merit["length_m"] != 1.0).where(merit["length_m"].notna(), False)
    ]
    if not len(types):
        return _without_types(merit)
    subjects = [*LOADS, "condition"]
    rows = []
    for (figure, model), group in types.groupby(["figure", "model"], sort=False):
        cells = group.set_index("subject")
        words = f"{_TYPES[figure]}{', elastic joints' if model == 'elastic joints' else ''}"
        rows.append((words, *(with_uncertainty(cells.loc[s, "value"], cells.loc[s, "sigma"]) for s in subjects)))
    angles = merit[merit["figure"].isin(_ANGLES)]
    for (figure, model), group in angles.groupby(["figure", "model"], sort=False):
        cells = group.set_index("subject")
        words = f"{_ANGLES[figure]}{', elastic joints' if model == 'elastic joints' else ''}"
        rows.append((words, *(with_uncertainty(cells.loc[s, "value"], cells.loc[s, "sigma"]) for s in LOADS), ""))
    heads = (
        Head("per cent", "Quantity in the row: an error of the theory, or an angle between columns."),
        *(Head(f"S {load}", "Value for the sensitivity to this load component.") for load in LOADS),
        Head("condition", "Value for the condition number of the matrix."),
    )
    caption = "Theory compared with the calibration (moments in N·m). Errors compare lengths of columns, which do not "
    caption += "change if a cell has the wrong sign; the angle between the columns does."
    return [Listing(heads, tuple(rows), (), caption)]


_TYPES_MISSING = "Type 1 and Type 2 errors"


def _without_types(merit: pd.DataFrame) -> list[Listing]:
    """Return the reason that theory is not compared with a calibration whose channels are not the drawing's legs."""
    if not (merit["matrix"] == "G_B'").any() or not (merit["matrix"] == "G'").any():
        return []
    why = "G_B' has another number of channels than the drawing has legs: no channel has a leg to be compared with."
    return [
        Listing((Head(_TYPES_MISSING, "Differences between theory and calibration."),), (("not evaluated",),), (), why)
    ]


def held_out_errors(choice: pd.DataFrame, largest: dict[str, float]) -> go.Figure:
    """Return the rms error of every component under held-out loads, by model, in per cent of the largest load."""
    rows = choice[choice["figure"] == "heldout_rms"]
    chosen = set(choice.loc[(choice["figure"] == "chosen") & (choice["value"] == 1.0), "model"])
    models = list(dict.fromkeys(rows["model"]))
    names = {model: f"{_name(model)}{'  ◀ chosen' if model in chosen else ''}" for model in models}
    figure, every = go.Figure(), []
    for load in [load for load in LOADS if load in largest]:
        selected = rows[rows["subject"] == load]
        share = 100.0 * selected["value"].to_numpy() / largest[load]
        every += share.tolist()
        figure.add_trace(
            go.Scatter(
                x=share,
                y=[names[model] for model in selected["model"]],
                mode="markers",
                name=load,
                marker={"color": _COLOURS[load], "size": 9},
                hovertemplate="%{y}: " + load + " %{x:.3g} %<extra></extra>",
            )
        )
    wide = max(every) > _WIDE * min(every) if every else False
    style(figure, "Errors of held-out loads", "Rms, in per cent of each axis's largest load", 170 + 34 * len(models))
    figure.update_xaxes(title_text="% of the largest load", type="log" if wide else "linear", dtick=1 if wide else None)
    if not wide:
        figure.update_xaxes(rangemode="tozero")
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 110})
    return figure


def _name(model: str) -> str:
    return model.replace(", linear", "").replace("zero none", "no zero").replace("zero common", "one zero")


def error_classes(classes: pd.DataFrame) -> go.Figure:
    """Return the largest error of every class and axis, with the size that noise alone exceeds once in twenty times."""
    reported = classes.dropna(subset=["value"])
    worst = reported.assign(size=reported["value"].abs()).sort_values("size").groupby(["error_class", "load"]).tail(1)
    order = list(dict.fromkeys(classes["error_class"]))
    names = [name for name in order if (worst["error_class"] == name).any()]
    loads = [load for load in LOADS if (worst["load"] == load).any()]
    figure = go.Figure()
    for load in loads:
        of_load = worst[worst["load"] == load].set_index("error_class").reindex(names)
        figure.add_trace(
            go.Bar(
                x=names,
                y=of_load["size"],
                name=load,
                marker={"color": _COLOURS[load]},
                offsetgroup=load,
                error_y=_above_zero(of_load["size"], BAR * of_load["sigma"]),
                hovertemplate=load + ", %{x}: %{y:.3g} %<extra></extra>",
            )
        )
    figure.update_layout(barmode="group", bargap=0.25)
    subtitle = "Black line: exceeded by noise alone once in 20 times; a bar below it is not significant. Bars: 95 %"
    style(figure, "Errors by class, in per cent of the range (interpolation: of the load)", subtitle, 420)
    figure.update_yaxes(title_text="%", rangemode="tozero")
    legend = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}
    figure.update_layout(legend=legend, margin={"t": 110}, shapes=list(_limits(worst, names, loads)))
    return figure


def _above_zero(size: pd.Series, reach: pd.Series) -> dict[str, object]:
    """Return error bars that end at zero at the lowest."""
    down = np.minimum(reach, size)
    return {"type": "data", "array": reach, "arrayminus": down, "symmetric": False, "thickness": 1, "width": 2}


def _limits(worst: pd.DataFrame, names: list[str], loads: list[str]) -> Iterator[dict[str, object]]:
    """Yield a line across every bar at its limit, as shapes, because separate calls of plotly are slow."""
    limits = dict(zip(zip(worst["error_class"], worst["load"], strict=True), worst["limit"], strict=True))
    width, line = 0.75 / len(loads), {"color": "black", "width": 2}
    for (i, name), (j, load) in product(enumerate(names), enumerate(loads)):
        if (limit := limits.get((name, load))) is not None:
            middle = i + (j - 0.5 * (len(loads) - 1)) * width
            across = {"x0": middle - 0.5 * width, "x1": middle + 0.5 * width}
            yield {"type": "line", **across, "y0": limit, "y1": limit, "line": line}


def _merit_figure(merit: pd.DataFrame, length_m: float) -> go.Figure:
    """Return sensitivities and condition of G, G' and, where leg forces are known, G_B', with moments over a length."""
    at = merit[np.isclose(merit["length_m"].to_numpy(dtype=float), length_m)]
    figure = go.Figure()
    for (matrix, model), group in at[at["matrix"] != "G_B"].groupby(["matrix", "model"], sort=False):
        name, colour, symbol = _SHOWN.get((matrix, model), _SHOWN[matrix, ""])
        of_loads = group[group["figure"] == "sensitivity"].set_index("subject").reindex(list(LOADS))
        condition = group[group["figure"] == "condition"].iloc[0]
        sigmas = np.array([*of_loads["sigma"], condition["sigma"]], dtype=float)
        figure.add_trace(
            go.Scatter(
                x=[*(f"S {load}" for load in LOADS), "condition"],
                y=[*of_loads["value"], condition["value"]],
                mode="markers",
                name=name,
                marker={"color": colour, "size": 10, "symbol": symbol},
                error_y={"type": "data", "array": BAR * np.nan_to_num(sigmas), "width": 3},
                hovertemplate="%{x}: %{y:.4g}<extra>" + name + "</extra>",
            )
        )
    subtitle = f"Moments divided by {plain(length_m)} m, which gives them the weight of forces. Bars: 95 %"
    style(figure, "Sensitivities and condition number", subtitle, 380)
    figure.update_yaxes(rangemode="tozero")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 110})
    return figure
