"""Reasons why a stage cannot evaluate a campaign's tables, determined without a fit."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pyarrow as pa

if TYPE_CHECKING:
    from truing.schemas.mechanism import MechanismSection


LEAST_POSES = 3
LEAST_TARGETS = 3
LEAST_POSES_OF_CHAIN = 8
HELD_OUT = "verification"
_LEAST_LEGS = 6  # fewer do not constrain the platform
# Why mechanisms without bodies have neither poses nor deformation, and where their parameters are, by type.
NO_BODIES = {"axis": "an axis has rows of readings, and no bodies with targets"}
NO_CALIBRATION = {
    "axis": "the diagnosis gives factors, lost motion and zeros of an axis",
    "chain": "the diagnosis identifies the geometry of a chain (section Chain, chain_parameters)",
}
# Why such a mechanism has no choice of configurations, by type.
NO_CHOICE = {
    "axis": "; accuracy, uniqueness and tolerances of an axis are not studied",
    "chain": "; accuracy, uniqueness and tolerances of a chain are not studied yet",
}
NO_DRIVES = {"chain": "no drives named in [campaign]; the diagnosis tests the compliance of joints and links"}
NO_POINTS_TO_DEFORM = "no points: deformation shows in targets, and poses or scans have none"
NO_POINTS_TO_DIAGNOSE = (
    "no points: targets distinguish causes, and poses or scans have none. Of a mechanism on legs or of bodies, export "
    "the measured targets, three or more on each body, as points.csv; measured poses of an arm need [mechanism] "
    'type = "chain"'
)
NO_BODY_TO_DIAGNOSE = "needs a body with three targets, seen together in three poses"


def why_too_few_of_chain(fitted: int) -> str:
    """Reason why the poses of a chain that may be fitted are too few; else empty."""
    needed = f"needs at least {LEAST_POSES_OF_CHAIN} poses with readings of all joints and measured links"
    return "" if fitted >= LEAST_POSES_OF_CHAIN else f"{needed}, found {fitted} that may be fitted"


def why_no_deformation_of_legs(tables: Mapping[str, pa.Table]) -> str:
    """Reason why shifts of attachments cannot be observed; else empty."""
    attached = tables["survey"].column("leg").drop_null() if "survey" in tables else ()
    if "configurations" not in tables or not len(attached):
        return "no platform target sits at an attachment (column leg of targets.csv)"
    if _are_all_held_out(tables["configurations"]):
        return "every pose is for verification, so none may be fitted"
    return ""


def why_no_deformation_of_targets(drives: Sequence[str], tables: Mapping[str, pa.Table], mechanism: str) -> str:
    """Reason why dependence of targets on a drive cannot be observed; else empty. ``mechanism``: its type."""
    if drives and "configurations" in tables:
        return ""
    return NO_DRIVES.get(mechanism, "no mechanism, and no drives named in [campaign]")


def why_no_deformation_of_loads(readings: pa.Table | None) -> str:
    """Reason why the platform's response to loads cannot be observed; else empty."""
    if readings is None or not readings.num_rows:
        return "no readings of displacement under load"
    return "every run is for verification, so none may be fitted" if _are_all_held_out(readings) else ""


_OF_PREDICTIONS = {
    "survey": "the survey of the targets in the frames of base and platform, to which the legs refer (targets.csv)",
    "configurations": "the actuators' readings (configurations)",
}

_LEGGED = frozenset({"base", "platform"})  # bodies in whose frames the legs are known


def why_no_diagnosis_of_mechanism(mechanism: Any, point_mm: float | None, tables: Mapping[str, pa.Table]) -> str:
    """Reason why points cannot be compared with the prediction from readings; else empty."""
    if lacking := [words for name, words in _OF_PREDICTIONS.items() if name not in tables]:
        return f"needs {' and '.join(lacking)}"
    if len(mechanism.legs) < _LEAST_LEGS:
        return "fewer than six legs do not constrain the platform, so readings give no pose"
    return "" if point_mm is not None else "needs noise.point_mm"


def why_reference_unseen(body: str, most: int) -> str:
    """Reason why no body has a pose relative to the reference, if that shows too few targets; else empty."""
    if most >= LEAST_TARGETS:
        return ""
    return (
        f"the reference body {body} shows at most {most} targets in a pose, so other bodies have no pose relative to it"
    )


def why_too_few_determined(fitted: int) -> str:
    """Reason why the number of usable poses with a determined body is too small; else empty."""
    return "" if fitted >= LEAST_POSES else f"needs at least {LEAST_POSES} poses that determine a body, found {fitted}"


def why_no_calibration(
    mechanism: MechanismSection, tables: Mapping[str, pa.Table], bodies_of_points: Collection[object]
) -> str:
    """Reason why no machine can be calibrated; else empty. ``bodies_of_points``: bodies whose points were measured."""
    if mechanism.type in NO_CALIBRATION:
        return NO_CALIBRATION[mechanism.type]
    if not mechanism.is_legged:
        return f"[mechanism] type {mechanism.type} has no legs, so readings give no pose of a platform"
    # Poses that were measured as such are in the frames of the legs.
    needed = _OF_PREDICTIONS if not _LEGGED.isdisjoint(bodies_of_points) else ["configurations"]
    lacking = [_OF_PREDICTIONS[name] for name in needed if name not in tables]
    return f"needs {' and '.join(lacking)}" if lacking else ""


def why_too_few_poses(fitted: int) -> str:
    """Reason why the number of poses for the fit is too small; else empty."""
    if fitted >= LEAST_POSES:
        return ""
    return f"needs at least {LEAST_POSES} poses that are not for verification, found {fitted}"


def _are_all_held_out(table: pa.Table) -> bool:
    return "role" in table.column_names and set(table.column("role").to_pylist()) == {HELD_OUT}
