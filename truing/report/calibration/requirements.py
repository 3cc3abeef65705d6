"""Section of the requirements: limits on the error of the calibrated mechanism."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.belonging.relation import RelationState
from truing.report.calibration.calibrations import (
    Key,
    calibration_name,
    chosen_calibration,
    displayed_calibration,
    keys_of,
    main_calibration,
    rows_of,
)
from truing.report.column_heads import DEFORMATION, MODEL_OF_LEGS, Head, schema_head
from truing.report.figure_style import GREEN, GREY, ORANGE, RED, label, sequence_title, size_axis, style
from truing.report.numbers import count_text, in_one_unit, listed, plain, quantity
from truing.report.page import Listing, ReportSection
from truing.report.reasons import is_by_components, why_absent, why_no_requirement
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Row, Tables, cell, is_bench, table_or_none
from truing.schemas.verdict import ReasonCode

_TITLE = "Requirements"
_IDLE = "not evaluated"
_MARKS = {"meets": "pass", "fails": "fail", "undecided": "warn"}
_UNCORRECTED = ("uncorrected", "none")
_COMPONENTS = {"rx": "tilt about x", "ry": "tilt about y", "rz": "turn about z"}
_LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
_VERDICT = Head("verdict", "Whether the machine meets the requirement: meets, fails, or undecided with these data.")

_DRAWN_AS = {"meets": (GREEN, "circle"), "undecided": (ORANGE, "diamond"), "fails": (RED, "x")}


def requirements(tables: Tables) -> ReportSection | None:
    """Return the section of all components with limit, error, interval of the error, and verdict."""
    if "requirements" not in tables:
        return None
    assessed = table_or_none(tables, "requirements")
    if assessed is None:
        return ReportSection("requirements", _TITLE, why_no_requirement(tables))
    key = _main_key(tables, assessed) or displayed_calibration(tables, assessed)
    rows = rows_of(assessed, key)
    figures = []
    if (rows["verdict"].isin(_DRAWN_AS) & rows["error"].notna() & rows["requirement"].notna()).any():
        words = "A requirement is undecided if its interval crosses the limit; more or better poses would decide it."
        figures.append((_requirement_bars(rows, key), words))
    listings = [_requirement_listing(rows, key)]
    not_chosen = assessed.drop(index=rows.index)
    if len(not_chosen):
        listings.append(_other_calibrations(not_chosen))
    lead = " ".join(filter(None, (_opening_sentences(rows, key), _place(tables, rows))))
    return ReportSection("requirements", _TITLE, lead, tuple(figures), tuple(listings))


def assessed_noun(requirements: pd.DataFrame) -> str:
    """Return the noun for one error of a requirement: a pose, or a run of a force sensor."""
    return "run" if requirements["component"].isin(_LOADS).any() else "pose"


def _heads(requirements: pd.DataFrame) -> tuple[str, ...]:
    noun = f"{assessed_noun(requirements)}s"
    return (
        schema_head("component"),
        Head("limit", "Accuracy that [requirement] of campaign.toml asks for."),
        Head(f"95 % of {noun} below", f"Estimate of the absolute error that 95 of 100 {noun} do not exceed."),
        Head("interval (95 %)", f"Range that holds this error with 95 % confidence, by the number of {noun}."),
        Head("error / limit", "Estimated error divided by the limit."),
    )


def _name_of(key: Key, requirements: pd.DataFrame) -> str:
    """Return the name of the calibration: of a mechanism, or of a force sensor."""
    return f"the calibration {key[0]}" if assessed_noun(requirements) == "run" else calibration_name(key)


def _place(tables: Tables, requirements: pd.DataFrame) -> str:
    """Return a sentence on the errors: of a tip, an axis or a sensor; empty for mechanisms with calibrations."""
    if assessed_noun(requirements) == "run":
        return (
            "Errors are shown minus applied loads to which the calibration was not fitted, rms over the steps of a "
            "run, which share its zero and mounting and count as one."
        )
    if table_or_none(tables, "axis_errors") is not None:
        return "Errors are those of the axis, after a constant is subtracted."
    if table_or_none(tables, "joints") is None:
        return ""
    return "Errors are those of the tip, in the axes of its base: at its measured pose, or at the mean of its targets."


def _main_key(tables: Tables, assessed: pd.DataFrame) -> Key | None:
    """Return the main calibration if it was assessed: the extended model where there are no calibrations."""
    keys = keys_of(assessed)
    main = keys[0] if is_by_components(tables) or is_bench(tables) else main_calibration(tables)
    return main if main in keys else None


def requirements_verdict(tables: Tables, before: Mapping[str, SectionVerdict]) -> SectionVerdict:
    """Return the verdict on the accuracy of the calibrated machine; not tested if its model does not fit."""
    assessed, counted = table_or_none(tables, "requirements"), tally(main_requirements(tables))
    requirements = chosen_requirements(tables)
    failed = None if requirements is None else requirements[requirements["verdict"] == "fails"]
    if requirements is not None and failed is not None and len(failed):
        worst = failed.assign(ratio=failed["error"] / failed["requirement"]).nlargest(1, "ratio").iloc[0]
        text = f"{counted}. Worst: error of {worst['component']}, {plain(worst['ratio'])} times the limit."
        return SectionVerdict(
            "requirements", RelationState.FAILS, ReasonCode.NOT_MET, text, float(worst["ratio"]), "1", 1.0
        )
    # the adequacy of a bench is that of its readings, and no sensor's calibration uses them
    adequacy = None if is_bench(tables) else before.get("adequacy")
    of_recorded = main_calibration(tables) == chosen_calibration(tables)
    if is_bench(tables) and (words := _of_other_loads(tables)):
        return SectionVerdict("requirements", RelationState.NOT_TESTED, ReasonCode.MODEL_DOES_NOT_FIT, words)
    if assessed is not None and adequacy is not None and adequacy.state == RelationState.FAILS:
        text = f"Requirements not tested: the model that predicts the errors does not fit. {adequacy.explanation}"
        return SectionVerdict("requirements", RelationState.NOT_TESTED, ReasonCode.MODEL_DOES_NOT_FIT, text)
    if assessed is not None and of_recorded and (to_do := _why_not_by(before.get("calibration"))):
        text = f"Requirements not tested: the calibration that predicts the errors {to_do}"
        return SectionVerdict("requirements", RelationState.NOT_TESTED, ReasonCode.MODEL_DOES_NOT_FIT, text)
    if requirements is None:
        why = why_no_requirement(tables) if "requirements" in tables else why_absent("requirements", tables)
        text = f"Requirements not evaluated: {why[:1].lower()}{why[1:]}"
        return SectionVerdict("requirements", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    uncorrected = rows_of(assessed, _UNCORRECTED) if assessed is not None else requirements.iloc[:0]
    text = _decided(counted, uncorrected, "extended" if is_by_components(tables) else "calibrated")
    if unseen := unmeasured_components(tables):
        text = f"{counted}; not measured: {', '.join(unseen)}."
        return SectionVerdict("requirements", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    if (requirements["verdict"] == "undecided").any():
        return SectionVerdict("requirements", RelationState.ATTENTION, ReasonCode.UNDECIDED, text)
    state = RelationState.ATTENTION if (uncorrected["verdict"] == "fails").any() else RelationState.OK
    return SectionVerdict("requirements", state, ReasonCode.MET, text)


def _decided(counted: str, uncorrected: pd.DataFrame, model: str) -> str:
    """Return the result, and that of the machine as it is where this is known."""
    if not len(uncorrected):
        return f"{counted}, as predicted by the {model} model."
    return f"Corrected by the {model} model: {counted}. Without correction: {tally(uncorrected)}."


def _of_other_loads(tables: Tables) -> str:
    """Return the result with the components of the load that acted otherwise than recorded; empty without any."""
    every = main_requirements(tables)
    names = every["component"][_is_idle(every) & every["error"].notna()]
    if not len(names):
        return ""
    return (
        f"{tally(every)}: {listed(list(names))}, because other loads acted than those recorded. Record the loads that "
        "act, or apply the finding ([diagnosis] apply)."
    )


def _why_not_by(calibration: SectionVerdict | None) -> str:
    """Return the misfit of a calibration with its remedy, as a predicate; empty for one that fits."""
    if calibration is None:
        return ""
    if calibration.reason_code == ReasonCode.CAUSE_LEFT_OUT:
        return "leaves out what was found; Requirements lists the errors of the extended model."
    failed = calibration.state == RelationState.FAILS
    return "does not fit. Correct [noise], or find the missing cause." if failed else ""


def _opening_sentences(requirements: pd.DataFrame, key: Key) -> str:
    link = ", as predicted by" if not _is_idle(requirements).all() else " with"
    text = f"{tally(requirements)}{link} {_name_of(key, requirements)}."
    return " ".join(
        [
            text,
            *(
                _open_or_failed(r, assessed_noun(requirements))
                for r in requirements.itertuples()
                if r.verdict in ("fails", "undecided")
            ),
        ]
    )


def _open_or_failed(r: Row, noun: str) -> str:
    """Return one failed or undecided requirement in words, with its numbers."""
    quantity, required, error, interval, _ = _sizes(r)
    words = "not met" if r.verdict == "fails" else "undecided"
    return (
        f"Error of {quantity}: 95 % of {noun}s stay below {error} (95 % interval: {interval}); limit "
        f"{required}: {words}."
    )


def tally(requirements: pd.DataFrame) -> str:
    """Return the count of results: ``2 of 5 requirements met, 1 not met, 1 undecided, 1 not tested``."""
    counts = requirements["verdict"].value_counts()
    if counts.get(_IDLE, 0) == len(requirements):
        return f"None of {count_text(len(requirements), 'requirement')} could be evaluated"
    text = f"{counts.get('meets', 0)} of {count_text(len(requirements), 'requirement')} met"
    words = {"fails": "not met", "undecided": "undecided", _IDLE: "not tested"}
    return ", ".join([text, *(f"{counts[v]} {word}" for v, word in words.items() if v in counts)])


def chosen_requirements(tables: Tables) -> pd.DataFrame | None:
    """Return the requirements as assessed with the main calibration; None where none was assessed."""
    requirements = main_requirements(tables)
    requirements = requirements[~_is_idle(requirements)]
    return requirements if len(requirements) else None


def main_requirements(tables: Tables) -> pd.DataFrame:
    """Return all requirements with the main calibration, also those not evaluated; no row without any."""
    assessed = table_or_none(tables, "requirements")
    if assessed is None:
        return pd.DataFrame({"component": [], "verdict": [], "error": []})
    key = _main_key(tables, assessed)
    return rows_of(assessed, key) if key is not None else assessed.iloc[:0]


def _is_idle(requirements: pd.DataFrame) -> pd.Series:
    return requirements["verdict"] == _IDLE


def unmeasured_components(tables: Tables) -> list[str]:
    """Return the components of [requirement] in which no pose of a chain, or row of an axis, shows an error."""
    if not is_by_components(tables):
        return []
    requirements = main_requirements(tables)
    return [str(name) for name in requirements["component"][requirements["error"].isna()]]


def _requirement_listing(requirements: pd.DataFrame, key: Key) -> Listing:
    idle = _is_idle(requirements)
    if idle.any() and "message" in requirements:
        remarks: list[tuple[str, ...]] = [(cell(message),) for message in requirements["message"].where(idle, "")]
        heads: tuple[str, ...] = (_VERDICT, *_heads(requirements), Head("why", "Reason why it was not evaluated."))
    else:
        remarks, heads = [()] * len(requirements), (_VERDICT, *_heads(requirements))
    rows = tuple((r.verdict, *_sizes(r), *remark) for r, remark in zip(requirements.itertuples(), remarks, strict=True))
    caption = f"With {_name_of(key, requirements)}"
    return Listing(heads, rows, _marks(requirements), caption, held_by="requirements.parquet")


def _other_calibrations(not_chosen: pd.DataFrame) -> Listing:
    rows = tuple((r.verdict, r.model, r.deformation, *_sizes(r)) for r in not_chosen.itertuples())
    heads = (_VERDICT, MODEL_OF_LEGS, DEFORMATION, *_heads(not_chosen))
    return Listing(
        heads, rows, _marks(not_chosen), "Without correction or with other calibrations", True, "requirements.parquet"
    )


def interval_words(r: Row) -> tuple[str, str, str]:
    """Return the present interval of a requirement, the one after more poses, and the limit, in one unit."""
    asked, *ends = in_one_unit([r.requirement, r.lower, r.upper, r.lower_expected, r.upper_expected], cell(r.unit))
    bare = [end.partition(" ")[0] for end in ends[::2]]
    return f"{bare[0]} to {ends[1]}", f"{bare[1]} to {ends[3]}", asked


def _marks(requirements: pd.DataFrame) -> tuple[str, ...]:
    return tuple(_MARKS.get(verdict, "none") for verdict in requirements["verdict"])


def _sizes(r: Row) -> tuple[str, ...]:
    asked, error, lower, upper = in_one_unit([r.requirement, r.error, r.lower, r.upper], cell(r.unit))
    interval = "–" if "–" in (lower, upper) else f"{lower} to {upper}"
    return _COMPONENTS.get(r.component, r.component), asked, error, interval, plain(r.error / r.requirement)


def _requirement_bars(requirements: pd.DataFrame, key: Key) -> go.Figure:
    """Return each component's error over its limit, with its interval."""
    shown = requirements[requirements["error"].notna() & (requirements["requirement"] > 0.0)]
    ratio = {c: (shown[c] / shown["requirement"]).to_numpy(dtype=float) for c in ("error", "lower", "upper")}
    figure = go.Figure()
    for verdict, (colour, symbol) in _DRAWN_AS.items():
        has_verdict = (shown["verdict"] == verdict).to_numpy()
        if not has_verdict.any():
            continue
        rows, error = shown[has_verdict], ratio["error"][has_verdict]
        bars = {"type": "data", "symmetric": False, "thickness": 3, "width": 6}
        bars |= {"array": ratio["upper"][has_verdict] - error, "arrayminus": error - ratio["lower"][has_verdict]}
        figure.add_trace(
            go.Scatter(
                x=error,
                y=[label(name) for name in rows["component"]],
                mode="markers",
                name=verdict,
                marker={"color": colour, "size": 11, "symbol": symbol},
                error_x=bars,
                text=[f"{quantity(e, u)} of {quantity(r, u)}" for e, r, u in _errors_and_limits(rows)],
                hovertemplate="%{y}: %{text}<extra>" + verdict + "</extra>",
            )
        )
    kind = size_axis(np.append(np.concatenate(list(ratio.values())), 1.0))
    figure.add_vline(x=1.0, line={"color": GREY, "width": 2, "dash": "dot"})
    subtitle = (
        f"Of {label(_name_of(key, requirements))}. Bars: 95 % interval. Right of the dotted line: above the limit"
    )
    style(figure, "Errors compared with the required limits", subtitle, 170 + 42 * len(shown))
    title = sequence_title("error / limit", kind.get("type") == "log")
    figure.update_xaxes(title_text=title, **{k: v for k, v in kind.items() if k != "dtick"})
    names = [label(name) for name in shown["component"]]
    figure.update_yaxes(type="category", categoryorder="array", categoryarray=names[::-1], automargin=True)
    figure.update_yaxes(ticksuffix="  ")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, showlegend=True)
    figure.update_layout(margin={"t": 100})
    return figure


def _errors_and_limits(rows: pd.DataFrame) -> list[tuple[float, float, str]]:
    return list(zip(rows["error"], rows["requirement"], rows["unit"], strict=True))
