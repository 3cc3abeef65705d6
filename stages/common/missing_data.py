"""Why a stage cannot evaluate what the tables of a campaign hold: facts that the stages go by, told without a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

LEAST_POSES = 3
LEAST_TARGETS = 3
HELD_OUT = "verification"
_LEAST_LEGS = 6  # fewer leave the platform free
# Why mechanisms without bodies have neither poses nor deformation, and what tells their numbers instead; by type.
NO_BODIES = {"axis": "an axis has rows of readings, and no bodies with targets"}
NO_CALIBRATION = {"axis": "factors, lost motion and zeros of an axis are told by the diagnosis"}
# What such a mechanism lacks where configurations are to be chosen, or campaigns to be drawn again; by type.
NO_CHOICE = {"axis": "; an axis has commands, and no poses of legs to choose"}
NO_DRAWING = {"axis": "; rows of an axis have no points, and are not drawn again yet"}
NO_POINTS_TO_DEFORM = "no points: deformation shows in targets, and poses or scans have none"
NO_POINTS_TO_DIAGNOSE = "no points: causes are told apart by targets, and poses or scans have none"
NO_BODY_TO_DIAGNOSE = "needs a body with three targets, seen together in three poses"


def why_no_deformation_of_legs(tables: Mapping[str, pa.Table]) -> str:
    """Why attachments cannot be seen to shift; empty where they can."""
    attached = tables["survey"].column("leg").drop_null() if "survey" in tables else ()
    if "configurations" not in tables or not len(attached):
        return "no platform target sits at an attachment (column leg of targets.csv)"
    if _are_all_held_out(tables["configurations"]):
        return "every pose is for verification, and nothing may be fitted to those"
    return ""


def why_no_deformation_of_targets(drives: Sequence[str], tables: Mapping[str, pa.Table]) -> str:
    """Why targets cannot be seen to follow a drive; empty where they can."""
    return "" if drives and "configurations" in tables else "no mechanism, and no drives named in [campaign]"


def why_no_deformation_of_loads(readings: pa.Table | None) -> str:
    """Why the platform cannot be seen to follow loads; empty where it can."""
    if readings is None or not readings.num_rows:
        return "no readings of displacement under load"
    return "every run is for verification, and nothing may be fitted to those" if _are_all_held_out(readings) else ""


def why_no_diagnosis_of_mechanism(mechanism: Any, point_mm: float | None, tables: Mapping[str, pa.Table]) -> str:
    """Why points cannot be held against what readings say of them; empty where they can."""
    if "survey" not in tables or "configurations" not in tables:
        return "needs the survey of the targets and the actuator readings"
    if len(mechanism.legs) < _LEAST_LEGS:
        return "fewer than six legs leave the platform free: readings do not say where it is"
    return "" if point_mm is not None else "needs noise.point_mm"


def why_reference_unseen(body: str, most: int) -> str:
    """Why no body is seen from the reference, which never shows more than so many targets; empty where it is enough."""
    if most >= LEAST_TARGETS:
        return ""
    return f"the reference body {body} shows at most {most} targets in a pose: other bodies are not seen from it"


def why_too_few_determined(fitted: int) -> str:
    """Why so many poses that determine a body, and may be fitted to, are too few; empty where they are enough."""
    return "" if fitted >= LEAST_POSES else f"needs at least {LEAST_POSES} poses that determine a body, found {fitted}"


def why_no_calibration(mechanism: Any, tables: Mapping[str, pa.Table]) -> str:
    """Why no machine can be calibrated; empty where one can be."""
    if mechanism.type in NO_CALIBRATION:
        return NO_CALIBRATION[mechanism.type]
    if not mechanism.is_legged:
        return f"mechanism {mechanism.type}: no legs whose readings say where the platform is"
    return "" if "configurations" in tables else "needs the actuators' readings (configurations)"


def why_too_few_poses(fitted: int) -> str:
    """Why so many poses that may be fitted to are too few; empty where they are enough."""
    if fitted >= LEAST_POSES:
        return ""
    return f"needs at least {LEAST_POSES} poses that are not for verification, found {fitted}"


def _are_all_held_out(table: pa.Table) -> bool:
    return "role" in table.column_names and set(table.column("role").to_pylist()) == {HELD_OUT}
