"""Section of the calibrations: the chosen model and the reason for it, errors of all, and identified parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.calibration import figures as calibration_figures
from truing.report.calibration.calibrations import (
    ERRORS_IN_VARIABLES,
    IMPLICIT,
    NOMINAL,
    TO_POINTS,
    Key,
    calibration_name,
    chosen_calibration,
    displayed_calibration,
    figures_by_calibration,
    keys_of,
    main_calibration,
    rows_of,
)
from truing.report.calibration.design_parameters import design_parameters, sensitivities
from truing.report.calibration.figures import geometry_picture, has_geometry
from truing.report.calibration.listings import GOOD, all_calibrations, all_deviations, deviations, strong_correlations
from truing.report.calibration.with_findings import compared_calibrations, data_words
from truing.report.diagnosis.assessed_causes import FOUND, assessed_causes, modelled_of
from truing.report.model_tests import ModelTest, below_noise, by_p, listing_of
from truing.report.numbers import capitalised, count_text, listed, plain, quantity
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.reasons import why_no_calibration
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, table_or_none
from truing.report.wordings.catalogue import cause_words
from truing.schemas.verdict import BY_A_FACTOR, ReasonCode, does_not_fit, is_clearly_larger

_BY_DEFAULT, _AS_REPORTED = "by maximum likelihood", "by the implicit objectives"

_LEAST_LEGS = 6
_HELD_OUT = "position_mean_verification"
# Names of the tests of the chosen calibration, in order.
_CODES = (ReasonCode.MISFIT, ReasonCode.BEYOND_TOLERANCE, ReasonCode.HELD_OUT_MISSED)
_UNLIKELY = 1e-3  # p-value of a misfit, or of pulls, below which the model is doubted
_OF_INSTRUMENT = "instrument"  # step of causes that change the measured points
_DEPARTS = "reading_rms_from_rigid_legs"


def calibration(tables: Tables) -> ReportSection | None:
    """Return the section with the choice of the model, the errors of all calibrations, and their parameters."""
    if "calibration" not in tables:
        return None
    fitted = table_or_none(tables, "calibration")
    if fitted is None:
        return ReportSection("calibration", "Calibration", why_no_calibration(tables))
    shown = [*_errors(tables), *_geometry(tables, fitted), *sensitivities(tables), *_correlations(tables, fitted)]
    tests = _tests_of_chosen(tables)
    listings = [listing_of(tests, "Tests of the chosen calibration"), *_listings(tables, fitted)]
    return ReportSection("calibration", "Calibration", opening_sentences(tables, fitted), tuple(shown), tuple(listings))


def calibration_verdict(tables: Tables, before: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the chosen calibration at fitted and held-out poses; None for a run without any."""
    if "calibration" not in tables:
        return None
    figures, chosen = figures_by_calibration(tables), chosen_calibration(tables)
    if table_or_none(tables, "calibration") is None or figures is None or chosen is None:
        why = why_no_calibration(tables) if table_or_none(tables, "calibration") is None else "none was chosen."
        return _calibrated(RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, f"Calibration not tested: {why}")
    adequate = "adequacy" in before and before["adequacy"].reason_code == ReasonCode.WITHIN_NOISE
    if main_calibration(tables) != chosen and (left := _not_applied(tables)):
        text = f"The main calibration includes only the applied findings. It leaves out {listed(left)}: apply that too."
        return _calibrated(RelationState.ATTENTION, ReasonCode.CAUSE_LEFT_OUT, text)
    if main_calibration(tables) != chosen and adequate:
        text = "The main calibration includes the applied findings, and its residuals are noise."
        return _calibrated(RelationState.OK, ReasonCode.FITS, text)
    verdict = _of_chosen(chosen, figures.loc[chosen], _tests_of_chosen(tables), before)
    if verdict.state == RelationState.OK and (wrong := _wrong_poses(tables)):
        return _calibrated(RelationState.ATTENTION, ReasonCode.CAUSE_LEFT_OUT, wrong)
    if verdict.state == RelationState.OK and "diagnosis" in before and not assessed_causes(tables):
        text = f"{verdict.explanation} No cause was sought (see Diagnosis), so this model may have absorbed one."
        return replace(verdict, state=RelationState.ATTENTION, explanation=text)
    return verdict


