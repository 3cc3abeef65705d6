"""Outcome of [diagnosis] apply and ignore for each cause."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from truing.inference.fitter import Fitter
from truing.inference.verdicts import FOUND, SUSPECTED
from truing.simulation.catalogue import catalogue_of_rays
from truing.stages.common.applied_findings import APPLIED
from truing.stages.common.rows import Rows
from truing.stages.diagnosis.search import kinds_of

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.simulation.cause import Cause
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

_ACCEPTED = (FOUND, SUSPECTED)  # verdicts whose effects the extended model holds


def choices_table(
    settings: Campaign, diagnosis: pa.Table, is_calibrated: Callable[[Cause], bool] = lambda cause: False
) -> pa.Table | None:
    """Rows of diagnosis_choices.parquet; None if campaign.toml names no cause.

    diagnosis: rows of diagnosis.parquet; is_calibrated: whether a calibration can include a cause's effect.
    """
    accepted = {row["cause"] for row in diagnosis.to_pylist() if row["verdict"] in _ACCEPTED}
    kinds: dict[str, Cause] = {**catalogue_of_rays(), **kinds_of(settings, photographed=True)}
    rows = Rows("diagnosis_choices")
    for name in dict.fromkeys(settings.diagnosis.apply):
        became = APPLIED if is_calibrated(kinds[name]) else "no effect"
        rows.add(cause=name, asked="apply", outcome=became if name in accepted else "not found")
    for name in dict.fromkeys(settings.diagnosis.ignore):
        rows.add(cause=name, asked="ignore", outcome="ignored")
    return rows.table() if rows.count else None


def applied_model(
    diagnosis: CauseDiagnosis, data: DiagnosisData, settings: Campaign, choices: pa.Table | None
) -> str | None:
    """Extended model with the applied causes only; None if none is applied, or all that were found are."""
    rows = [] if choices is None else choices.to_pylist()
    applied = {row["cause"] for row in rows if row["outcome"] == APPLIED}
    accepted = diagnosis.final.causes
    chosen = tuple(cause for cause in accepted if cause.id in applied)
    if not applied or len(chosen) == len(accepted) or data.model_text is None:
        return None
    fitter = Fitter(data.model, data.calibration, data.held_out, settings.diagnosis.seed)
    return data.model_text(fitter.converged(chosen, diagnosis.plain), settings)
