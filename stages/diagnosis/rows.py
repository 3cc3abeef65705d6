"""Rows of diagnosis.parquet: the decision on each candidate, in numbers and in words."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.inference.noise import merged_by_driver
from truing.report.diagnosis.assessed_causes import PARTLY_BY_FINDINGS, REMAINDER, WITHOUT_FINDINGS
from truing.report.diagnosis.findings import (
    ESTIMATED_NOISE,
    Facts,
    NoiseFacts,
    explanation,
    missing_explanation,
    noise_explanation,
    scatter_explanation,
    single_errors_advice,
    single_errors_explanation,
)
from truing.report.wordings.catalogue import cause_words, clause, confirming, own_clause
from truing.report.wordings.claim import ONSET_BETWEEN, Advice, Claim, ParameterSize
from truing.report.wordings.nonparametric_wordings import (
    INSTEAD,
    QUANTITIES_INSTEAD,
    columns_words,
    remainder_advice,
    remainder_clause,
    remainder_explanation,
)
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.covariates import listed, own_name
from truing.schemas.verdict import Relation
from truing.simulation.bodies.causes.terms import CAME_FROM
from truing.simulation.inputs import ORDER, TIME
from truing.stages.diagnosis.diagnosis_data import POINTS, Channels, ReportedRms

if TYPE_CHECKING:
    from truing.inference.attribution import Attributed
    from truing.inference.fitted_model import FittedModel
    from truing.inference.noise import NoiseDependence, NoiseLevel
    from truing.inference.scatter import FoundScatter
    from truing.inference.selection import CauseDiagnosis
    from truing.inference.single_errors import SingleErrors
    from truing.inference.verdicts import Verdict
    from truing.simulation.cause import Cause


@dataclass(frozen=True)
class DetectionAdvice:
    """Contents of the rows besides the verdicts: smallest detectable sizes and next measurements by cause key, the
    common limit, the unit of sizes, and the relation that the search uses."""

    detectable: Mapping[str, str] = field(default_factory=dict)
    next_measurement: Mapping[str, Advice] = field(default_factory=dict)
    remark: str = ""
    shown: ReportedRms | Channels = POINTS
    relation: Relation = Relation.READINGS_POSES


def diagnosis_table(diagnosis: CauseDiagnosis, words: DetectionAdvice, noise_level: float) -> pa.Table:
    """Rows of the verdicts in their order, noise that is larger than declared behind the findings.

    ``noise_level`` is the p-value below which it is.
    """
    rows = [_row(verdict, diagnosis, words) for verdict in diagnosis.verdicts]
    accepted_count = sum(row["verdict"] in ("found", "suspected") for row in rows)
    left = [*_noise_rows(diagnosis, words.shown, noise_level), *_attributed_rows(diagnosis, words.shown, noise_level)]
    rows[accepted_count:accepted_count] = left
    rows += _missing_rows(diagnosis)
    return ranked_table([{**row, "relation": words.relation.value} for row in rows])


def _missing_rows(diagnosis: CauseDiagnosis) -> Iterator[TableRow]:
    """Yield a row per cause that could not be tested because something was not recorded or varied."""
    for cause in cast("tuple[Cause, ...]", diagnosis.unasked):
        if missing := cause.missing_input(diagnosis.plain.scene):
            text = clause(claim_of(cause, diagnosis.plain.model.part_count))
            yield {
                "cause": cause.id,
                "verdict": "not testable",
                "reason_code": str(missing),
                "subject": "",
                "parameters": "{}",
                "follows": "",
                "explanation": missing_explanation(cause_words(cause.id), missing),
                "next_measurement": "",
                "unit": "",
                "settings": "{}",
                "clause": text,
            }


def ranked_table(rows: list[TableRow]) -> pa.Table:
    """Rows of diagnosis.parquet, ranked as they stand."""
    artifact = ARTIFACTS["diagnosis"]
    ranked = [{**row, "rank": rank} for rank, row in enumerate(rows, 1)]
    return pa.Table.from_pylist(ranked, schema=artifact.arrow_schema(present=artifact.optional))


def _row(verdict: Verdict, diagnosis: CauseDiagnosis, words: DetectionAdvice) -> dict[str, object]:
    cause, legs = verdict.cause, diagnosis.plain.model.part_count
    shown, claim = words.shown.of_effect(verdict.before, verdict.after), _claim(verdict, legs)
    if verdict.verdict in ("found", "suspected"):
        claim = replace(claim, settings={**claim.settings, **cause.shared_with(diagnosis.plain.scene)})
    if verdict.onsets is not None:
        claim = replace(claim, settings={**claim.settings, ONSET_BETWEEN: _onset_names(verdict.onsets)})
    if verdict.inputs:
        claim = replace(claim, settings={**claim.settings, INSTEAD: [list(inputs) for inputs, _ in verdict.inputs]})
    if verdict.quantities:
        claim = replace(claim, settings={**claim.settings, QUANTITIES_INSTEAD: list(verdict.quantities)})
    fitted = with_fitted_settings(claim, reported_parameters(verdict, legs))
    if verdict.verdict in ("found", "suspected"):
        fitted = replace(fitted, is_negative=_is_negative(reported_parameters(verdict, legs)))
    facts = _facts(verdict, diagnosis, words, fitted)
    advice = words.next_measurement.get(cause.key) or confirming(fitted, cause.confirm)
    if verdict.course is not None and cause.key not in words.next_measurement:
        advice = replace(advice, words=remainder_advice(verdict.course.follows))
    return {
        "cause": cause.id,
        "verdict": verdict.verdict,
        "subject": cause.subject,
        "p_value": verdict.p_value,
        "probability": verdict.probability,
        "parameters": json.dumps(facts.parameters),
        "follows": listed(claim.follows),
        **_errors(shown, verdict),
        **_errors_without_any(shown, diagnosis),
        "explanation": explanation(facts),
        **_advised(advice),
        "reason_code": facts.reason_code,
        "rival": facts.rival or None,
        "settings": json.dumps(claim.settings),
        "clause": facts.clause,
        "largest_motion": facts.largest,
        "signal_to_noise": verdict.signal_to_noise,
        "share_explained": verdict.share_explained,
        **_left_out(verdict, diagnosis),
        "heldout_growth": facts.held_out_growth,
        "in_model": cause.key in diagnosis.final.model.layout,
        "log_evidence": verdict.log_odds,
        "scale_holds": None if verdict.scale_holds is None else "holds" if verdict.scale_holds else "changes",
    }


def _onset_names(onsets: tuple[Cause, Cause]) -> list[object]:
    """Return the poses or steps of the earliest and the latest possible onset."""
    settings = [cause.settings() for cause in onsets]
    return [setting["from_pose" if "from_pose" in setting else "from_step"] for setting in settings]


def _errors(shown: ReportedRms, verdict: Verdict) -> dict[str, object]:
    """Return the prediction errors without and with a cause, in its reporting unit."""
    return {
        "rms_before": shown.rms(verdict.before),
        "rms_after": shown.rms(verdict.after),
        "heldout_rms_before": shown.rms(verdict.held_out[0]),
        "heldout_rms_after": shown.rms(verdict.held_out[1]),
        "noise_floor": shown.floor(verdict.floor),
        "unit": shown.unit,
    }


def _held_out_growth(verdict: Verdict) -> float | None:
    """Return the ratio of all held-out errors with a cause to those without it, each in units of its noise."""
    before, after = verdict.held_out
    return None if before is None or after is None else after.growth_over(before)


def _errors_without_any(shown: ReportedRms, diagnosis: CauseDiagnosis) -> dict[str, object]:
    """Return the prediction errors without any cause, which errors without one cause do not give: a cause may be
    compared next to all others."""
    error, held_out = diagnosis.errors_without_any
    return {"rms_without_any": shown.rms(error), "heldout_rms_without_any": shown.rms(held_out)}


def _left_out(verdict: Verdict, diagnosis: CauseDiagnosis) -> dict[str, object]:
    """Return the type of blocks left out, and the gain of the finding there."""
    if not verdict.blocks_asked:
        return {}
    gain = verdict.block_gain
    if gain is None:
        return {"left_out_by": "one-block" if diagnosis.blocks else "none"}
    return {"left_out_by": str(gain.kind), "left_out_blocks": gain.blocks, "left_out_gain": gain.log_gain}


def _advised(advice: Advice) -> dict[str, object]:
    """Next measurement."""
    short, purpose = advice.short or None, advice.purpose or None
    return {
        "next_measurement": advice.words,
        "advice_kind": advice.kind,
        "next_in_short": short,
        "next_purpose": purpose,
    }


def _facts(verdict: Verdict, diagnosis: CauseDiagnosis, words: DetectionAdvice, claim: Claim) -> Facts:
    """Return the facts on which the sentence of a verdict is based."""
    cause, shown = verdict.cause, words.shown.of_effect(verdict.before, verdict.after)
    return Facts(
        verdict.verdict,
        clause(claim),
        reported_parameters(verdict, diagnosis.plain.model.part_count),
        verdict.p_value,
        verdict.candidates,
        shown.rms(verdict.before),
        shown.rms(verdict.after),
        (shown.rms(verdict.held_out[0]), shown.rms(verdict.held_out[1])),
        shown.floor(verdict.floor),
        str(verdict.reason or verdict.verdict),
        "" if verdict.rival is None else verdict.rival.id,
        words.detectable.get(cause.key, ""),
        not cause.catalogued,
        words.remark,
        subject=claim.subject,
        share=verdict.share_explained,
        odds=_odds(verdict, diagnosis),
        largest=shown.largest_motion(verdict.before, verdict.after)
        if verdict.verdict in ("found", "suspected")
        else None,
        subjects=tuple(subject for subject in verdict.subjects if subject[0] not in claim.settings.get("alike", ())),
        inputs=tuple((columns_words(inputs), odds) for inputs, odds in verdict.inputs),
        unit=shown.unit,
        fitted_words=shown.fitted,
        held_out_words=shown.held_out,
        drive=shown.drive,
        course=None if verdict.course is None else verdict.course.follows,
        is_course_beside=verdict.course is not None and verdict.course.is_beside,
        held_out_growth=_held_out_growth(verdict),
        floor_has_scatter=diagnosis.floor_has_scatter,
    )


def _claim(verdict: Verdict, legs: int) -> Claim:
    """Return the claim of a verdict; a nonparametric effect of all legs is claimed only of those where it is clear."""
    cause, claim = verdict.cause, claim_of(verdict.cause, legs)
    if cause.catalogued or not len(verdict.values):
        return claim
    clear = cause.narrowed(verdict.values, verdict.covariance, legs)
    return replace(claim, subject=clear.subject, follows=clear.inputs(legs))


def _is_negative(reported: Mapping[str, Mapping[str, object]]) -> bool:
    """True if all fitted sizes are."""
    sizes = [entry["value"] for entry in reported.values() if isinstance(entry["value"], float)]
    return bool(sizes) and max(sizes) < 0.0


def with_fitted_settings(claim: Claim, reported: Mapping[str, Mapping[str, object]]) -> Claim:
    """The claim with the fitted values of settings that a fit refines, such as the order of a wave."""
    fitted = {name: reported[name]["value"] for name in claim.settings if name in reported}
    return replace(claim, settings={**claim.settings, **fitted})


def claim_of(cause: Cause, legs: int) -> Claim:
    """A cause in words for a mechanism with that many legs, without its sizes."""
    settings = {"step": str(cause.step), **cause.settings()}
    return Claim(
        cause=cause.id,
        subject=cause.subject,
        follows=cause.inputs(legs),
        settings={name: _plain(value) for name, value in settings.items()},
        words=own_clause(cause.says, cause.subject) if cause.says else "",
    )


def _plain(value: object) -> object:
    """A setting as JSON holds it; None if it is not finite."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def reported_parameters(verdict: Verdict, legs: int) -> dict[str, dict[str, object]]:
    """A cause's parameters as the contract names them: value, sigma, unit."""
    reported = verdict.cause.reported(verdict.values, verdict.covariance, legs)
    return {p.name: {"value": p.value, "sigma": p.sigma, "unit": p.unit} for p in reported}


