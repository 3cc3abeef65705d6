"""The rows of diagnosis.parquet: what was decided on each candidate, in numbers and in words."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from schemas.artifacts import ARTIFACTS
from truing.estimation.noise_level import NoiseLevel, noise_level

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.estimation.acceptance import Stand, Verdict

# The share of the false-alarm rate that noise larger than declared may use up.
_NOISE_BUDGET = 0.1


def diagnosis_table(verdicts: list[Verdict], final: Stand, framing: int, false_alarm: float) -> pa.Table:
    """Rows of the verdicts in their order, noise larger than declared behind what was found; ``framing`` is the number
    of platform targets away from the attachments."""
    import pyarrow as pa

    rows = [_row(verdict, framing) for verdict in verdicts]
    level = noise_level(final.fit.whitened)
    if level.p_value <= _NOISE_BUDGET * false_alarm:
        found = sum(row["verdict"] == "found" for row in rows)
        rows.insert(found, _noise_row(level, final))
    ranked = [{"rank": rank, **row} for rank, row in enumerate(rows, 1)]
    return pa.Table.from_pylist(ranked, schema=ARTIFACTS["diagnosis"].arrow_schema())


def _row(verdict: Verdict, framing: int) -> dict[str, Any]:
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
        bool(verdict.cause.follows(verdict.own.model.nominal.count)),
        _remark(framing, verdict.after),
    )
    return {
        "cause": verdict.cause.id,
        "verdict": verdict.verdict,
        "subject": "",
        "p_value": verdict.score.p_value,
        "probability": verdict.probability,
        "parameters": json.dumps(parameters),
        "follows": " ".join(verdict.cause.follows(verdict.own.model.nominal.count)),
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


def _remark(framing: int, stand: Stand) -> str:
    said = []
    if framing < 3:
        said.append(
            "Fewer than three platform targets sit away from the attachments, so shifts are known modulo a plane "
            "(z and two tilts)."
        )
    if stand.fit.state != "settled":
        said.append("The fit did not settle within its iterations: treat the numbers as provisional.")
    return " ".join(said)


def _noise_row(level: NoiseLevel, final: Stand) -> dict[str, Any]:
    """Noise larger than declared is structure too: something moves the points that nothing here explains."""
    from truing.report.findings import noise_explanation

    rms, held = _um(final.error), _um(final.held_out)
    ratio = {"value": level.ratio, "sigma": level.sigma, "unit": "1"}
    return {
        "cause": "unexplained",
        "verdict": "found",
        "subject": "",
        "p_value": level.p_value,
        "probability": 1.0 - level.p_value,
        "parameters": json.dumps({"noise_ratio": ratio}),
        "follows": "",
        "rms_before": rms,
        "rms_after": rms,
        "heldout_rms_before": held,
        "heldout_rms_after": held,
        "noise_floor": final.floor * 1e6,
        "unit": "um",
        "explanation": noise_explanation(level.ratio, level.sigma, rms, final.floor * 1e6),
        "next_measurement": "Measure one pose ten times over without moving anything: the scatter is the true noise.",
    }


def _um(error: Any) -> float | None:
    return None if error is None or error.rms is None else error.rms * 1e6