def _not_applied(tables: Tables) -> list[str]:
    """Return the causes that were found and that a calibration with applied findings leaves out."""
    choices = table_or_none(tables, "diagnosis_choices")
    applied = set() if choices is None else set(choices["cause"][choices["outcome"] == "applied"])
    found_rows = [row for row in modelled_of(assessed_causes(tables)) if row.verdict == FOUND]
    return list(dict.fromkeys(cause_words(row.cause) for row in found_rows if row.cause not in applied))


def _wrong_poses(tables: Tables) -> str:
    """Return the warning that a found cause makes all measured poses wrong, held-out ones too; empty without one."""
    found_rows = [
        row for row in assessed_causes(tables) if row.verdict == FOUND and not row.subject and not row.is_noise
    ]
    names = [cause_words(row.cause) for row in found_rows if row.settings.get("step") == _OF_INSTRUMENT]
    if not names:
        return ""
    return (
        f"The calibration uses the measured poses as recorded. The diagnosis found that all of them are wrong "
        f"({', '.join(names)}), and held-out errors do not show it: correct the data, or apply all findings "
        "([diagnosis] apply)."
    )


def _of_chosen(
    chosen: Key, facts: pd.Series, tests: list[ModelTest], before: Mapping[str, SectionVerdict]
) -> SectionVerdict:
    misfit = misfit_ratio(facts)
    if misfit is not None and does_not_fit(float(facts["misfit_p_value"]), misfit):
        return _misfit(chosen, misfit, before)
    if misfit is not None and is_clearly_larger(float(facts["misfit_p_value"]), misfit):
        return _small_misfit(chosen, misfit, before)
    failed = {code: test for code, test in zip(_CODES, tests, strict=True) if test.holds is False}
    who = calibration_name(chosen)
    if failed:
        missed = ReasonCode.HELD_OUT_MISSED in failed and float(facts.get("heldout_ratio", 0.0)) > BY_A_FACTOR
        code = ReasonCode.HELD_OUT_MISSED if missed else next(iter(failed))
        text = f"{capitalised(who)} fails the test whether {failed[code].question}. {failed[code].statement}"
        return _failed(text, code, misfit, facts)
    if all(test.holds is None for test in tests):
        return _calibrated(
            RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, f"Calibration not tested: {tests[0].statement}"
        )
    passed = "; ".join(test.question for test in tests if test.holds)
    return _calibrated(RelationState.OK, ReasonCode.FITS, f"{capitalised(who)} fits: {passed}.", misfit)


def _failed(text: str, code: ReasonCode, misfit: float | None, facts: pd.Series) -> SectionVerdict:
    """Return the verdict on a failed test other than a misfit: it fails the section if held-out errors are a factor too
    large."""
    if code == ReasonCode.HELD_OUT_MISSED and _is_known(facts, "heldout_ratio"):
        ratio = float(facts["heldout_ratio"])
        state = RelationState.FAILS if ratio > BY_A_FACTOR else RelationState.ATTENTION
        return SectionVerdict("calibration", state, code, text, ratio, "1", BY_A_FACTOR)
    if code == ReasonCode.MISFIT and misfit is not None and misfit < 1.0:
        code = ReasonCode.BELOW_NOISE
    return _calibrated(RelationState.ATTENTION, code, text, misfit)


def _misfit(chosen: Key, misfit: float, before: Mapping[str, SectionVerdict]) -> SectionVerdict:
    """Return the verdict on a misfit, which the diagnosis explains if its extended model leaves only noise."""
    text = f"The calibration does not fit: residuals of {calibration_name(chosen)} are {plain(misfit)} times the "
    if _explains(before):
        text += "noise, because it leaves out what the diagnosis found. With that, only noise remains."
        return _calibrated(RelationState.ATTENTION, ReasonCode.CAUSE_LEFT_OUT, text, misfit)
    if _explains(before, ReasonCode.SUSPECTED):
        text += (
            "noise. It leaves out what the diagnosis found or suspects: confirm that before its parameters are used."
        )
    else:
        text += "noise. Correct [noise], or find the missing cause, before its parameters are used."
    return _calibrated(RelationState.FAILS, ReasonCode.MISFIT, text, misfit)