def _odds(verdict: Verdict, diagnosis: CauseDiagnosis) -> float | None:
    """Odds of the found cause against its rival."""
    rival = None if verdict.rival is None else verdict.rival.key
    other = next((verdict for verdict in diagnosis.verdicts if verdict.cause.key == rival), None)
    return None if other is None else math.exp(other.log_odds - verdict.log_odds)


def _noise_rows(diagnosis: CauseDiagnosis, shown: ReportedRms | Channels, level: float) -> list[TableRow]:
    """Noise that is larger in places, that of single channels, and where none has its own that of all."""
    final = diagnosis.final
    overall = shown.overall(final.error)
    repeated = diagnosis.has_repeats
    single = diagnosis.single_errors
    same = {single.candidate.cause.subject} if single else set()
    scatters = [
        scatter for scatter in diagnosis.scatters if not (scatter.doubt and scatter.candidate.cause.subject in same)
    ]
    rows = [_scatter_row(scatter, final, overall, is_repeated=repeated) for scatter in scatters]
    rows += [_single_errors_row(single, final, overall)] if single else []
    rows += [
        _noise_dependence_row(dependence, final, overall)
        for dependence in merged_by_driver(diagnosis.noise_dependences)
    ]
    has_scatter = diagnosis.floor_has_scatter
    for target, noise_of_target in diagnosis.noisy:
        subject = f"{final.model.channel_word} {_name(final, target)}"
        of_target = _larger_row(
            noise_of_target, final, shown.of_target(target), has_scatter=diagnosis.floor_has_scatter
        )
        rows.append(of_target | {"subject": subject})
    if diagnosis.noise.p_value <= level and not diagnosis.noisy:
        rows.append(_larger_row(diagnosis.noise, final, overall, has_scatter=has_scatter))
    return rows


