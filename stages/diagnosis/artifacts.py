"""Artifacts and closing line of the stage diagnose."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import pyarrow as pa

from truing.inference.detectable import assessed
from truing.report.diagnosis.assessed_causes import WITHOUT_FINDINGS
from truing.report.numbers import count_text, gross_errors, sign, two_decimals
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome
from truing.stages.diagnosis.applied import applied_model, choices_table
from truing.stages.diagnosis.cause_tables import (
    adequacy_table,
    combinations_table,
    detectable_table,
    detectable_words,
    uncertainty_table,
)
from truing.stages.diagnosis.ray_findings import with_rays
from truing.stages.diagnosis.residual_tables import left_out_table
from truing.stages.diagnosis.rows import DetectionAdvice, diagnosis_table
from truing.stages.diagnosis.search import rule_of, rule_with_rays

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.selection import CauseDiagnosis, Settings
    from truing.schemas.campaign import Campaign
    from truing.simulation.effects_model import EffectsModel
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData, ReportedRms
    from truing.stages.diagnosis.ray_findings import RayFindings

# With fewer platform targets away from the attachments, shifts are known only modulo a plane.
_FRAMING = 3


def outcome(
    diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], rays: RayFindings | None, settings: Campaign
) -> Outcome:
    """Outcome for points or readings, after the results of rays."""
    rule = rule_of(settings)
    artifacts = artifacts_of(diagnosis, data, rule if rays is None else rule_with_rays(rule), settings)
    shown = data.shown.overall(diagnosis.final.error)
    rejected = artifacts.get("diagnosis_left_out")
    number = rejected.num_rows if isinstance(rejected, pa.Table) else 0
    gross = gross_errors(number, shown.what) if number else ""
    read, left_out = _read(data, shown), [data.left_out, gross]
    if rays is not None:
        artifacts = with_rays(artifacts, rays, rule)
        read, left_out = f"{read}; {rays.read}", [*left_out, rays.left_out]
    choices = choices_table(settings, artifacts["diagnosis"], data.is_calibrated)
    if (text := applied_model(diagnosis, data, settings, choices)) is not None:
        artifacts["applied_model"] = text
    figure = _figure(artifacts["diagnosis"], diagnosis, shown, rule)
    return Outcome(with_choices(artifacts, choices), read, "; ".join(filter(None, left_out)) or "nothing", figure)


def outcome_of_rays(rays: RayFindings, why: str, settings: Campaign) -> Outcome:
    """Outcome for rays if points cannot be compared with anything, with the reason."""
    artifacts = with_rays({"diagnosis": ARTIFACTS["diagnosis"].empty()}, rays, rule_of(settings))
    figure = f"{_found_causes(artifacts['diagnosis'])} in rays; points not evaluated: {why}"
    return Outcome(
        with_choices(artifacts, choices_table(settings, artifacts["diagnosis"])),
        rays.read,
        rays.left_out or "nothing",
        figure,
    )


def not_evaluated(why: str, settings: Campaign) -> Outcome:
    """Outcome without evaluation, with the reason."""
    nothing = ARTIFACTS["diagnosis"].empty()
    return Outcome.not_evaluated(with_choices({"diagnosis": nothing}, choices_table(settings, nothing)), why)


def with_choices(artifacts: dict[str, object], choices: pa.Table | None) -> dict[str, object]:
    """Artifacts with the outcome of the causes named in campaign.toml, if any."""
    return artifacts if choices is None else {**artifacts, "diagnosis_choices": choices}


def artifacts_of(
    diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], rule: Settings, settings: Campaign
) -> dict[str, pa.Table | str]:
    """Tables and text by artifact."""
    diagnosis = replace(diagnosis, verdicts=assessed(diagnosis.verdicts, diagnosis.search, rule.level))
    last, legs = diagnosis.search, diagnosis.plain.model.part_count
    instrument_results = data.instrument_results(diagnosis, data, settings)
    detectable = detectable_words(last, rule.level, [verdict.cause for verdict in diagnosis.verdicts], legs)
    words = DetectionAdvice(
        detectable, instrument_results.advice, _remark(data, diagnosis.final), data.shown, data.relation
    )
    left = {
        "diagnosis": diagnosis_table(diagnosis, words, rule.noise_level),
        "adequacy": adequacy_table(diagnosis, rule, data.shown.what),
        "detectable": detectable_table(last, rule.level, legs),
        "cause_uncertainty": uncertainty_table(diagnosis, legs),
        "determined_combinations": combinations_table(diagnosis, legs),
        "diagnosis_left_out": left_out_table(diagnosis, data) if diagnosis.screened or data.isolated else None,
        **instrument_results.artifacts,
    }
    return {name: artifact for name, artifact in left.items() if artifact is not None}


def _remark(data: DiagnosisData[EffectsModel], final: FittedModel) -> str:
    """Limitation of all statements."""
    texts = []
    if data.framing is not None and data.framing < _FRAMING:
        texts.append(
            "Fewer than three platform targets are not at an attachment, so shifts are known except for a common plane "
            "(z and two tilts)."
        )
    if final.fit.state != "settled":
        texts.append("The fit did not converge within its iterations: treat its numbers as provisional.")
    return " ".join(texts)


def _read(data: DiagnosisData[EffectsModel], shown: ReportedRms) -> str:
    held_out_count = 0 if data.held_out is None else len(data.held_out.conditions.readings)
    seen = int(data.calibration.measured.is_observed.sum())
    used = count_text(len(data.calibration.conditions.readings), shown.epoch)
    return f"{count_text(seen, shown.what)} of {used}, {count_text(held_out_count, shown.epoch)} held out"


def _figure(table: pa.Table, diagnosis: CauseDiagnosis, shown: ReportedRms, rule: Settings) -> str:
    final = diagnosis.final
    rms, floor = shown.rms(final.error) or 0.0, shown.floor(final.floor)
    unit = sign(shown.unit)
    left = f"{two_decimals(rms)} {unit}"
    left += ", noise not declared" if floor is None else f", noise floor {two_decimals(floor)} {unit}"
    if not diagnosis.end.is_complete:
        left += f"; the search stopped after {count_text(diagnosis.end.accepted, 'cause')}, other effects remain"
    elif diagnosis.adequacy.p_value <= rule.doubted_level:
        left += "; the model as a whole does not fit"
    if not {"found", "suspected"} & set(table.column("verdict").to_pylist()):
        return f"nothing found: rms error of fitted data {left}"
    before = shown.rms(diagnosis.errors_without_any[0]) or 0.0
    return f"{_found_causes(table)}: rms error of fitted data {two_decimals(before)} -> {left}"


def _found_causes(table: pa.Table) -> str:
    """Found and suspected causes in words, without what only a model without them shows."""
    names: dict[str, list[str]] = {"found": [], "suspected": []}
    for row in table.to_pylist():
        is_conditional = json.loads(row["settings"] or "{}").get(WITHOUT_FINDINGS)
        if row["verdict"] in names and not is_conditional:
            # Findings on the noise have no name among the causes.
            is_noise = (row["reason_code"], row["cause"]) == ("noise", "unexplained")
            names[row["verdict"]].append("noise not as declared" if is_noise else row["cause"])
    texts = [
        f"{verdict} {', '.join(dict.fromkeys(causes_of_verdict))}"
        for verdict, causes_of_verdict in names.items()
        if causes_of_verdict
    ]
    return "; ".join(texts) or "nothing found"