def _small_misfit(chosen: Key, misfit: float, before: Mapping[str, SectionVerdict]) -> SectionVerdict:
    """Return the verdict on a misfit that wrongly declared noise may explain."""
    text = f"Residuals of {calibration_name(chosen)} are {plain(misfit)} times the declared noise: "
    if _explains(before):
        text += "it leaves out what the diagnosis found, or the noise is larger than declared."
        return _calibrated(RelationState.ATTENTION, ReasonCode.CAUSE_LEFT_OUT, text, misfit)
    if _explains(before, ReasonCode.SUSPECTED):
        text += "it leaves out what the diagnosis found or suspects, or the noise is larger than declared."
    else:
        text += "check [noise], or look for a small missing effect."
    return _calibrated(RelationState.ATTENTION, ReasonCode.MISFIT, text, misfit)


def _explains(before: Mapping[str, SectionVerdict], result: ReasonCode = ReasonCode.FOUND) -> bool:
    """Return True if the diagnosis has this result, and its extended model leaves only noise."""
    codes = {name: before[name].reason_code for name in ("diagnosis", "adequacy") if name in before}
    return codes == {"diagnosis": result, "adequacy": ReasonCode.WITHIN_NOISE}


def misfit_ratio(facts: pd.Series) -> float | None:
    """Return the rms misfit of a calibration over the expected one by declared noise; None where unknown."""
    if not all(_is_known(facts, name) for name in ("misfit_p_value", "chi_square", "freedom")):
        return None
    return float(np.sqrt(facts["chi_square"] / facts["freedom"])) if facts["freedom"] > 0.0 else None


def _calibrated(state: RelationState, code: ReasonCode, text: str, misfit: float | None = None) -> SectionVerdict:
    return SectionVerdict("calibration", state, code, text, misfit, None if misfit is None else "1")


def _errors(tables: Tables) -> Drawn:
    accuracy = table_or_none(tables, "accuracy")
    if accuracy is None:
        return []
    return [(calibration_figures.errors(accuracy, chosen_calibration(tables)), _cost_of_models(tables))]


def _geometry(tables: Tables, fitted: pd.DataFrame) -> Drawn:
    """Return the figure of the chosen structure, by the implicit objectives and by maximum likelihood."""
    model = displayed_calibration(tables, fitted)[0]
    fits = {_AS_REPORTED: table_or_none(tables, "implicit_calibration"), _BY_DEFAULT: fitted}
    of_model = {name: table[table["model"] == model] for name, table in fits.items() if table is not None}
    of_model = {name: table for name, table in of_model.items() if has_geometry(table)}
    return [(geometry_picture(of_model), _pull_words(tables, model))] if of_model else []


def _pull_words(tables: Tables, model: str) -> str:
    text = "Effects that a model leaves out bias its geometry, within limits set by tolerances and surveyed joints."
    for words, estimator in ((_AS_REPORTED, IMPLICIT), (_BY_DEFAULT, ERRORS_IN_VARIABLES)):
        figures = figures_by_calibration(tables, estimator)
        if figures is None or "rms_pull" not in figures or model not in figures.index.get_level_values("model"):
            continue
        pulls = figures.loc[model, "rms_pull"].dropna()
        if not len(pulls):
            continue
        text += f" Rms pull {words}: {', '.join(f'{d} {plain(pull)}' for d, pull in pulls.items())}."
    return text


def _correlations(tables: Tables, fitted: pd.DataFrame) -> Drawn:
    table = table_or_none(tables, "correlations")
    if table is None:
        return []
    key = displayed_calibration(tables, fitted)
    rows = rows_of(table, key)
    if not len(rows):
        return []
    words = "Blocks along the diagonal: parameters of one leg, which the same readings determine."
    return [(calibration_figures.correlation_map(rows, key), words)]