def _attributed_rows(
    diagnosis: CauseDiagnosis, shown: ReportedRms | Channels, noise_level: float
) -> Iterator[TableRow]:
    """Inputs that predict the residuals of the simulation, and that no nonparametric effect has.

    If the final model holds, an effect without a name needs no inputs but its own: others help by chance, or take up
    what a smooth function of its own inputs leaves.
    """
    holds = diagnosis.end.is_complete and diagnosis.adequacy.p_value > noise_level
    final, legs = diagnosis.final, diagnosis.plain.model.part_count
    unnamed = [
        verdict.cause for verdict in diagnosis.verdicts if verdict.verdict == "found" and not verdict.cause.catalogued
    ]
    for attribution in diagnosis.attributed:
        names = [*(_channel(final, channel) for channel in attribution.channels), *filter(None, [attribution.subject])]
        follows = _dependence_columns(attribution)
        owner = attribution.channels, attribution.subject
        beside = [peer for peer in diagnosis.attributed if names and (peer.channels, peer.subject) == owner]
        reported = [set(cause.inputs(legs)) for cause in unnamed if not names or cause.subject in ("", *names)]
        is_needless = holds and (
            any(set(cause.inputs(legs)) <= set(follows) for cause in unnamed)
            or any(columns <= set(_dependence_columns(peer)) for peer in beside for columns in reported)
        )
        if is_needless or any(set(follows) <= columns for columns in reported):
            continue
        where = shown.of_target(attribution.channels[0]) if attribution.channels else shown.overall(final.error)
        text = remainder_clause(follows, " ".join(names), attribution.share, remains=attribution.remains)
        yield _without_mean_effect(attribution.p_value, final, where) | {
            "reason_code": REMAINDER,
            "subject": names[0] if names else "",
            "parameters": "{}",
            "follows": listed(follows),
            "settings": json.dumps(_next_to_findings(attribution)),
            "share_predicted": attribution.share,
            "explanation": remainder_explanation(
                text,
                attribution.p_value,
                is_of_all=not names,
                remains=attribution.remains,
                is_partial=attribution.is_partial,
            ),
            "next_measurement": remainder_advice(follows),
        }


