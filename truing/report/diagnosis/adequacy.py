"""Tests of the final model as a whole: are its residuals consistent with noise?"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from truing.belonging.relation import RelationState
from truing.report.column_heads import CORRECTED_P, Head
from truing.report.diagnosis.assessed_causes import (
    AssessedCause,
    accepted_of,
    assessed_causes,
    modelled_of,
    testable_of,
)
from truing.report.diagnosis.deviating_epochs import deviating_epochs, deviating_words, used_words
from truing.report.diagnosis.findings import DECLARED_NOISE, expected_noise, subject_words
from truing.report.diagnosis.prediction_errors import AT_THE_FLOOR, Overall, errors_of_models, part_names
from truing.report.numbers import capitalised, count_text, p_value, rough, rough_quantity
from truing.report.page import Listing, ReportSection
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Row, Tables, cell, table_or_none
from truing.report.wordings.catalogue import cause_words
from truing.report.wordings.nonparametric_wordings import columns_words
from truing.schemas.covariates import names_in
from truing.schemas.verdict import BY_A_FACTOR, ReasonCode

_TITLE = "Does the model fit as a whole?"
CAUSES_LEFT = "causes-left"
# Names of inputs, with blanks, that concern the way to a position or load.
LOOKS_BACK = re.compile(
    r"approach.*|last step|memory|direction of .*|travel since the turn|unloading .*|largest so far .*"
)
_LOOKED_FOR = {
    "observation-noise": "noise of the measurements",
    "input-noise": "noise of the inputs",
    "like-neighbours": "correlation of neighbouring residuals",
    "like-places": "correlation of residuals of neighbouring targets",
    "pure-error": "lack of fit, by repeated measurements",
    "by-region": "mean residual of a region",
    "parts": "dependence of single parts' errors on inputs",
    CAUSES_LEFT: "further causes",
}
_RESIDUALS = {"observation-noise": "residuals of the measurements", "input-noise": "residuals of the inputs"}
_OF_PATTERNS = ("like-neighbours", "like-places", "pure-error", "by-region")
_OF_SIZE = "The noise is larger than declared, or the model is incomplete"
_WHY_ENDED = {
    "most-causes": "because no further cause is known to improve the prediction of held-out measurements",
    "time": "because a search for further causes would take too long",
    "unnamed-effects": "because too many effects match no catalogued cause",
    "refused": "because this candidate predicts held-out measurements worse",
    "events": "because a third sudden change of the same part is less probable than an unknown effect",
}
_WHY_UNTESTED = {
    "too-few": "too few data",
    "no-repeats": "no command was repeated",
    "too-large": "or not to the end: it would take too long",
}
_UNITS = {
    **dict.fromkeys(("like-neighbours", "like-places"), "(correlation)"),
    **dict.fromkeys(("pure-error", "by-region"), "(F)"),
}


def adequacy(tables: Tables) -> ReportSection | None:
    """Return the section of all tests of the final model; None where the run has none."""
    table = table_or_none(tables, "adequacy")
    if table is None:
        return None
    rows = list(table.itertuples())
    tested = sum(row.state != "not tested" for row in rows)
    failed = shortcoming(tables)
    lead = f"{count_text(tested, 'test')} of the final model: "
    lead += f"{failed}." if failed else f"none finds more than noise{_but_beyond(tables)}."
    lead += "".join(_untested(rows, why, words) for why, words in _WHY_UNTESTED.items())
    noise = noise_compared(tables)
    cells = tuple(
        (_LOOKED_FOR[row.test], _column_words(row), _value(row, noise), p_value(row.p_value), row.state) for row in rows
    )
    marks = tuple({"fails": "fail", "ok": "pass"}.get(row.state, "none") for row in rows)
    heads = (
        Head("test", "Property of the residuals of the final model that is compared with pure noise."),
        Head("along", "Quantity along which neighbours or regions are compared."),
        Head("value", "Statistic of the test; its kind stands in brackets."),
        Head("p (corrected)", CORRECTED_P),
        Head("state", "Result: ok, fails, or not tested with these data."),
    )
    caption = f"All {count_text(len(rows), 'test')}" + (f", {tested} of them evaluated" if tested < len(rows) else "")
    listing = Listing(heads, cells, marks, caption, len(cells) > 8, "adequacy.parquet")
    return ReportSection("adequacy", _TITLE, lead, (), (listing,))


def _untested(rows: list[Row], why: str, words: str) -> str:
    """Return the sentence on tests that were not possible for one reason; empty where there are none."""
    bad = [
        row
        for row in rows
        if row.state == "not tested" and cell(getattr(row, "why_untested", None) or "too-few") == why
    ]
    return f" Not tested ({words}): {', '.join(dict.fromkeys(_LOOKED_FOR[row.test] for row in bad))}." if bad else ""


def _errors_with_floor(rows: list[AssessedCause], tables: Tables) -> list[Overall]:
    """Return the errors of the model where noise is declared for them."""
    return [model_error for model_error in errors_of_models(rows, modelled_of(rows), tables) if model_error.floor]


def _but_beyond(tables: Tables) -> str:
    """Return that predictions err by more than noise although no test of residuals fails; empty where they do not."""
    beyond = [
        model_error for model_error in _errors_with_floor(assessed_causes(tables), tables) if _is_beyond(model_error)
    ]
    if not beyond:
        return ""
    worst = max(beyond, key=_times_noise)
    noise = _noise_alone(assessed_causes(tables))
    return f", but {_rms_error(worst, tables)} is {rough(_times_noise(worst))} times what {noise}"


def _rms_error(overall: Overall, tables: Tables) -> str:
    """Return the name of an rms error, with the data over which it is taken: those of the first screen may be
    others."""
    parts = part_names(tables)
    return f"the rms error on {parts.held_out if overall.held_out else parts.fitted}"


def _noise_alone(rows: list[AssessedCause]) -> str:
    """Return the source of the noise floor with its verb: noise, or also the scatter that was found as a cause."""
    scattered = any(row.raises_floor for row in accepted_of(rows))
    return "noise and the scatter found here give" if scattered else "noise alone gives"


def _declared_noise(rows: list[AssessedCause]) -> str:
    """Return the source of the noise floor with its verb, where the declared noise is in doubt."""
    scattered = any(row.raises_floor for row in accepted_of(rows))
    return f"{DECLARED_NOISE} and the scatter found here give" if scattered else f"{DECLARED_NOISE} gives"


def adequacy_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the final model as a whole; None where nothing was diagnosed."""
    rows = assessed_causes(tables)
    if not rows:
        return None
    verdict = _verdict_on_fit(rows, tables)
    model_fits = verdict.state == RelationState.OK
    left_out = deviating_words(deviating_epochs(tables), model_fits=model_fits)
    used = used_words(tables) if model_fits else ""  # an incomplete model misses many poses
    if not left_out and not used:
        return verdict
    verdict = replace(verdict, explanation=" ".join(filter(None, (verdict.explanation, left_out, used))))
    if not model_fits:
        return verdict
    code = ReasonCode.EPOCHS_LEFT_OUT if left_out else ReasonCode.EPOCHS_DEVIATE
    return replace(verdict, state=RelationState.ATTENTION, reason_code=code)


