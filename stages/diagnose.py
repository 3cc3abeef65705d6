"""Diagnosis: what the simulation gets wrong, why, and the extended model that gets it right."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from schemas.artifacts import ARTIFACTS
from stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from stages.mechanism_points import Gathered
    from truing.estimation.acceptance import Stand, Verdict

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
    from stages.mechanism_points import gather

    if settings.mechanism.type not in ("6-pus", "ups"):
        return _not_evaluated(f"mechanism {settings.mechanism.type}: the catalogue holds no cause for it yet")
    if "survey" not in tables or "configurations" not in tables:
        return _not_evaluated("needs the survey of the targets and the actuator readings")
    if len(settings.mechanism.legs) < 6:
        return _not_evaluated("fewer than six legs leave the platform free: readings do not say where it is")
    if settings.noise.point_mm is None:
        return _not_evaluated("needs noise.point_mm")
    try:
        gathered = gather(tables, settings)
    except ValueError as why:
        return _not_evaluated(str(why))
    return _diagnose(gathered, settings, progress)


def _diagnose(gathered: Gathered, settings: Campaign, progress: Progress) -> Outcome:
    from stages.pose_conditions import unexplained_causes
    from truing.estimation import acceptance
    from truing.simulation.causes import CATALOGUE

    rule = acceptance.Settings(settings.diagnosis.false_alarm, DRAWS, settings.diagnosis.seed)
    search = acceptance.Acceptance(
        gathered.model, gathered.calibration, gathered.held_out, rule, lambda what: progress(0, 1, what)
    )
    readings = gathered.calibration.conditions
    verdicts, final = search.run([*CATALOGUE.values(), *unexplained_causes(readings, gathered.model.nominal.rho0)])
    rows = [_row(rank, verdict, gathered) for rank, verdict in enumerate(verdicts, 1)]
    return Outcome(
        {"diagnosis": _table(rows), "model": _model_text(final, settings)},
        read=_read(gathered),
        left_out=_left_out(gathered, search.gross),
        figure=_figure(verdicts, final),
    )


def _row(rank: int, verdict: Verdict, gathered: Gathered) -> dict[str, Any]:
    """One row of diagnosis.parquet."""
    from truing.report.findings import Facts, explanation

    parameters = fitted_parameters(verdict.own, verdict.cause)
    held = (_um(verdict.before.held_out), _um(verdict.after.held_out))
    facts = Facts(
        verdict.verdict,
        verdict.cause.says,
        parameters,
        verdict.score.p_value,
        verdict.candidates,
        _um(verdict.before.error),
        _um(verdict.after.error),
        held,
        verdict.after.floor * 1e6,
        verdict.reason,
        _detectable(verdict),
        bool(verdict.cause.follows(gathered.model.nominal.count)),
        _remark(gathered, verdict.after),
    )
    return {
        "rank": rank,
        "cause": verdict.cause.id,
        "verdict": verdict.verdict,
        "subject": "",
        "p_value": verdict.score.p_value,
        "probability": verdict.probability,
        "parameters": json.dumps(parameters),
        "follows": " ".join(verdict.cause.follows(gathered.model.nominal.count)),
        "rms_before": facts.rms_before,
        "rms_after": facts.rms_after,
        "heldout_rms_before": held[0],
        "heldout_rms_after": held[1],
        "noise_floor": facts.floor,
        "unit": "um",
        "explanation": explanation(facts),
        "next_measurement": verdict.cause.confirm,
    }


def fitted_parameters(stand: Stand, cause: Any) -> dict[str, dict[str, Any]]:
    """A cause's parameters as the contract names them: value, sigma, unit."""
    import numpy as np

    model = stand.model
    sigma = np.sqrt(np.diag(stand.covariance()))[model.layout[cause.key]] * model.effect_sigma(cause)
    values = stand.fit.shared[model.layout[cause.key]] * model.effect_sigma(cause)
    named = zip(cause.parameters(model.nominal.count), values, sigma, strict=True)
    return {p.name: {"value": float(v / p.si), "sigma": float(s / p.si), "unit": p.unit} for p, v, s in named}


def _detectable(verdict: Verdict) -> str:
    size = verdict.score.detectable
    if size is None:
        return ""
    first = verdict.cause.parameters(6)[0]
    unit = "" if first.unit == "1" else f" {first.unit}"
    return f"coefficients of {size * first.scale / first.si:.2g}{unit} (root mean square)"


def _remark(gathered: Gathered, stand: Stand) -> str:
    said = []
    if gathered.framing < 3:
        said.append(
            "Fewer than three platform targets sit away from the attachments, so shifts are known modulo a plane "
            "(z and two tilts)."
        )
    if stand.fit.state != "settled":
        said.append("The fit did not settle within its iterations: treat the numbers as provisional.")
    return " ".join(said)


def _um(error: Any) -> float | None:
    return None if error is None or error.rms is None else error.rms * 1e6


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


def _figure(verdicts: list[Verdict], final: Stand) -> str:
    found = [verdict.cause.id for verdict in verdicts if verdict.verdict == "found"]
    if not found:
        return f"nothing found: {_um(final.error):.2f} um rms, noise alone leaves {final.floor * 1e6:.2f}"
    first = next(verdict for verdict in verdicts if verdict.verdict == "found")
    return (
        f"found {', '.join(found)}: {_um(first.before.error):.2f} -> {_um(final.error):.2f} um rms, "
        f"noise alone leaves {final.floor * 1e6:.2f}"
    )


def _table(rows: list[dict[str, Any]]) -> pa.Table:
    import pyarrow as pa

    schema = ARTIFACTS["diagnosis"].arrow_schema()
    return pa.Table.from_pylist(rows, schema=schema)


def _not_evaluated(why: str) -> Outcome:
    return Outcome(
        {"diagnosis": ARTIFACTS["diagnosis"].empty()},
        read="nothing",
        left_out="nothing",
        figure=f"not evaluated: {why}",
    )