def _listings(tables: Tables, fitted: pd.DataFrame) -> list[Listing]:
    key = displayed_calibration(tables, fitted)
    by_default, as_reported = figures_by_calibration(tables), figures_by_calibration(tables, IMPLICIT)
    listings = compared_calibrations(tables)
    if by_default is not None:
        listings.append(all_calibrations(by_default, fitted, f"All calibrations, {_BY_DEFAULT}"))
    extended = figures_by_calibration(tables, TO_POINTS)
    if extended is not None:
        caption = "The extended model of the diagnosis, fitted to every point, with all findings"
        listings.append(all_calibrations(extended, fitted, caption))
    if as_reported is not None:
        caption = ". ".join(filter(None, (f"The same {_AS_REPORTED}", _method_words(tables))))
        listings.append(
            all_calibrations(as_reported, table_or_none(tables, "implicit_calibration"), caption, folded=True)
        )
    listings += [deviations(fitted, key), *all_deviations(fitted, _BY_DEFAULT, "calibration.parquet")]
    listings += design_parameters(tables)
    reported = table_or_none(tables, "implicit_calibration")
    if reported is not None:
        listings += all_deviations(reported, _AS_REPORTED, "implicit_calibration.parquet")
    table = table_or_none(tables, "correlations")
    if table is not None:
        listings.append(strong_correlations(rows_of(table, key)))
    return [listing for listing in listings if listing.rows]


def opening_sentences(tables: Tables, fitted: pd.DataFrame) -> str:
    """Return the lead sentences: the chosen calibration, its error against noise, its gain, and its rivals."""
    figures, chosen = figures_by_calibration(tables), chosen_calibration(tables)
    ended = _failures(fitted)
    if figures is None or chosen is None:
        return f"{count_text(len(keys_of(fitted)), 'calibration')}; none was chosen for this campaign. {ended}".strip()
    facts = figures.loc[chosen]
    words = [
        data_words(tables),
        _choice(chosen, facts, of_recorded=main_calibration(tables) != chosen),
        _doubts(facts),
        _gain(tables, chosen, facts),
        _rivals(figures, chosen),
        _extended(tables),
        ended,
        _free(fitted),
    ]
    return " ".join(word for word in words if word)


def _choice(chosen: Key, facts: pd.Series, *, of_recorded: bool) -> str:
    role, poses = ("verification", "held-out") if _is_known(facts, _HELD_OUT) else ("calibration", "calibration")
    text = f"Chosen for {'the data as recorded' if of_recorded else 'this campaign'}: {calibration_name(chosen)}."
    if _is_known(facts, f"position_mean_{role}"):
        text += f" Its mean error on the {poses} poses is {_error_words(facts, role)}."
    because = []
    if _is_known(facts, "heldout_ratio"):
        because.append(f"its held-out error is {plain(facts['heldout_ratio'])} times the noise floor")
    if _is_known(facts, "rms_pull"):
        because.append(f"its rms pull is {plain(facts['rms_pull'])} (about 1 if tolerances explain the geometry)")
    reasons = " and ".join(because)
    text += f" {capitalised(reasons)}." if reasons else ""
    left = int(facts.get("poses_downweighted", 0.0) or 0)
    who = f"{count_text(left, 'pose')} that {'contradicts' if left == 1 else 'contradict'} all others"
    return f"{text} {who} {'was' if left == 1 else 'were'} left out." if left else text


def _doubts(facts: pd.Series) -> str:
    """Return in words the doubts about the chosen calibration: a misfit beyond noise, a geometry beyond tolerances."""
    texts = []
    if _is_known(facts, "misfit_p_value") and facts["misfit_p_value"] < _UNLIKELY:
        times = plain(np.sqrt(facts["chi_square"] / facts["freedom"]))
        missing = "the noise is larger than declared, or a cause is missing"
        texts.append(f"However, its residuals are {times} times the declared noise: {missing}.")
    if _is_known(facts, "pull_p_value") and facts["pull_p_value"] < _UNLIKELY:
        texts.append(
            "However, parts are farther from nominal than tolerances allow: a cause is missing, or the tolerances are "
            "too small, and with them the uncertainties on this page."
        )
    return " ".join(texts)


