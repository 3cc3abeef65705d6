"""The rows of diagnosis.parquet: what was decided on each candidate, in numbers and in words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.covariates import listed, own_name
from truing.simulation.bodies.causes.terms import CAME_FROM
from truing.simulation.inputs import ORDER, TIME
from truing.stages.diagnosis.claims import claim_of
from truing.stages.diagnosis.shown import POINTS, Channels, Shown

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.fitted_model import FittedModel
    from truing.inference.noise import NoiseDependence, NoiseLevel
    from truing.inference.selection import Diagnosis
    from truing.inference.verdicts import Verdict
    from truing.report.wordings.claim import Advice
    from truing.stages.diagnosis.ray_points import RayShown


@dataclass(frozen=True)
class Words:
    """What the rows say beside the verdicts: the smallest sizes that would have been seen, and what to measure next, by
    a cause's key, and what limits all statements; ``channels`` of readings, None where all are points."""

    detectable: Mapping[str, str]
    next_measurement: Mapping[str, Advice]
    remark: str
    channels: Channels | RayShown | None = None

    def of_verdict(self, verdict: Verdict) -> Shown:
        """In which unit, and over what, a verdict's numbers are told."""
        return POINTS if self.channels is None else self.channels.concerned(verdict.before, verdict.after)

    def of_target(self, target: int) -> Shown:
        """The same of what concerns one channel."""
        return POINTS if self.channels is None else self.channels.only(target)

    def of_noise(self, final: FittedModel) -> Shown:
        """The same of noise, which concerns all that was measured."""
        return POINTS if self.channels is None else self.channels.whole(final.error)


def diagnosis_table(diagnosis: Diagnosis, words: Words, noise_level: float) -> pa.Table:
    """Rows of the verdicts in their order, noise that is larger than declared behind what was found.

    ``noise_level`` is the p-value below which it is.
    """
    import pyarrow as pa

    rows = [_row(verdict, diagnosis, words) for verdict in diagnosis.verdicts]
    shown = words.of_noise(diagnosis.final)
    noisy = [_following_row(own, diagnosis.final, shown) for own in diagnosis.noise_dependences]
    noisy += [_noisy_row(target, level, diagnosis.final, words) for target, level in diagnosis.noisy]
    if diagnosis.noise.p_value <= noise_level and not diagnosis.noisy:
        noisy.append(_noise_row(diagnosis.noise, diagnosis.final, shown))
    found = sum(row["verdict"] == "found" for row in rows)
    rows[found:found] = noisy
    ranked = [{"rank": rank, **row} for rank, row in enumerate(rows, 1)]
    artifact = ARTIFACTS["diagnosis"]
    return pa.Table.from_pylist(ranked, schema=artifact.arrow_schema(present=artifact.optional))


def _row(verdict: Verdict, diagnosis: Diagnosis, words: Words) -> dict[str, Any]:
    from truing.report.diagnosis.findings import Facts, explanation
    from truing.report.wordings.catalogue import clause, confirming

    cause, legs = verdict.cause, diagnosis.plain.model.part_count
    parameters = told_parameters(verdict, legs)
    shown = words.of_verdict(verdict)
    claim = claim_of(cause, legs)
    held = (shown.rms(verdict.held_out[0]), shown.rms(verdict.held_out[1]))
    facts = Facts(
        verdict.verdict,
        clause(claim),
        parameters,
        verdict.p_value,
        verdict.candidates,
        shown.rms(verdict.before),
        shown.rms(verdict.after),
        held,
        shown.floor(verdict.floor),
        str(verdict.reason or verdict.verdict),
        "" if verdict.rival is None else verdict.rival.id,
        words.detectable.get(cause.key, ""),
        not cause.catalogued,
        words.remark,
        subject=cause.subject,
        odds=_odds(verdict, diagnosis),
        largest=shown.largest_motion(verdict.before, verdict.after) if verdict.verdict == "found" else None,
        subjects=verdict.subjects,
        unit=shown.unit,
        fitted_words=shown.fitted,
        held_out_words=shown.held_out,
        drive=shown.drive,
    )
    advice = words.next_measurement.get(cause.key) or confirming(claim, cause.confirm)
    return {
        "cause": cause.id,
        "verdict": verdict.verdict,
        "subject": cause.subject,
        "p_value": verdict.p_value,
        "probability": verdict.probability,
        "parameters": json.dumps(parameters),
        "follows": listed(cause.follows(legs)),
        "rms_before": facts.rms_before,
        "rms_after": facts.rms_after,
        "heldout_rms_before": held[0],
        "heldout_rms_after": held[1],
        "noise_floor": facts.floor,
        "unit": shown.unit,
        "explanation": explanation(facts),
        "next_measurement": advice.words,
        "advice_kind": advice.kind,
        "next_in_short": advice.short or None,
        "reason_code": facts.reason_code,
        "rival": facts.rival or None,
        "settings": json.dumps(claim.settings),
        "clause": facts.clause,
        "largest_motion": facts.largest,
        "signal_to_noise": verdict.signal_to_noise,
        "log_evidence": verdict.log_odds,
        "scale_holds": None if verdict.scale_holds is None else "holds" if verdict.scale_holds else "changes",
    }


