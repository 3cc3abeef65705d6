"""Section of a second campaign: its errors under models that were fitted to the first one."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.column_heads import MODEL_OF_LEGS, Head
from truing.report.numbers import count_text, plain, quantity, sign
from truing.report.page import Listing, ReportSection
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, cell, reason, table_or_none
from truing.schemas.verdict import BY_A_FACTOR, ReasonCode, is_clearly_larger

_TITLE = "A second campaign of the same machine"
_ARTIFACT = "second_campaign_errors"
_NOMINAL = "nominal"


def transfer(tables: Tables) -> ReportSection | None:
    """Return the errors of the second campaign under every model; None where the campaign names none."""
    if _ARTIFACT not in tables:
        return None
    errors = table_or_none(tables, _ARTIFACT)
    if errors is None:
        return ReportSection("transfer", _TITLE, f"Not evaluated: {reason(tables, _ARTIFACT)}", state="not evaluated")
    return ReportSection("transfer", _TITLE, _opening_sentences(errors), listings=(_listing(errors),))


def transfer_verdict(tables: Tables, verdicts: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the models' predictions of a second campaign; None where the campaign names none."""
    if _ARTIFACT not in tables:
        return None
    errors = table_or_none(tables, _ARTIFACT)
    if errors is None:
        why = f"Not evaluated: {reason(tables, _ARTIFACT)}"
        return SectionVerdict("transfer", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, why)
    return verdict_elsewhere(errors)


def verdict_elsewhere(errors: pd.DataFrame) -> SectionVerdict:
    """Return the verdict on rows of second_campaign_errors.parquet.

    A model fails where it predicts any quantity worse than the nominal one. Else the smallest error decides: of the
    best model, in the quantity that most of them predict.
    """
    fitted = errors[errors["prediction_by"] != _NOMINAL]
    if (worse := _worst(fitted, errors)) is not None:
        row, nominal = worse
        sizes = f"{quantity(row['rms_error'], row['unit'])} rms, nominal {quantity(nominal, row['unit'])}"
        text = (
            f"The {row['prediction_by']} model predicts {row['campaign']} worse than the nominal one: "
            f"{row['quantity']} {sizes}. Do not use it there.{_range_words(row)}"
        )
        ratio = float(row["rms_error"] / nominal)
        return SectionVerdict("transfer", RelationState.FAILS, ReasonCode.WORSE_ELSEWHERE, text, ratio, "1", 1.0)
    rows = errors[errors["quantity"] == _most_predicted(errors)]
    best = rows.loc[rows["rms_error"].idxmin()]
    noise = best["noise_rms"]
    if noise != noise or not noise > 0.0:
        text = _opening_sentences(errors)
        return SectionVerdict("transfer", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    ratio = float(best["rms_error"] / noise)
    error = f"{best['quantity']} {quantity(best['rms_error'], best['unit'])} rms by the {best['prediction_by']} model"
    alone = f"noise alone gives {quantity(noise, best['unit'])}."
    if ratio > BY_A_FACTOR:
        text = f"No model predicts {best['campaign']} to its noise: {error}, where {alone}{_range_words(best)}"
        code = ReasonCode.BEYOND_NOISE_ELSEWHERE
        return SectionVerdict("transfer", RelationState.ATTENTION, code, text, ratio, "1", BY_A_FACTOR)
    code = ReasonCode.PREDICTS_ELSEWHERE
    text = f"{error[0].upper()}{error[1:]} in {best['campaign']}; {alone}"
    return SectionVerdict("transfer", RelationState.OK, code, text, ratio, "1", BY_A_FACTOR)


def _worst(fitted: pd.DataFrame, errors: pd.DataFrame) -> tuple[pd.Series, float] | None:
    """Return the row that is worse than the nominal model by the largest factor, with the nominal error; None if none
    is."""
    nominal = errors[errors["prediction_by"] == _NOMINAL].set_index("quantity")["rms_error"]
    found = None
    for _, row in fitted.iterrows():
        p, base = row.get("p_worse"), nominal.get(row["quantity"])
        if p is None or p != p or not base:
            continue
        ratio = row["rms_error"] / base
        if is_clearly_larger(p, ratio) and (found is None or ratio > found[0]):
            found = ratio, row, float(base)
    return None if found is None else found[1:]


def _range_words(row: pd.Series) -> str:
    """Return the number of values at readings that the fitted poses do not reach; empty for none."""
    beyond = row.get("beyond_range")
    if beyond is None or beyond != beyond or not beyond:
        return ""
    of = count_text(int(row["count"]), "value")
    return f" {int(beyond):,} of {of} were measured at readings outside the range of the fitted poses."


def _most_predicted(errors: pd.DataFrame) -> str:
    return str(errors["quantity"].value_counts(sort=False).idxmax())


def _opening_sentences(errors: pd.DataFrame) -> str:
    """Return the errors of the first quantity that most models predict, compared with noise."""
    rows = errors[errors["quantity"] == _most_predicted(errors)]
    first = rows.iloc[0]
    sizes = ", ".join(f"{r.prediction_by} {quantity(r.rms_error, r.unit)}" for r in rows.itertuples())
    noise = first["noise_rms"]
    left = "" if noise != noise else f"; noise alone gives {quantity(noise, first['unit'])}"
    named = f"Models that were fitted to this campaign predict {first['campaign']}, which none of them used."
    of = count_text(int(first["count"]), "value")
    return f"{named} Errors in {first['quantity']} of {of}, rms: {sizes}{left}.{_range_words(first)}"


def _listing(errors: pd.DataFrame) -> Listing:
    quantities = errors.drop_duplicates(["quantity", "unit"])
    columns = list(zip(quantities["quantity"], quantities["unit"], strict=True))
    rows = []
    for (prediction, model), group in errors.groupby(["prediction_by", "model"], sort=False):
        cells = {r.quantity: f"{plain(r.rms_error)} / {plain(r.largest_error)}" for r in group.itertuples()}
        rows.append((str(prediction), cell(model), *(cells.get(name, "") for name, _ in columns)))
    reported = quantities[quantities["noise_rms"].notna()].set_index("quantity")["noise_rms"]
    rows.append(("noise alone", "", *(plain(reported[name]) if name in reported else "" for name, _ in columns)))
    error = "Rms / largest of measured minus predicted in the second campaign."
    heads = (
        Head("predicted by", "Model that predicts: nominal machine, chosen calibration, or extended model."),
        MODEL_OF_LEGS,
        *(Head(f"{name} ({sign(unit)})", error) for name, unit in columns),
    )
    caption = "Measured minus predicted in the second campaign: rms / largest"
    return Listing(heads, tuple(rows), caption=caption, held_by=f"{_ARTIFACT}.parquet")