def _tests_of_chosen(tables: Tables) -> list[ModelTest]:
    """Return the tests of the chosen calibration: misfit, geometry, and held-out poses."""
    figures, chosen = figures_by_calibration(tables), chosen_calibration(tables)
    facts = None if figures is None or chosen is None else figures.loc[chosen]
    none = "No calibration was chosen." if facts is None else ""

    def p(figure: str) -> float | None:
        return float(facts[figure]) if facts is not None and _is_known(facts, figure) else None

    misfit = "its residuals agree with the declared noise"
    return [
        _too_small(misfit, facts)
        or by_p(
            misfit,
            p("misfit_p_value"),
            _UNLIKELY,
            ("Noise explains them.", "The noise is larger than declared, or a cause is missing."),
            none or "The fit has no degrees of freedom left.",
        ),
        by_p(
            "parts together are within their tolerances (pulls)",
            p("pull_p_value"),
            _UNLIKELY,
            ("Tolerances explain the geometry.", "Tolerances are too small, or a cause is missing."),
            none or "No tolerance was declared.",
        ),
        by_p(
            "errors on held-out poses agree with the noise",
            p("p_value"),
            _UNLIKELY,
            ("It predicts poses that the fit did not use.", "It does not predict poses that the fit did not use."),
            none or "No pose was held out (role verification).",
        ),
    ]


def _too_small(asked: str, facts: pd.Series | None) -> ModelTest | None:
    """Return a failed test if the misfit is too small for the declared noise; None where it is not."""
    if facts is None or not (_is_known(facts, "chi_square") and _is_known(facts, "freedom")):
        return None
    return below_noise(
        asked,
        float(facts["chi_square"]),
        float(facts["freedom"]),
        "the declared noise is too large, or the model is over-fitted",
    )


def _error_words(facts: pd.Series, role: str) -> str:
    position, orientation = facts.get(f"position_mean_{role}"), facts.get(f"orientation_mean_{role}")
    return f"{quantity(position, 'um')} and {quantity(orientation, 'arcsec')}"


def _is_known(facts: pd.Series, figure: str) -> bool:
    return bool(np.isfinite(facts.get(figure, np.nan)))


def _gain(tables: Tables, chosen: Key, facts: pd.Series) -> str:
    """Return in words the gain by calibration over nominal parameters, and over a fit by the implicit objectives."""
    texts = []
    nominal, reported = (figures_by_calibration(tables, estimator) for estimator in (NOMINAL, IMPLICIT))
    if not _is_known(facts, _HELD_OUT):
        return ""
    if nominal is not None and _HELD_OUT in nominal and nominal[_HELD_OUT].notna().any():
        before = nominal.dropna(subset=_HELD_OUT).iloc[0]
        times = plain(before[_HELD_OUT] / facts[_HELD_OUT])
        texts.append(
            f"With nominal parameters, the mean error on these poses is {_error_words(before, 'verification')}; "
            f"the position error is {times} times that of the chosen calibration."
        )
    if reported is not None and chosen in reported.index and _is_known(reported.loc[chosen], _HELD_OUT):
        size = _error_words(reported.loc[chosen], "verification")
        texts.append(f"The same model, fitted by the implicit objectives, has a mean error of {size}.")
    return " ".join(texts)


def _rivals(figures: pd.DataFrame, chosen: Key) -> str:
    """Return in words the calibrations that predict equally well as the chosen one, and the errors of the others."""
    alternatives = figures.drop(index=[chosen])
    equal = (
        alternatives["indistinguishable"] == 1.0
        if "indistinguishable" in alternatives
        else alternatives.index != alternatives.index
    )
    texts = []
    if equal.any():
        named = " and ".join(calibration_name((str(m), str(d))) for m, d in alternatives.index[equal])
        texts.append(f"These data do not distinguish the chosen calibration from {named}; the simplest is chosen.")
    inferior = alternatives[~equal]
    if len(inferior) and "heldout_ratio" in inferior and inferior["heldout_ratio"].notna().any():
        pulls = f", rms pull {_from_to(inferior['rms_pull'])}" if "rms_pull" in inferior else ""
        who = "The other calibration is" if len(inferior) == 1 else f"The {len(inferior)} other calibrations are"
        ratios = _from_to(inferior["heldout_ratio"])
        texts.append(f"{who} less probable or less accurate: held-out error {ratios} times the noise floor{pulls}.")
    return " ".join(texts)


