"""Diagnosis: what the simulation gets wrong, why, and the extended model that gets it right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from schemas.artifacts import ARTIFACTS
from stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign, LeggedMechanism
    from stages.mechanism_points import Gathered
    from truing.estimation.acceptance import Stand

DECLARATION = Stage(
    name="diagnose",
    reads=("observations", "survey?", "configurations?", "poses", "residuals"),
    leaves=("diagnosis", "model?"),
    settings=(
        "campaign.name",
        "mechanism.type",
        "mechanism.legs",
        "mechanism.tolerance",
        "noise.point_mm",
        "noise.actuator_mm",
        "diagnosis",
    ),
    summary="what the simulation gets wrong: causes, their sizes, the extended model",
)

# Simulated residual vectors, and as many sign-flipped ones, that the search is held against.
DRAWS = 2000


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Search the catalogue for what makes the campaign depart from its simulation."""
    import numpy as np

    from stages.mechanism_points import gather

    if not settings.mechanism.is_legged:
        return _not_evaluated(f"mechanism {settings.mechanism.type}: the catalogue holds no cause for it yet")
    if "survey" not in tables or "configurations" not in tables:
        return _not_evaluated("needs the survey of the targets and the actuator readings")
    if len(cast("LeggedMechanism", settings.mechanism).legs) < 6:
        return _not_evaluated("fewer than six legs leave the platform free: readings do not say where it is")
    if settings.noise.point_mm is None:
        return _not_evaluated("needs noise.point_mm")
    try:
        gathered = gather(tables, settings)
    except ValueError as why:
        return _not_evaluated(str(why))
    if unreached := _unreached(gathered):
        return _not_evaluated(unreached)
    try:
        return _diagnose(gathered, settings, progress)
    except np.linalg.LinAlgError:
        return _not_evaluated("the fit left what the legs can reach: geometry, survey or readings are far from right")


def _unreached(gathered: Gathered) -> str:
    """Why the nominal mechanism cannot be held against the readings; empty where it can."""
    from truing.simulation.kinematics import reaches

    readings = gathered.calibration.conditions.readings
    count = int((~reaches(gathered.model.nominal, readings)).sum())
    if not count:
        return ""
    return f"the legs of [mechanism] cannot meet the platform at the readings of {count} of {len(readings)} poses"


def _diagnose(gathered: Gathered, settings: Campaign, progress: Progress) -> Outcome:
    from stages.diagnosis_rows import diagnosis_table
    from stages.pose_conditions import unexplained_causes
    from truing.estimation import acceptance
    from truing.simulation.causes import catalogue

    rule = acceptance.Settings(settings.diagnosis.false_alarm, DRAWS, settings.diagnosis.seed)
    search = acceptance.Acceptance(
        gathered.model, gathered.calibration, gathered.held_out, rule, lambda what: progress(0, 1, what)
    )
    readings = gathered.calibration.conditions
    verdicts, final = search.run([*catalogue().values(), *unexplained_causes(readings, gathered.model.nominal.rho0)])
    table = diagnosis_table(verdicts, final, gathered.framing, settings.diagnosis.false_alarm)
    return Outcome(
        {"diagnosis": table, "model": _model_text(final, settings)},
        read=_read(gathered),
        left_out=_left_out(gathered, search.gross),
        figure=_figure(table, final),
    )


def _model_text(final: Stand, settings: Campaign) -> str:
    from truing.simulation.extended_model import extended, write_model

    return write_model(
        extended(final.model, final.fit.shared, final.covariance(), {"campaign": settings.campaign.name})
    )


def _read(gathered: Gathered) -> str:
    held = 0 if gathered.held_out is None else len(gathered.held_out.conditions.readings)
    seen = int(gathered.calibration.measured.seen.sum())
    return f"{seen} points of {len(gathered.calibration.conditions.readings)} poses, {held} poses held out"


def _left_out(gathered: Gathered, gross: int) -> str:
    said = [gathered.left_out] if gathered.left_out else []
    return "; ".join([*said, f"{gross} points as gross errors"] if gross else said) or "nothing"


def _figure(table: pa.Table, final: Stand) -> str:
    found = [row for row in table.to_pylist() if row["verdict"] == "found"]
    left = f"{(final.error.rms or 0.0) * 1e6:.2f} um rms, noise alone leaves {final.floor * 1e6:.2f}"
    if not found:
        return f"nothing found: {left}"
    return f"found {', '.join(row['cause'] for row in found)}: {found[0]['rms_before']:.2f} -> {left}"


def _not_evaluated(why: str) -> Outcome:
    return Outcome(
        {"diagnosis": ARTIFACTS["diagnosis"].empty()},
        read="nothing",
        left_out="nothing",
        figure=f"not evaluated: {why}",
    )