def _next_to_findings(attribution: Attributed) -> dict[str, bool]:
    """Return the settings of inputs that predict residuals: whether the findings may explain all of it, or a part."""
    if not attribution.remains:
        return {WITHOUT_FINDINGS: True}
    return {PARTLY_BY_FINDINGS: True} if attribution.is_partial else {}


def _larger_row(level: NoiseLevel, final: FittedModel, shown: ReportedRms, *, has_scatter: bool) -> dict[str, object]:
    """Noise larger than declared is structure too: an unknown effect moves the measurements."""
    missed = shown.rms(final.error), shown.floor(final.floor)
    expected = shown.noise if shown.is_noise_known else ESTIMATED_NOISE
    facts = NoiseFacts(level.ratio, level.sigma, *missed, shown.unit, expected=expected, floor_has_scatter=has_scatter)
    text = noise_explanation(facts)
    return _of_noise(level, final, shown) | {"explanation": text, "next_measurement": shown.scatter}


def _dependence_columns(attribution: Attributed) -> tuple[str, ...]:
    """The columns of the tables that residuals depend on."""
    return tuple(dict.fromkeys(column for name in attribution.inputs for column in _dependence_column(name)))


def _channel(final: FittedModel, channel: int) -> str:
    """A channel with its sort, as subjects of causes name it."""
    kinds = final.model.channel_kinds
    word = "signal" if kinds[channel : channel + 1] == ("signal",) else final.model.channel_word
    return f"{word} {_name(final, channel)}"


def _name(final: FittedModel, target: int) -> str:
    return final.model.channel_names[target]


def _dependence_column(column: str) -> tuple[str, ...]:
    """The column of the configurations that noise follows: the order of poses is that of their times."""
    plain = column.removeprefix(CAME_FROM)
    return (TIME if plain == ORDER else plain,) if plain else ()