def told_parameters(verdict: Verdict, legs: int) -> dict[str, dict[str, Any]]:
    """A cause's parameters as the contract names them: value, sigma, unit."""
    told = verdict.cause.reported(verdict.values, verdict.covariance, legs)
    return {p.name: {"value": p.value, "sigma": p.sigma, "unit": p.unit} for p in told}


def _odds(verdict: Verdict, diagnosis: Diagnosis) -> float | None:
    """How much more probable the found cause is than one that cannot be told from it."""
    import math

    rival = None if verdict.rival is None else verdict.rival.key
    other = next((one for one in diagnosis.verdicts if one.cause.key == rival), None)
    return None if other is None else math.exp(other.log_odds - verdict.log_odds)


def _noise_row(level: NoiseLevel, final: FittedModel, shown: Shown) -> dict[str, Any]:
    """Noise larger than declared is structure too: something moves what was measured that nothing here explains."""
    from truing.report.diagnosis.findings import noise_explanation

    said = noise_explanation(
        level.ratio, level.sigma, shown.rms(final.error), shown.floor(final.floor), unit=shown.unit
    )
    return _of_noise(level, final, shown) | {"explanation": said, "next_measurement": shown.scatter}


def _noisy_row(target: int, level: NoiseLevel, final: FittedModel, words: Words) -> dict[str, Any]:
    """One channel that is noisier than declared."""
    shown = words.of_target(target)
    return _noise_row(level, final, shown) | {"subject": f"{final.model.channel_word} {_name(final, target)}"}


def _name(final: FittedModel, target: int) -> str:
    return final.model.channel_names[target]


def _followed_column(column: str) -> tuple[str, ...]:
    """The column of the configurations that noise follows: the order of poses is that of their times."""
    plain = column.removeprefix(CAME_FROM)
    return (TIME if plain == ORDER else plain,) if plain else ()


def _following_row(own: NoiseDependence, final: FittedModel, shown: Shown) -> dict[str, Any]:
    """Noise that is larger in places, and the column or the target that it follows."""
    from truing.report.diagnosis.findings import noise_explanation

    names = [_name(final, target) for target in own.driver.channels]
    whose = final.model.channel_word
    follows = own_name(own.driver.name) or f"{whose} {names[0]}"
    where = f"Look at {follows}" if names else f"Repeat it where {follows} differs"
    missed = shown.rms(final.error), shown.floor(final.floor)
    said = noise_explanation(own.ratio, own.sigma, *missed, [follows], shown.unit)
    return _of_noise(own, final, shown) | {
        "subject": f"{whose} {names[0]}" if names else "",
        "follows": listed(_followed_column(own.driver.column)),
        "explanation": said,
        "next_measurement": f"{shown.scatter} {where}.",
    }


def _of_noise(level: NoiseLevel | NoiseDependence, final: FittedModel, shown: Shown) -> dict[str, Any]:
    """What all rows on noise have: no effect on the mean, so nothing is predicted better."""
    rms, held = shown.rms(final.error), shown.rms(final.held_out)
    ratio = {"value": level.ratio, "sigma": level.sigma, "unit": "1"}
    return {
        "cause": "unexplained",
        "verdict": "found",
        "reason_code": "noise",
        "subject": "",
        "p_value": level.p_value,
        "probability": 1.0 - level.p_value,
        "parameters": json.dumps({"noise_ratio": ratio}),
        "follows": "",
        "rms_before": rms,
        "rms_after": rms,
        "heldout_rms_before": held,
        "heldout_rms_after": held,
        "noise_floor": shown.floor(final.floor),
        "unit": shown.unit,
    }
