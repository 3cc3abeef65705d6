"""All that the stage diagnose leaves, from what was decided."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.schemas.artifacts import ARTIFACTS
from truing.stages.diagnosis.reading_artifacts import of_readings

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.fitted_model import FittedModel
    from truing.inference.prediction import PredictionError
    from truing.inference.selection import Diagnosis, Settings
    from truing.report.wordings.claim import Advice
    from truing.schemas.campaign import Campaign
    from truing.stages.diagnosis.mechanism_points import Gathered


def artifacts_of(diagnosis: Diagnosis, gathered: Gathered, rule: Settings, settings: Campaign) -> dict[str, Any]:
    """Tables and text by artifact."""
    from truing.stages.diagnosis.detectable_rows import detectable_table, detectable_words
    from truing.stages.diagnosis.left_out_rows import left_out_table
    from truing.stages.diagnosis.rows import Words, diagnosis_table
    from truing.stages.diagnosis.uncertainty_rows import uncertainty_table

    last, legs = diagnosis.search, diagnosis.plain.model.part_count
    causes = [verdict.cause for verdict in diagnosis.verdicts]
    found: dict[str, Any] = {"detectable": detectable_table(last, rule.level, legs)}
    found["cause_uncertainty"] = uncertainty_table(diagnosis, legs)
    found |= left_out_table(diagnosis, gathered)
    advice: dict[str, Advice] = {}
    if gathered.leaves is not None and gathered.shown is not None:
        found |= gathered.leaves(diagnosis, gathered.shown, settings)
    elif gathered.shown is not None:
        found |= of_readings(diagnosis, gathered.shown, settings) | _changes(diagnosis)
        advice = _next_loads(found, diagnosis, settings)
    else:
        found["prediction"] = _prediction_table(diagnosis, gathered)
    if settings.mechanism.is_legged:
        found |= _of_mechanism(diagnosis, settings)
        advice = _next(found, diagnosis, settings)
    remark = _remark(gathered, diagnosis.final)
    words = Words(detectable_words(last, rule.level, causes, legs), advice, remark, gathered.shown)
    return {"diagnosis": diagnosis_table(diagnosis, words, rule.noise_level), **found}


def _of_mechanism(diagnosis: Diagnosis, settings: Campaign) -> dict[str, Any]:
    from truing.simulation.mechanisms.extended_model import extended, write_model
    from truing.stages.diagnosis.pull_tables import fitted_mechanism, pull_tables

    plain, final = fitted_mechanism(diagnosis.plain), fitted_mechanism(diagnosis.final)
    text = write_model(extended(final.model, final.shared, final.covariance, {"campaign": settings.campaign.name}))
    return {"model": text, **pull_tables(plain, final), **_changes(diagnosis)}


def _changes(diagnosis: Diagnosis) -> dict[str, Any]:
    """What has changed since the model that the campaign starts from; nothing where it starts from none."""
    from truing.stages.diagnosis.earlier_campaign import changes_table

    changes = changes_table(diagnosis.final)
    return {} if changes is None else {"changes": changes}


def _next(found: dict[str, Any], diagnosis: Diagnosis, settings: Campaign) -> dict[str, Advice]:
    """The advice on what to measure next, by a cause's key; its table goes with what was ``found``."""
    from truing.stages.diagnosis.next_measurement import next_of

    following = next_of(diagnosis, settings)
    found["next_poses"] = following.table
    return following.advice


def _next_loads(found: dict[str, Any], diagnosis: Diagnosis, settings: Campaign) -> dict[str, Advice]:
    """The same of a bench."""
    from truing.stages.diagnosis.next_measurement import next_loads_of

    following = next_loads_of(diagnosis, settings)
    found["next_loads"] = following.table
    return following.advice


def _remark(gathered: Gathered, final: FittedModel) -> str:
    """What limits all statements."""
    said = []
    if gathered.framing is not None and gathered.framing < 3:
        said.append(
            "Fewer than three platform targets sit away from the attachments, so shifts are known modulo a plane "
            "(z and two tilts)."
        )
    if final.fit.state != "settled":
        said.append("The fit did not settle within its iterations: treat the numbers as provisional.")
    return " ".join(said)


def _prediction_table(diagnosis: Diagnosis, gathered: Gathered) -> pa.Table:
    """Rows of prediction.parquet: every pose without and with what was found."""
    import pyarrow as pa

    plain, final = diagnosis.plain, diagnosis.final
    rows = _rows(gathered.calibration.conditions.poses, "calibration", plain.error, final.error)
    if gathered.held_out is not None and plain.held_out is not None and final.held_out is not None:
        rows += _rows(gathered.held_out.conditions.poses, "verification", plain.held_out, final.held_out)
    identifier = "int64" if all(isinstance(row["pose"], int) for row in rows) else "string"
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["prediction"].arrow_schema(identifier))


def _rows(poses: tuple[int | str, ...], role: str, before: PredictionError, after: PredictionError) -> list[Any]:
    columns = {
        "rms_before": before.rms_by_epoch,
        "rms_after": after.rms_by_epoch,
        "largest_before": before.largest_by_epoch,
        "largest_after": after.largest_by_epoch,
    }
    return [
        {"pose": pose, "role": role, "unit": "um", **{name: float(v[row]) * 1e6 for name, v in columns.items()}}
        for row, pose in enumerate(poses)
    ]
