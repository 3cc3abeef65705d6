"""Points and readings that the diagnosis takes out as gross errors, one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.schemas.artifacts import ARTIFACTS

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.fitted_model import ScreenedValue
    from truing.inference.selection import Diagnosis
    from truing.stages.diagnosis.mechanism_points import Gathered

_WHY = "gross error: its residual is far outside those of its target"


def left_out_table(diagnosis: Diagnosis, gathered: Gathered) -> dict[str, pa.Table]:
    """The artifact ``diagnosis_left_out``; empty where nothing was taken out."""
    import pyarrow as pa

    from truing.inference.screening import least_gross

    if not diagnosis.screened:
        return {}
    limit = least_gross(diagnosis.final.measured.size)
    rows = [
        {
            **_place(one, gathered),
            "subject": _subject(one, diagnosis),
            "reason": _WHY,
            "value": one.length,
            "limit": limit,
            "unit": "sigma",
        }
        for one in diagnosis.screened
    ]
    where = [name for name in ("pose", "run", "step") if name in rows[0]]
    identifier = "int64" if all(isinstance(row[where[0]], int) for row in rows) else "string"
    schema = ARTIFACTS["diagnosis_left_out"].arrow_schema(identifier, present=tuple(where))
    return {"diagnosis_left_out": pa.Table.from_pylist(rows, schema=schema)}


def _place(one: ScreenedValue, gathered: Gathered) -> dict[str, Any]:
    """The pose, or the run and step, by name."""
    poses = gathered.held_out if one.held_out else gathered.calibration
    conditions: Any = poses.conditions if poses is not None else None
    if not hasattr(conditions, "run"):
        return {"pose": conditions.poses[one.row]}
    run = conditions.run[one.row]
    return {"run": run.item() if hasattr(run, "item") else run, "step": int(conditions.step[one.row])}


def _subject(one: ScreenedValue, diagnosis: Diagnosis) -> str:
    """Body and target, or the channel."""
    model = diagnosis.final.model
    name = model.channel_names[one.channel]
    return f"{model.channel_kinds[one.channel]} {name}" if len(model.channel_kinds) > one.channel else name