def _noise_dependence_row(dependence: NoiseDependence, final: FittedModel, shown: ReportedRms) -> dict[str, object]:
    """Noise that is larger in places, and the cause, the column or the target that it follows."""
    if dependence.driver.cause is not None:
        size = dependence.ratio, dependence.sigma
        return _row_of_cause(
            cast("Cause", dependence.driver.cause), size, dependence.p_value, dependence.doubt, final, shown
        )
    names = [_name(final, target) for target in dependence.driver.channels]
    whose = final.model.channel_word
    alone = f"{whose} {names[0]}" if names else ""
    follows = own_name(dependence.driver.name) or alone
    where = f"Look at {follows}" if names else f"Repeat it where {follows} differs"
    missed = shown.rms(final.error), shown.floor(final.floor)
    facts = NoiseFacts(dependence.ratio, dependence.sigma, *missed, shown.unit, [follows], channel=alone)
    is_by_place = not names and not dependence.driver.column
    return _of_noise(dependence, final, shown) | {
        "subject": alone,
        "settings": json.dumps({"over": "others"} if names else {"place": follows} if is_by_place else {}),
        "follows": listed(_dependence_column(dependence.driver.column)),
        "explanation": noise_explanation(facts),
        "next_measurement": f"{shown.scatter} {where}.",
    }


def _scatter_row(scatter: FoundScatter, final: FittedModel, shown: ReportedRms, *, is_repeated: bool) -> TableRow:
    """Inputs that scatter more than they are known beforehand, by a cause that moves nothing on average."""
    cause, size = scatter.candidate.cause, (scatter.size, scatter.sigma)
    row = _row_of_cause(cause, size, scatter.p_value, scatter.doubt, final, shown)
    text = scatter_explanation(row["clause"], scatter.p_value, scatter.doubt, is_repeated=is_repeated)
    return row | {"explanation": text}


def _single_errors_row(single: SingleErrors, final: FittedModel, shown: ReportedRms) -> dict[str, object]:
    """Single large errors of one input, whose other errors are small."""
    subject = single.candidate.cause.subject
    ratio = {"value": single.ratio, "sigma": None, "unit": "1"}
    return _without_mean_effect(single.p_value, final, shown) | {
        "subject": subject,
        "parameters": json.dumps({"largest_ratio": ratio}),
        "settings": json.dumps({"large": single.count}),
        "explanation": single_errors_explanation(subject, single.count, single.ratio, single.p_value),
        "next_measurement": single_errors_advice(subject),
    }


def _row_of_cause(
    cause: Cause, size: tuple[float, float], p_value: float, doubt: str, final: FittedModel, shown: ReportedRms
) -> TableRow:
    """Return the row of a cause without mean effect, with its size and sigma, SI; ``doubt``: reason code if it is only
    suspected."""
    legs = final.model.part_count
    value, sigma = size
    values = cause.reported(np.array([value]), np.array([[sigma**2]]), legs)
    sizes = tuple(
        ParameterSize(parameter.name, parameter.value, parameter.sigma, parameter.unit) for parameter in values
    )
    claim = replace(claim_of(cause, legs), sizes=sizes)
    text = clause(claim)
    return _without_mean_effect(p_value, final, shown) | {
        "cause": cause.id,
        "subject": cause.subject,
        "parameters": json.dumps({s.name: {"value": s.value, "sigma": s.sigma, "unit": s.unit} for s in sizes}),
        "explanation": scatter_explanation(text, p_value, doubt),
        **({"verdict": "suspected", "reason_code": doubt} if doubt else {}),
        "settings": json.dumps(claim.settings),
        "clause": text,
        **_advised(confirming(claim, cause.confirm)),
    }


def _of_noise(level: NoiseLevel | NoiseDependence, final: FittedModel, shown: ReportedRms) -> dict[str, object]:
    """Return the cells of a row on noise that no cause increases."""
    ratio = {"value": level.ratio, "sigma": level.sigma, "unit": "1"}
    return _without_mean_effect(level.p_value, final, shown) | {"parameters": json.dumps({"noise_ratio": ratio})}


def _without_mean_effect(p_value: float, final: FittedModel, shown: ReportedRms) -> dict[str, object]:
    """Return the cells of a row on scatter: it has no effect on the mean, so it improves no prediction."""
    rms, held_out_rms = shown.rms(final.error), shown.rms(final.held_out)
    return {
        "cause": "unexplained",
        "verdict": "found",
        "reason_code": "noise",
        "subject": "",
        "p_value": p_value,
        "probability": 1.0 - p_value,
        "follows": "",
        "rms_before": rms,
        "rms_after": rms,
        "heldout_rms_before": held_out_rms,
        "heldout_rms_after": held_out_rms,
        "noise_floor": shown.floor(final.floor),
        "unit": shown.unit,
    }