def _verdict_on_fit(rows: list[AssessedCause], tables: Tables) -> SectionVerdict:
    """Return the verdict on the final model by the values that it was fitted to."""
    accepted_rows = [row for row in accepted_of(rows) if not row.is_noise]
    missed = _errors_with_floor(rows, tables)
    beyond, below = (
        [model_error for model_error in missed if _is_beyond(model_error)],
        [model_error for model_error in missed if model_error.is_below_noise],
    )
    none = "" if accepted_rows else f"none of {count_text(len(testable_of(rows)), 'candidate')} was found, but "
    if beyond:
        worst = max(beyond, key=_times_noise)
        if _is_noise_alone(tables):
            return _verdict_on_size(worst, none, shortcoming(tables), _declared_noise(rows), _rms_error(worst, tables))
        return _verdict_above_noise(worst, none, shortcoming(tables), _noise_alone(rows), _rms_error(worst, tables))
    if short := shortcoming(tables):
        text = f"{_OF_SIZE if _is_noise_alone(tables) else 'The model is incomplete'}: {none}{short}."
        p, limit = _least_likely(tables)
        return SectionVerdict("adequacy", RelationState.ATTENTION, ReasonCode.LACK_OF_FIT, text, p, "1", limit)
    if undetermined := [model_error for model_error in missed if _is_undetermined(model_error)]:
        return _verdict_undetermined(max(undetermined, key=_times_noise), _noise_alone(rows))
    if below:
        return _verdict_below_noise(below[0], none, _noise_alone(rows), _rms_error(below[0], tables))
    if not missed:
        text = "No noise is declared, so errors of predictions cannot be compared with it: declare [noise]."
        return SectionVerdict("adequacy", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    worst = max([error for error in missed if not error.held_out] or missed, key=_times_noise)
    ratio, size = _times_noise(worst), rough_quantity(worst.after, worst.unit)
    floor = rough_quantity(worst.floor or 0.0, worst.unit)
    text = f"{capitalised(_rms_error(worst, tables))} is {size}; {_noise_alone(rows)} {floor}."
    text += " The excess may be chance, or noise larger than declared." if ratio > AT_THE_FLOOR else ""
    return SectionVerdict("adequacy", RelationState.OK, ReasonCode.WITHIN_NOISE, text, ratio, "1", AT_THE_FLOOR)


def _verdict_above_noise(overall: Overall, none: str, short: str, noise: str, error: str) -> SectionVerdict:
    """Return the verdict on errors beyond noise, which ``error`` names: by a factor they fail, since no declared noise
    is so wrong unnoticed."""
    ratio, also = _times_noise(overall), f". {capitalised(short)}" if short else ""
    size, floor = (rough_quantity(value, overall.unit) for value in (overall.after, overall.floor or 0.0))
    if overall.of_fit > (overall.floor or 0.0):
        of_fit = rough_quantity(overall.of_fit, overall.unit)
        floor += f" and the uncertainty of the fit {of_fit}, as the fitted data hardly determine the model there"
    text = f"The model is incomplete: {none}{error} is {size}, where {noise} {floor}{also}. "
    text += "Look at the pattern of the errors under Diagnosis."
    return _beyond_noise(text, ratio)


def _verdict_on_size(overall: Overall, none: str, short: str, noise: str, error: str) -> SectionVerdict:
    """Return the verdict on errors beyond declared noise without a pattern, which larger noise also explains."""
    size, floor = (rough_quantity(value, overall.unit) for value in (overall.after, overall.floor or 0.0))
    text = f"{_OF_SIZE}: {none}{error} is {size}, where {noise} {floor}. {capitalised(short)}. "
    text += "No test finds a pattern in the residuals: measure the noise by repetitions, and correct [noise] if it is "
    text += "larger."
    return _beyond_noise(text, _times_noise(overall))


def _beyond_noise(text: str, ratio: float) -> SectionVerdict:
    """Return the verdict on errors of this ratio to the noise floor: it fails beyond a factor."""
    if ratio > BY_A_FACTOR:
        return SectionVerdict("adequacy", RelationState.FAILS, ReasonCode.BEYOND_NOISE, text, ratio, "1", BY_A_FACTOR)
    return SectionVerdict("adequacy", RelationState.ATTENTION, ReasonCode.BEYOND_NOISE, text, ratio, "1", AT_THE_FLOOR)


def _is_noise_alone(tables: Tables) -> bool:
    """Return True if noise larger than declared is all that the tests find, and some test of a pattern holds."""
    table = table_or_none(tables, "adequacy")
    if table is None or noise_compared(tables) != DECLARED_NOISE:
        return False
    failed, held = (set(table["test"][table["state"] == state]) for state in ("fails", "ok"))
    return bool(failed) and failed <= set(_RESIDUALS) and not held.isdisjoint(_OF_PATTERNS)


def _verdict_below_noise(overall: Overall, none: str, noise: str, error: str) -> SectionVerdict:
    size = rough_quantity(overall.after, overall.unit)
    text = f"{none}{error} is only {size}, significantly less than {noise} "
    text += f"({rough_quantity(overall.floor or 0.0, overall.unit)}): {overall.why_below}. Correct [noise]: at the "
    text += "present value, small effects may be missed."
    text = capitalised(text)
    return SectionVerdict("adequacy", RelationState.ATTENTION, ReasonCode.BELOW_NOISE, text, _times_noise(overall), "1")


def _is_beyond(overall: Overall) -> bool:
    """Return True if errors are beyond noise; held-out errors also contain the uncertainty of the fit."""
    return overall.is_beyond_noise and (not overall.held_out or overall.times_expected > BY_A_FACTOR)


def _is_undetermined(overall: Overall) -> bool:
    """Return True if held-out errors are beyond noise by a factor, but not beyond the uncertainty of the fit."""
    return overall.held_out and overall.times_noise > BY_A_FACTOR and overall.times_expected <= BY_A_FACTOR


def _verdict_undetermined(overall: Overall, noise: str) -> SectionVerdict:
    """Return the verdict on a model that the fitted data do not determine where data were held out."""
    size, floor, of_fit = (
        rough_quantity(value, overall.unit) for value in (overall.after, overall.floor or 0.0, overall.of_fit)
    )
    text = (
        f"The fitted data do not determine the model where data were held out: the rms error there is {size}, the "
        f"uncertainty of the fit alone gives {of_fit}, and {noise} {floor}. Fit some data of that region too, or "
        "survey the quantities that are not determined."
    )
    return SectionVerdict(
        "adequacy",
        RelationState.ATTENTION,
        ReasonCode.UNDETERMINED_THERE,
        text,
        overall.times_expected,
        "1",
        BY_A_FACTOR,
    )


def _times_noise(overall: Overall) -> float:
    return overall.times_noise


def _least_likely(tables: Tables) -> tuple[float, float]:
    """Return the p-value of the worst test of the model, and its limit."""
    failed = tables["adequacy"][tables["adequacy"]["state"] == "fails"].sort_values("p_value")
    return float(failed["p_value"].iloc[0]), float(failed["limit"].iloc[0])


def shortcoming(tables: Tables) -> str:
    """Return in words the worst shortcoming of the final model, without a full stop; empty where it holds."""
    table = table_or_none(tables, "adequacy")
    failed = None if table is None else table[table["state"] == "fails"].sort_values("p_value")
    if failed is None or not len(failed):
        return ""
    ended = failed[failed["test"] == CAUSES_LEFT]
    return shortcoming_words(next((ended if len(ended) else failed).itertuples()), noise_compared(tables))


def noise_compared(tables: Tables) -> str:
    """Return the noise that the search compared residuals with."""
    rows = table_or_none(tables, "diagnosis")
    return expected_noise("" if rows is None or "relation" not in rows else cell(rows["relation"].iloc[0]))


def shortcoming_words(worst: Row, noise: str) -> str:
    """Return in words the shortcoming found by one failed test against a noise, without a full stop."""
    if worst.test == CAUSES_LEFT:
        return _limit_words(worst)
    if worst.test == "like-neighbours":
        return f"neighbouring residuals along {_column_words(worst)} are correlated (correlation {rough(worst.value)})"
    if worst.test == "like-places":
        words = f"residuals of neighbouring targets of a pose are correlated (correlation {rough(worst.value)})"
        return f"{words}, as where a body bends or the instrument errs by place"
    if worst.test == "pure-error":
        return f"mean errors of repeated measurements exceed what their scatter explains (F = {rough(worst.value)})"
    if worst.test == "by-region":
        return f"mean residuals differ between regions of {_column_words(worst)} (F = {rough(worst.value)})"
    return f"{_RESIDUALS[worst.test]} are {rough(worst.value)} times {noise} (larger noise, or a missing effect)"


def _limit_words(row: Row) -> str:
    """Return in words that the search reached a limit, and the remainder, without the last full stop."""
    if not cell(row.left_cause):
        accepted = count_text(round(row.value), "cause")
        return f"the search accepted {accepted}: so many may only describe the residuals piece by piece"
    accepted = count_text(round(row.value), "accepted cause")
    subject_text = f" of {subject_words(row.left_subject)}" if cell(row.left_subject) else ""
    candidate = f"{cause_words(row.left_cause)}{subject_text}"
    remains = f"after {accepted} another effect remains (best candidate: {candidate})"
    return f"{remains}. The search ended {_WHY_ENDED[row.search_end]}"


def _column_words(row: Row) -> str:
    return columns_words(columns_along(row)) or "–"


def columns_along(row: Row) -> tuple[str, ...]:
    """Return the columns along which a test of the residuals compared neighbours or regions; a name may have blanks."""
    along = cell(row.along) or ""
    return (along,) if LOOKS_BACK.fullmatch(along) else names_in(along)


def _value(row: Row, noise: str) -> str:
    if row.test == CAUSES_LEFT:
        return f"{count_text(round(row.value), 'accepted cause')}"
    return "–" if row.state == "not tested" else f"{rough(row.value)} {_UNITS.get(row.test, f'times {noise}')}"