def _extended(tables: Tables) -> str:
    """Return in words the errors of the extended model at the same poses."""
    figures = figures_by_calibration(tables, TO_POINTS)
    if figures is None or not _is_known(figures.iloc[0], _HELD_OUT):
        return ""
    errors = _error_words(figures.iloc[0], "verification")
    return f"The mean error of the extended model of the diagnosis on the held-out poses is {errors}."


def _from_to(values: pd.Series) -> str:
    low, high = plain(float(values.min())), plain(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _failures(fitted: pd.DataFrame) -> str:
    if "status" not in fitted:
        return ""
    bad = fitted[~fitted["status"].isin(GOOD)]
    return f"{count_text(len(keys_of(bad)), 'calibration')} did not converge." if len(bad) else ""


def _free(fitted: pd.DataFrame) -> str:
    """Return in words the reason that errors of poses are missing, if there are too few legs."""
    if fitted["leg"].nunique() >= _LEAST_LEGS:
        return ""
    return "Fewer than six legs do not constrain the platform: readings predict no pose, so no pose error is stated."


def _cost_of_models(tables: Tables) -> str:
    """Return the errors of the other structures with the deformation of the chosen one, and their
    departures from it."""
    figures, chosen = figures_by_calibration(tables), chosen_calibration(tables)
    if figures is None or chosen is None or _HELD_OUT not in figures:
        return "Position: distance between measured and predicted origin of the platform; orientation: angle."
    same = figures.xs(chosen[1], level="deformation").dropna(subset=_HELD_OUT)
    sizes = ", ".join(f"{model} {quantity(size, 'um')}" for model, size in same[_HELD_OUT].items())
    text = f"Held-out position error with the same deformation: {sizes}.{_departures(tables)}"
    distinguishable = same[(same["chosen"] != 1.0) & (same.get("indistinguishable", 0.0) != 1.0)]
    if not len(distinguishable):
        return text
    return f"{text} Over this range the models are not equivalent."


def _departures(tables: Tables) -> str:
    """Return the differences of the readings required by other models from those of rigid legs at the same poses."""
    nominal = figures_by_calibration(tables, NOMINAL)
    if nominal is None or _DEPARTS not in nominal or not nominal[_DEPARTS].notna().any():
        return ""
    known = nominal[_DEPARTS].dropna()
    sizes = ", ".join(f"{model} {quantity(size, 'um')}" for (model, _), size in known.items())
    return f" At the same poses, their readings differ from those of rigid legs by (rms): {sizes}.{_load(nominal)}"


def _load(nominal: pd.DataFrame) -> str:
    """Return the motion of the platform by the external load, from the stiffness model."""
    if "load_shift_rms" not in nominal or not nominal["load_shift_rms"].notna().any():
        return ""
    constant, varying = (
        quantity(float(nominal[name].dropna().iloc[0]), "um") for name in ("load_shift_rms", "load_shift_varying")
    )
    return (
        f" By the stiffness model, the external load moves the platform by {constant} rms, of which {varying} differ "
        "between poses."
    )


def _method_words(tables: Tables) -> str:
    """Return in words the effect of errors in variables and of tolerances as prior on the chosen calibration."""
    main_figures, implicit_figures = figures_by_calibration(tables), figures_by_calibration(tables, IMPLICIT)
    chosen = chosen_calibration(tables)
    if main_figures is None or implicit_figures is None or chosen is None or chosen not in implicit_figures.index:
        return ""
    a, b = implicit_figures.loc[chosen], main_figures.loc[chosen]
    parts = [
        f"{words} {plain(a[figure])} against {plain(b[figure])}"
        for figure, words in (("heldout_ratio", "held out / noise"), ("rms_pull", "rms pull"))
        if _is_known(a, figure) and _is_known(b, figure)
    ]
    return f"For the chosen model: {', '.join(parts)}" if parts else ""
